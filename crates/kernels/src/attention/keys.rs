//! Keys and values of a sequence, as the forward pass reads them.

use super::anchors::turn;
use super::layout::offsets;
use super::{Part, Projected, Shape, Span};
use crate::buffer::Buf;
use crate::gemm::{AnyBuf, Element, Kernel, View};
use crate::threads::{Shared, par_tiles};

/// Keys turned at once: they go from the first-level cache into their packing. A multiple of a panel's columns.
const TURNED: usize = 64;

/// Packed keys [dh, n] and values [n, dh].
pub(super) type Seen<K> = (View<<K as Kernel>::Elem>, View<<K as Kernel>::Elem>);

/// Normalised keys and values of a sequence's spans for every head.
pub(crate) struct KeyValues {
    keys: Form,
    /// Packed [n, dh].
    values: AnyBuf,
    /// Per span: tokens, where its keys start among its head's, where its values do.
    spans: Vec<[usize; 3]>,
    /// Elements of a head's keys and of its values.
    lens: [usize; 2],
}

/// What becomes of keys.
enum Form {
    /// Packed [dh, n] once.
    Packed(AnyBuf),
    /// Rows [n, dh], because each query group turns them its own way.
    Rows(Buf<f32>),
}

impl KeyValues {
    /// Those of all `spans`; `anchored` says whether the keys are yet to be turned.
    pub fn pack<K: Kernel>(
        kernel: K,
        shape: Shape,
        spans: &[Span],
        x: Projected,
        k_norm: &[f32],
        anchored: bool,
    ) -> Self {
        let (dh, heads) = (shape.head_dim, shape.all_heads());
        let (key_len, key_starts) = offsets(spans, |n| {
            if anchored {
                n * dh
            } else {
                kernel.packed_len(dh, n)
            }
        });
        let (value_len, value_starts) = offsets(spans, |n| kernel.packed_len(n, dh));
        let starts = key_starts.into_iter().zip(value_starts);
        let places = spans.iter().zip(starts);
        let places: Vec<_> = places.map(|(s, (k, v))| [s.len, k, v]).collect();
        let mut rows = Buf::new(if anchored { heads * key_len } else { 0 });
        let mut packed: Buf<K::Elem> = Buf::new(if anchored { 0 } else { heads * key_len });
        let mut all_values: Buf<K::Elem> = Buf::new(heads * value_len);
        let shared = (
            Shared::new(&mut rows),
            Shared::new(&mut packed),
            Shared::new(&mut all_values),
        );
        par_tiles(heads * spans.len(), 1, |task, _| {
            let (head, s) = (task / spans.len(), task % spans.len());
            let (at, span) = (shape.head(head), spans[s]);
            let [n, key_start, value_start] = places[s];
            let mut normed;
            let k = if anchored {
                // SAFETY: every task writes its own span of its own head, here and below.
                unsafe { shared.0.slice(head * key_len + key_start, n * dh) }
            } else {
                normed = Buf::new(n * dh);
                &mut normed[..]
            };
            x.normalised(kernel, shape, at, span, Part::K, k_norm, 1.0, k);
            let value = shared.2.at(head * value_len + value_start);
            let value = kernel.view_rows(value, n, dh);
            let (v, ld) = x.from(shape, at, span.start, Part::V);
            // SAFETY: as above.
            unsafe {
                if !anchored {
                    let key = shared.1.at(head * key_len + key_start);
                    kernel.pack_transposed(k, dh, n, kernel.view_transposed(key, dh, n), 0);
                }
                kernel.pack_rows(v, ld, n, dh, value, 0, 0);
            }
        });
        Self {
            keys: if anchored {
                Form::Rows(rows)
            } else {
                Form::Packed(Element::wrap(packed))
            },
            values: Element::wrap(all_values),
            spans: places,
            lens: [key_len, value_len],
        }
    }

    pub fn is_empty(&self) -> bool {
        self.spans.is_empty()
    }

    /// Span `s` of head `head` (of all batch elements): keys [dh, n] and values [n, dh]. Keys that a `table` turns are
    /// packed in a buffer of `turned`, which must outlive the result.
    pub(super) fn span<'t, K: Kernel>(
        &self,
        kernel: K,
        dh: usize,
        (head, s): (usize, usize),
        table: impl FnOnce(usize) -> Option<&'t [f32]>,
        turned: &mut Vec<Buf<K::Elem>>,
    ) -> Seen<K> {
        let [n, key, value] = self.spans[s];
        let (key, value) = (head * self.lens[0] + key, head * self.lens[1] + value);
        let key = match &self.keys {
            Form::Packed(keys) => {
                let keys: &[K::Elem] = K::Elem::unwrap(keys);
                kernel.view_transposed(keys[key..].as_ptr(), dh, n)
            }
            Form::Rows(keys) => {
                let mut packed = Buf::new(kernel.packed_len(dh, n));
                let view = kernel.view_transposed(packed.as_mut_ptr(), dh, n);
                let table = table(n).expect("keys to be turned come with anchors");
                turned_rows(kernel, &keys[key..][..n * dh], dh, table, |start, k| {
                    // SAFETY: an own buffer.
                    unsafe { kernel.pack_transposed(k, dh, k.len() / dh, view, start) };
                });
                turned.push(packed);
                view
            }
        };
        let values: &[K::Elem] = K::Elem::unwrap(&self.values);
        (key, kernel.view_rows(values[value..].as_ptr(), n, dh))
    }

    /// Memory held.
    pub fn bytes(&self) -> usize {
        let keys = match &self.keys {
            Form::Packed(keys) => keys.bytes(),
            Form::Rows(keys) => keys.bytes(),
        };
        keys + self.values.bytes()
    }
}

/// Runs `f(start, rows)` on consecutive rows of `keys` [n, dh], turned.
pub(super) fn turned_rows<K: Kernel>(
    kernel: K,
    keys: &[f32],
    dh: usize,
    table: &[f32],
    mut f: impl FnMut(usize, &[f32]),
) {
    let mut buffer = Buf::new(TURNED.min(keys.len() / dh) * dh);
    let tables = table.chunks(TURNED * dh / 2);
    for (i, (keys, table)) in keys.chunks(TURNED * dh).zip(tables).enumerate() {
        let rows = &mut buffer[..keys.len()];
        turn(kernel.isa(), keys, dh, table, rows);
        f(i * TURNED, rows);
    }
}
