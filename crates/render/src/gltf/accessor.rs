//! Numbers out of glTF buffers, checked against their true lengths before anything is allocated.

use gltf::accessor::{DataType, Dimensions};
use gltf::buffer::View;

/// The bytes of a document's buffers.
pub struct Buffers(pub Vec<Vec<u8>>);

/// What was expected of an accessor and not found.
type Result<T> = std::result::Result<T, String>;

impl Buffers {
    /// The bytes of a view.
    pub fn view(&self, view: &View<'_>) -> Result<&[u8]> {
        let buffer = self.0.get(view.buffer().index());
        let end = view.offset().checked_add(view.length());
        buffer
            .zip(end)
            .and_then(|(b, end)| b.get(view.offset()..end))
            .ok_or_else(|| format!("bufferViews[{}] must lie within its buffer", view.index()))
    }

    /// Elements of `N` numbers each; integers become fractions if the file says they are normalised.
    pub fn floats<const N: usize>(&self, a: &gltf::Accessor<'_>) -> Result<Vec<[f32; N]>> {
        let found = a.dimensions().multiplicity();
        if found != N {
            return Err(self.wrong(a, &format!("expected {N} numbers each, found {found}")));
        }
        let (kind, normalised) = (a.data_type(), a.normalized());
        let number = |bytes: &[u8]| -> [f32; N] {
            std::array::from_fn(|i| number(&bytes[i * width(kind)..], kind, normalised))
        };
        self.elements(a, number, [0.0; N])
    }

    /// Vertex indices.
    pub fn indices(&self, a: &gltf::Accessor<'_>) -> Result<Vec<u32>> {
        let kind = a.data_type();
        let whole = matches!(kind, DataType::U8 | DataType::U16 | DataType::U32);
        if a.dimensions() != Dimensions::Scalar || !whole {
            return Err(self.wrong(a, "expected unsigned whole numbers"));
        }
        self.elements(a, |bytes| index(bytes, kind), 0)
    }

    fn wrong(&self, a: &gltf::Accessor<'_>, expected: &str) -> String {
        format!("accessors[{}]: {expected}", a.index())
    }

    /// All elements, sparse ones replaced; without a view they are `zero`.
    fn elements<T: Copy>(
        &self,
        a: &gltf::Accessor<'_>,
        element: impl Fn(&[u8]) -> T,
        zero: T,
    ) -> Result<Vec<T>> {
        let size = a.dimensions().multiplicity() * width(a.data_type());
        let count = a.count();
        let mut all = match a.view() {
            Some(view) => {
                let stride = view.stride().unwrap_or(size);
                let bytes = self.view(&view)?;
                let place = (a.offset(), stride, size);
                strided(bytes, place, count, &element).ok_or_else(|| {
                    let found = bytes.len();
                    let expected =
                        format!("expected {count} elements of {size} bytes, found {found} bytes");
                    self.wrong(a, &expected)
                })?
            }
            None => {
                // Nothing in the file vouches for this many zeros but its own size.
                let most: usize = self.0.iter().map(Vec::len).sum();
                if count > most {
                    return Err(self.wrong(a, &format!("expected a view for {count} elements")));
                }
                vec![zero; count]
            }
        };
        if let Some(sparse) = a.sparse() {
            let short = || self.wrong(a, "expected as many sparse values as it says");
            let (indices, values) = (sparse.indices(), sparse.values());
            let kind = match indices.index_type() {
                gltf::accessor::sparse::IndexType::U8 => DataType::U8,
                gltf::accessor::sparse::IndexType::U16 => DataType::U16,
                gltf::accessor::sparse::IndexType::U32 => DataType::U32,
            };
            let n = sparse.count();
            let step = width(kind);
            let bytes = self.view(&indices.view())?;
            let read = |b: &[u8]| index(b, kind) as usize;
            let at = strided(bytes, (indices.offset(), step, step), n, read).ok_or_else(short)?;
            let bytes = self.view(&values.view())?;
            let new =
                strided(bytes, (values.offset(), size, size), n, element).ok_or_else(short)?;
            for (i, value) in at.into_iter().zip(new) {
                let slot = all.get_mut(i);
                *slot.ok_or_else(|| self.wrong(a, "expected sparse indices below its count"))? =
                    value;
            }
        }
        Ok(all)
    }
}

/// `count` elements of `size` bytes, the first at `offset` and each `stride` after the last; `None` if
/// there are not as many bytes.
fn strided<T>(
    bytes: &[u8],
    (offset, stride, size): (usize, usize, usize),
    count: usize,
    element: impl Fn(&[u8]) -> T,
) -> Option<Vec<T>> {
    if count == 0 {
        return Some(Vec::new());
    }
    let last = stride.checked_mul(count - 1)?.checked_add(offset)?;
    if last.checked_add(size)? > bytes.len() {
        return None;
    }
    let all = (0..count).map(|i| element(&bytes[offset + i * stride..][..size]));
    Some(all.collect())
}

fn width(kind: DataType) -> usize {
    match kind {
        DataType::I8 | DataType::U8 => 1,
        DataType::I16 | DataType::U16 => 2,
        DataType::U32 | DataType::F32 => 4,
    }
}

fn index(b: &[u8], kind: DataType) -> u32 {
    match kind {
        DataType::U8 => u32::from(b[0]),
        DataType::U16 => u32::from(u16::from_le_bytes([b[0], b[1]])),
        _ => u32::from_le_bytes([b[0], b[1], b[2], b[3]]),
    }
}

fn number(b: &[u8], kind: DataType, normalised: bool) -> f32 {
    let (value, most) = match kind {
        DataType::I8 => (f32::from(b[0] as i8), 127.0),
        DataType::U8 => (f32::from(b[0]), 255.0),
        DataType::I16 => (f32::from(i16::from_le_bytes([b[0], b[1]])), 32767.0),
        DataType::U16 => (f32::from(u16::from_le_bytes([b[0], b[1]])), 65535.0),
        DataType::U32 => (index(b, kind) as f32, u32::MAX as f32),
        DataType::F32 => return f32::from_le_bytes([b[0], b[1], b[2], b[3]]),
    };
    if normalised {
        (value / most).max(-1.0)
    } else {
        value
    }
}
