//! Numbers out of glTF buffers, checked against their true lengths before anything is allocated.

use gltf::accessor::{DataType, Dimensions};
use gltf::buffer::View;
use std::collections::HashMap;

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

    /// Elements of `N` numbers each, which are read where they are asked for: many primitives may share an accessor of
    /// which each needs little. Integers become fractions if the file says they are normalised.
    pub fn floats<const N: usize>(&self, a: &gltf::Accessor<'_>) -> Result<Floats<'_, N>> {
        let found = a.dimensions().multiplicity();
        if found != N {
            return Err(self.wrong(a, &format!("expected {N} numbers each, found {found}")));
        }
        let (kind, normalised) = (a.data_type(), a.normalized());
        let (bytes, stride) = self.place(a)?;
        let mut floats = Floats {
            bytes,
            stride,
            count: a.count(),
            kind,
            normalised,
            sparse: HashMap::new(),
        };
        self.sparse(a, |i, bytes| {
            floats.sparse.insert(i, numbers(bytes, kind, normalised));
        })?;
        Ok(floats)
    }

    /// Vertex indices.
    pub fn indices(&self, a: &gltf::Accessor<'_>) -> Result<Vec<u32>> {
        let kind = a.data_type();
        let whole = matches!(kind, DataType::U8 | DataType::U16 | DataType::U32);
        if a.dimensions() != Dimensions::Scalar || !whole {
            return Err(self.wrong(a, "expected unsigned whole numbers"));
        }
        let (bytes, stride) = self.place(a)?;
        let element = |i: usize| bytes.map_or(0, |b| index(&b[i * stride..], kind));
        let mut all: Vec<u32> = (0..a.count()).map(element).collect();
        self.sparse(a, |i, bytes| all[i] = index(bytes, kind))?;
        Ok(all)
    }

    fn wrong(&self, a: &gltf::Accessor<'_>, expected: &str) -> String {
        format!("accessors[{}]: {expected}", a.index())
    }

    /// The bytes from an accessor's first element on, if it has a view, long enough for all; and the distance from one
    /// element to the next.
    fn place(&self, a: &gltf::Accessor<'_>) -> Result<(Option<&[u8]>, usize)> {
        let size = a.dimensions().multiplicity() * width(a.data_type());
        let count = a.count();
        let Some(view) = a.view() else {
            // Nothing in the file vouches for this many zeros but its own size.
            let most: usize = self.0.iter().map(Vec::len).sum();
            if count > most {
                return Err(self.wrong(a, &format!("expected a view for {count} elements")));
            }
            return Ok((None, size));
        };
        let stride = view.stride().unwrap_or(size);
        let bytes = self.view(&view)?;
        let all = elements(bytes, (a.offset(), stride, size), count).ok_or_else(|| {
            let found = bytes.len();
            let expected =
                format!("expected {count} elements of {size} bytes, found {found} bytes");
            self.wrong(a, &expected)
        })?;
        Ok((Some(all), stride))
    }

    /// Calls `replace` with the index and the bytes of each element that stands for another.
    fn sparse(&self, a: &gltf::Accessor<'_>, mut replace: impl FnMut(usize, &[u8])) -> Result<()> {
        let Some(sparse) = a.sparse() else {
            return Ok(());
        };
        let size = a.dimensions().multiplicity() * width(a.data_type());
        let (indices, values) = (sparse.indices(), sparse.values());
        let kind = match indices.index_type() {
            gltf::accessor::sparse::IndexType::U8 => DataType::U8,
            gltf::accessor::sparse::IndexType::U16 => DataType::U16,
            gltf::accessor::sparse::IndexType::U32 => DataType::U32,
        };
        let (n, step) = (sparse.count(), width(kind));
        let of = |view: &View<'_>, offset: usize, size: usize| {
            elements(self.view(view)?, (offset, size, size), n)
                .ok_or_else(|| self.wrong(a, "expected as many sparse values as it says"))
        };
        let at = of(&indices.view(), indices.offset(), step)?;
        let new = of(&values.view(), values.offset(), size)?;
        for k in 0..n {
            let i = index(&at[k * step..], kind) as usize;
            if i >= a.count() {
                return Err(self.wrong(a, "expected sparse indices below its count"));
            }
            replace(i, &new[k * size..][..size]);
        }
        Ok(())
    }
}

/// An accessor's elements.
pub struct Floats<'a, const N: usize> {
    /// From the first element on; zeros without.
    bytes: Option<&'a [u8]>,
    stride: usize,
    count: usize,
    kind: DataType,
    normalised: bool,
    sparse: HashMap<usize, [f32; N]>,
}

impl<const N: usize> Floats<'_, N> {
    /// How many there are.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Element `i`; none beyond the last.
    pub fn get(&self, i: usize) -> Option<[f32; N]> {
        if i >= self.count {
            return None;
        }
        let replaced = self.sparse.get(&i).copied();
        replaced.or_else(|| {
            let read = |b: &[u8]| numbers(&b[i * self.stride..], self.kind, self.normalised);
            Some(self.bytes.map_or([0.0; N], read))
        })
    }
}

/// The bytes from the first of `count` elements on, which is at `offset` and each `stride` after the last; `None` if
/// there are not enough for all.
fn elements(
    bytes: &[u8],
    (offset, stride, size): (usize, usize, usize),
    count: usize,
) -> Option<&[u8]> {
    if count == 0 {
        return Some(&[]);
    }
    let last = stride.checked_mul(count - 1)?.checked_add(offset)?;
    let end = last.checked_add(size)?;
    (end <= bytes.len()).then(|| &bytes[offset..])
}

fn numbers<const N: usize>(bytes: &[u8], kind: DataType, normalised: bool) -> [f32; N] {
    std::array::from_fn(|i| number(&bytes[i * width(kind)..], kind, normalised))
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
