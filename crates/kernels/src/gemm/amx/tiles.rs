//! The one operation that needs the tile registers: a 32 x 32 block of C over a whole run of k.
//!
//! Two implementations of one signature, [`TileFn`]: the instructions, in inline assembly because
//! their intrinsics are unstable, and the same arithmetic in plain Rust. Everything above them
//! (packing, tiling, edges) is common, so that tests cover it on machines without AMX.

/// Rows of a tile, and its columns of f32; a block is 2 x 2 tiles.
pub(super) const TILE: usize = 16;
/// k of one step: 16 pairs of bf16 fill a tile's row.
pub(super) const STEP: usize = 32;
/// u16 elements of a left tile, and of a panel's rows for one step.
pub(super) const LEFT: usize = TILE * STEP;
pub(super) const RIGHT: usize = STEP * super::PANEL;

/// A block's operands.
///
/// Left tiles hold rows r = 0..16 of 32 k, element (r, k) at `32 r + k`; one strip's tiles follow
/// each other in k. The panel holds pairs of k as the AVX-512 kernel packs them: element (k, c) at
/// `k/2 * 64 + 2 c + k%2`.
#[derive(Clone, Copy)]
pub(super) struct Block {
    /// Rows 0..16, and rows 16..32 if `rows2`.
    pub a: [*const u16; 2],
    pub b: *const u16,
    /// Row-major, stride `ldc` floats.
    pub c: *mut f32,
    pub ldc: usize,
    /// Steps of k.
    pub steps: usize,
    /// C += A·B rather than C = A·B.
    pub add: bool,
    /// Whether the second strip of rows and the second half of the columns are computed.
    pub rows2: bool,
    pub cols2: bool,
}

/// # Safety
/// The operands are readable and C is writable over all rows and columns that the block computes;
/// `prepare_thread` ran on this thread before the hardware's function.
pub(super) type TileFn = unsafe fn(&Block);

/// What TDPBF16PS computes, step by step: per step, the even and the odd k of an element are summed
/// apart, then together, then into C. (The hardware also flushes denormals to zero.)
pub(super) unsafe fn emulated(block: &Block) {
    let wide = |x: u16| f32::from_bits(u32::from(x) << 16);
    for (i, &a) in block
        .a
        .iter()
        .enumerate()
        .take(1 + usize::from(block.rows2))
    {
        for j in 0..1 + usize::from(block.cols2) {
            for r in 0..TILE {
                // SAFETY: all indices are inside the operands that the caller describes.
                unsafe {
                    let c = block.c.add((i * TILE + r) * block.ldc + j * TILE);
                    let c = &mut *c.cast::<[f32; TILE]>();
                    if !block.add {
                        *c = [0.0; TILE];
                    }
                    for step in 0..block.steps {
                        let a = &*a.add(step * LEFT + r * STEP).cast::<[u16; STEP]>();
                        let (mut even, mut odd) = ([0.0f32; TILE], [0.0f32; TILE]);
                        for p in 0..STEP / 2 {
                            let b = block.b.add(step * RIGHT + p * 2 * super::PANEL);
                            let b = &*b.add(2 * j * TILE).cast::<[u16; 2 * TILE]>();
                            let (a0, a1) = (wide(a[2 * p]), wide(a[2 * p + 1]));
                            for n in 0..TILE {
                                even[n] += a0 * wide(b[2 * n]);
                                odd[n] += a1 * wide(b[2 * n + 1]);
                            }
                        }
                        for n in 0..TILE {
                            c[n] += even[n] + odd[n];
                        }
                    }
                }
            }
        }
    }
}

/// The instructions; see [`TileFn`] for what must hold.
pub(super) unsafe fn hardware(block: &Block) {
    // SAFETY: the caller's promise.
    unsafe {
        match (block.rows2, block.cols2) {
            (true, true) => hardware22(block),
            (true, false) => hardware21(block),
            (false, true) => hardware12(block),
            (false, false) => hardware11(block),
        }
    }
}

/// One k-loop in one piece of assembly: the compiler knows no tile registers, so sums must not
/// stay in them between pieces. Registers: tmm0-3 sums, tmm4-5 left, tmm6-7 right.
macro_rules! tile_loop {
    ($name:ident, [$($load:literal)*], [$($zero:literal)*], [$($step:literal)*], [$($store:literal)*]) => {
        unsafe fn $name(block: &Block) {
            // SAFETY: reads and writes what `Block` describes, by the caller's promise. Tiles are
            // configured as 16 rows of 64 bytes.
            unsafe {
                std::arch::asm!(
                    "test {add}, {add}",
                    "jz 2f",
                    $($load,)*
                    "jmp 3f",
                    "2:",
                    $($zero,)*
                    "3:",
                    "test {steps}, {steps}",
                    "jz 5f",
                    "4:",
                    $($step,)*
                    "add {a0}, 1024",
                    "add {a1}, 1024",
                    "add {b}, 2048",
                    "dec {steps}",
                    "jnz 4b",
                    "5:",
                    $($store,)*
                    "# {c1} is not read by blocks of one strip",
                    a0 = inout(reg) block.a[0] => _,
                    a1 = inout(reg) block.a[1] => _,
                    b = inout(reg) block.b => _,
                    c0 = in(reg) block.c,
                    c1 = in(reg) block.c.wrapping_add(TILE * block.ldc),
                    ldc = in(reg) block.ldc * size_of::<f32>(),
                    steps = inout(reg) block.steps => _,
                    add = in(reg) usize::from(block.add),
                    left = in(reg) 2 * STEP,
                    right = in(reg) 4 * super::PANEL,
                    out("tmm0") _, out("tmm1") _, out("tmm2") _, out("tmm3") _,
                    out("tmm4") _, out("tmm5") _, out("tmm6") _, out("tmm7") _,
                    options(nostack),
                );
            }
        }
    };
}

tile_loop!(
    hardware22,
    [
        "tileloadd tmm0, [{c0} + {ldc}*1]"
        "tileloadd tmm1, [{c0} + {ldc}*1 + 64]"
        "tileloadd tmm2, [{c1} + {ldc}*1]"
        "tileloadd tmm3, [{c1} + {ldc}*1 + 64]"
    ],
    ["tilezero tmm0" "tilezero tmm1" "tilezero tmm2" "tilezero tmm3"],
    [
        "tileloadd tmm4, [{a0} + {left}*1]"
        "tileloadd tmm6, [{b} + {right}*1]"
        "tileloadd tmm7, [{b} + {right}*1 + 64]"
        "tdpbf16ps tmm0, tmm4, tmm6"
        "tileloadd tmm5, [{a1} + {left}*1]"
        "tdpbf16ps tmm1, tmm4, tmm7"
        "tdpbf16ps tmm2, tmm5, tmm6"
        "tdpbf16ps tmm3, tmm5, tmm7"
    ],
    [
        "tilestored [{c0} + {ldc}*1], tmm0"
        "tilestored [{c0} + {ldc}*1 + 64], tmm1"
        "tilestored [{c1} + {ldc}*1], tmm2"
        "tilestored [{c1} + {ldc}*1 + 64], tmm3"
    ]
);
tile_loop!(
    hardware21,
    ["tileloadd tmm0, [{c0} + {ldc}*1]" "tileloadd tmm2, [{c1} + {ldc}*1]"],
    ["tilezero tmm0" "tilezero tmm2"],
    [
        "tileloadd tmm4, [{a0} + {left}*1]"
        "tileloadd tmm6, [{b} + {right}*1]"
        "tileloadd tmm5, [{a1} + {left}*1]"
        "tdpbf16ps tmm0, tmm4, tmm6"
        "tdpbf16ps tmm2, tmm5, tmm6"
    ],
    ["tilestored [{c0} + {ldc}*1], tmm0" "tilestored [{c1} + {ldc}*1], tmm2"]
);
tile_loop!(
    hardware12,
    ["tileloadd tmm0, [{c0} + {ldc}*1]" "tileloadd tmm1, [{c0} + {ldc}*1 + 64]"],
    ["tilezero tmm0" "tilezero tmm1"],
    [
        "tileloadd tmm4, [{a0} + {left}*1]"
        "tileloadd tmm6, [{b} + {right}*1]"
        "tileloadd tmm7, [{b} + {right}*1 + 64]"
        "tdpbf16ps tmm0, tmm4, tmm6"
        "tdpbf16ps tmm1, tmm4, tmm7"
    ],
    ["tilestored [{c0} + {ldc}*1], tmm0" "tilestored [{c0} + {ldc}*1 + 64], tmm1"]
);
tile_loop!(
    hardware11,
    ["tileloadd tmm0, [{c0} + {ldc}*1]"],
    ["tilezero tmm0"],
    [
        "tileloadd tmm4, [{a0} + {left}*1]"
        "tileloadd tmm6, [{b} + {right}*1]"
        "tdpbf16ps tmm0, tmm4, tmm6"
    ],
    ["tilestored [{c0} + {ldc}*1], tmm0"]
);
