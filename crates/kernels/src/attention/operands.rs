//! Keys and values as the backward pass reads them, and where their gradients are summed.

use super::anchors::add_turned_back;
use super::keys::turned_rows;
use super::layout::offsets;
use super::{Part, Projected, Shape, Span};
use crate::buffer::Buf;
use crate::gemm::{Kernel, View};
use crate::threads::{Shared, par_tiles};

/// Keys and values of all heads of a sequence.
pub(super) struct Operands<'a, K: Kernel> {
    pub x: Projected<'a>,
    pub shape: Shape,
    spans: &'a [Span],
    keys: Form<K>,
    /// Packed [dh, n].
    values: Buf<K::Elem>,
    /// Elements of a head and starts of its spans: packed [dh, n], and [n, dh] packed or as rows.
    wide: (usize, Vec<usize>),
    tall: (usize, Vec<usize>),
}

/// Normalised keys.
enum Form<K: Kernel> {
    /// Packed [dh, n] and [n, dh].
    Packed(Buf<K::Elem>, Buf<K::Elem>),
    /// Rows [n, dh], which each query group turns its own way.
    Rows(Buf<f32>),
}

impl<'a, K: Kernel> Operands<'a, K> {
    /// `anchored` says whether the keys are yet to be turned.
    pub fn pack(
        kernel: K,
        shape: Shape,
        x: Projected<'a>,
        spans: &'a [Span],
        k_norm: &[f32],
        anchored: bool,
    ) -> Self {
        let (dh, heads) = (shape.head_dim, shape.all_heads());
        let wide = offsets(spans, |n| kernel.packed_len(dh, n));
        let tall = offsets(spans, |n| {
            if anchored {
                n * dh
            } else {
                kernel.packed_len(n, dh)
            }
        });
        let mut values = Buf::new(heads * wide.0);
        let mut keys = if anchored {
            Form::Rows(Buf::new(heads * tall.0))
        } else {
            Form::Packed(Buf::new(heads * wide.0), Buf::new(heads * tall.0))
        };
        let all_values = Shared::new(&mut values);
        let all_keys = match &mut keys {
            Form::Packed(wide, tall) => (Some((Shared::new(wide), Shared::new(tall))), None),
            Form::Rows(rows) => (None, Some(Shared::new(rows))),
        };
        par_tiles(heads * spans.len(), 1, |task, _| {
            let (head, s) = (task / spans.len(), task % spans.len());
            let (at, span) = (shape.head(head), spans[s]);
            let (w, t) = (head * wide.0 + wide.1[s], head * tall.0 + tall.1[s]);
            let (packed, rows) = all_keys;
            let mut normed;
            let k = match rows {
                // SAFETY: every task writes its own span of its own head, here and below.
                Some(rows) => unsafe { rows.slice(t, span.len * dh) },
                None => {
                    normed = Buf::new(span.len * dh);
                    &mut normed[..]
                }
            };
            x.normalised(kernel, shape, at, span, Part::K, k_norm, 1.0, k);
            let (v, ld) = x.from(shape, at, span.start, Part::V);
            let value = kernel.view_transposed(all_values.at(w), dh, span.len);
            // SAFETY: as above.
            unsafe {
                kernel.pack_transposed(v, ld, span.len, value, 0);
                if let Some((keys_t, keys_r)) = packed {
                    let transposed = kernel.view_transposed(keys_t.at(w), dh, span.len);
                    let rows = kernel.view_rows(keys_r.at(t), span.len, dh);
                    kernel.pack_transposed(k, dh, span.len, transposed, 0);
                    kernel.pack_rows(k, dh, span.len, dh, rows, 0, 0);
                }
            }
        });
        Self {
            x,
            shape,
            spans,
            keys,
            values,
            wide,
            tall,
        }
    }

    /// Span `s` of head `head`, turned by `table` if that is to be. Its gradients are summed in `sums`: [2, n, dh], of
    /// which nobody else may touch its part.
    pub fn span<'t>(
        &self,
        kernel: K,
        (head, s): (usize, usize),
        table: Option<&'t [f32]>,
        sums: Shared<f32>,
    ) -> Seen<'t, K> {
        let (dh, span) = (self.shape.head_dim, self.spans[s]);
        let wide = head * self.wide.0 + self.wide.1[s];
        let tall = head * self.tall.0 + self.tall.1[s];
        let values = kernel.view_transposed(self.values[wide..].as_ptr(), dh, span.len);
        let grad_values = sums.at((self.x.rows.n + span.start) * dh);
        let (keys, grad_keys, turned) = match (&self.keys, table) {
            (Form::Packed(keys_t, keys_r), _) => {
                let transposed = kernel.view_transposed(keys_t[wide..].as_ptr(), dh, span.len);
                let rows = kernel.view_rows(keys_r[tall..].as_ptr(), span.len, dh);
                ((transposed, rows), sums.at(span.start * dh), None)
            }
            (Form::Rows(rows), Some(table)) => {
                let rows = &rows[tall..][..span.len * dh];
                let into = (sums, span.start * dh);
                let mut turned = Turned::new(kernel, rows, dh, table, into);
                (turned.views, turned.grad.as_mut_ptr(), Some(turned))
            }
            (Form::Rows(_), None) => unreachable!("keys to be turned come with anchors"),
        };
        Seen {
            transposed: keys.0,
            rows: keys.1,
            values,
            grad_keys,
            grad_values,
            turned,
        }
    }
}

/// One span's keys and values, and where a tile adds their gradients.
pub(super) struct Seen<'t, K: Kernel> {
    /// Keys [dh, n] and [n, dh].
    pub transposed: View<K::Elem>,
    pub rows: View<K::Elem>,
    /// [dh, n]
    pub values: View<K::Elem>,
    pub grad_keys: *mut f32,
    pub grad_values: *mut f32,
    turned: Option<Turned<'t, K>>,
}

impl<K: Kernel> Seen<'_, K> {
    /// Whether `grad_keys` is this group's own, and begins with unspecified contents.
    pub fn is_turned(&self) -> bool {
        self.turned.is_some()
    }

    /// Adds the gradients of turned keys to the sums.
    pub fn turn_back(self, kernel: K, dh: usize) {
        if let Some(turned) = self.turned {
            let (sums, start) = turned.sums;
            // SAFETY: `Operands::span` was promised this part of the sums.
            let sums = unsafe { sums.slice(start, turned.grad.len()) };
            add_turned_back(kernel.isa(), &turned.grad, dh, turned.table, sums);
        }
    }
}

/// Keys as one query group sees them.
struct Turned<'t, K: Kernel> {
    views: (View<K::Elem>, View<K::Elem>),
    _packed: [Buf<K::Elem>; 2],
    /// [n, dh]
    grad: Buf<f32>,
    table: &'t [f32],
    sums: (Shared<f32>, usize),
}

impl<'t, K: Kernel> Turned<'t, K> {
    fn new(
        kernel: K,
        keys: &[f32],
        dh: usize,
        table: &'t [f32],
        sums: (Shared<f32>, usize),
    ) -> Self {
        let n = keys.len() / dh;
        let mut packed = [kernel.packed_len(dh, n), kernel.packed_len(n, dh)].map(Buf::new);
        let transposed = kernel.view_transposed(packed[0].as_mut_ptr(), dh, n);
        let rows = kernel.view_rows(packed[1].as_mut_ptr(), n, dh);
        turned_rows(kernel, keys, dh, table, |start, k| {
            let n = k.len() / dh;
            // SAFETY: own buffers.
            unsafe {
                kernel.pack_transposed(k, dh, n, transposed, start);
                kernel.pack_rows(k, dh, n, dh, rows, start, 0);
            }
        });
        Self {
            views: (transposed, rows),
            _packed: packed,
            grad: Buf::new(n * dh),
            table,
            sums,
        }
    }
}
