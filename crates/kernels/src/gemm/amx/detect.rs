//! Whether this machine multiplies tiles, and the set-up that the kernel and each thread need.

use std::arch::x86_64::{__cpuid_count, _xgetbv};
use std::cell::Cell;
use std::sync::OnceLock;

use super::tiles::{self, Block, LEFT, RIGHT, TILE, TileFn};

/// Whether the processor has the instructions, the system lets this process use them, and they give
/// the right result. Asked once per process.
pub(crate) fn available() -> bool {
    static AVAILABLE: OnceLock<bool> = OnceLock::new();
    *AVAILABLE.get_or_init(|| {
        has_instructions() && may_use_tiles() && {
            // SAFETY: the instructions exist, and tile data is permitted.
            unsafe { configure() };
            let right = [(true, true), (true, false), (false, true), (false, false)]
                .into_iter()
                .all(|(rows2, cols2)| agrees(tiles::hardware, rows2, cols2));
            // SAFETY: as above; the tiles' state is nobody's any more.
            unsafe { std::arch::asm!("tilerelease", options(nostack, nomem)) };
            right
        }
    })
}

/// Configures the tiles of this thread, once.
///
/// # Safety
/// [`available`] returned true.
pub(super) unsafe fn prepare_thread() {
    thread_local!(static READY: Cell<bool> = const { Cell::new(false) });
    READY.with(|ready| {
        if !ready.replace(true) {
            // SAFETY: the caller's promise.
            unsafe { configure() };
        }
    });
}

/// CPUID leaf 7 and the state that the operating system saves (XCR0).
fn has_instructions() -> bool {
    #[target_feature(enable = "xsave")]
    fn xcr0() -> u64 {
        // SAFETY: the function is called only where the system has enabled XSAVE.
        unsafe { _xgetbv(0) }
    }
    const AMX_BF16: u32 = 1 << 22;
    const AMX_TILE: u32 = 1 << 24;
    const TILE_STATE: u64 = 0b11 << 17;
    const OSXSAVE: u32 = 1 << 27;
    if __cpuid_count(0, 0).eax < 7 || __cpuid_count(1, 0).ecx & OSXSAVE == 0 {
        return false;
    }
    let features = __cpuid_count(7, 0).edx;
    // SAFETY: OSXSAVE says that XGETBV works.
    features & AMX_TILE != 0
        && features & AMX_BF16 != 0
        && unsafe { xcr0() } & TILE_STATE == TILE_STATE
}

/// Asks Linux for the tiles' large register state; other systems are not supported.
fn may_use_tiles() -> bool {
    #[cfg(target_os = "linux")]
    {
        const ARCH_PRCTL: i64 = 158;
        const ARCH_REQ_XCOMP_PERM: usize = 0x1023;
        const XTILEDATA: usize = 18;
        let result: i64;
        // SAFETY: arch_prctl(ARCH_REQ_XCOMP_PERM) reads and writes none of our memory. The
        // `syscall` instruction changes rcx and r11.
        unsafe {
            std::arch::asm!(
                "syscall",
                inlateout("rax") ARCH_PRCTL => result,
                in("rdi") ARCH_REQ_XCOMP_PERM,
                in("rsi") XTILEDATA,
                out("rcx") _,
                out("r11") _,
                options(nostack),
            );
        }
        result == 0
    }
    #[cfg(not(target_os = "linux"))]
    false
}

/// The layout that LDTILECFG reads.
#[repr(C, align(64))]
struct Config {
    palette: u8,
    start_row: u8,
    reserved: [u8; 14],
    bytes_per_row: [u16; 16],
    rows: [u8; 16],
}

/// All eight tiles as 16 rows of 64 bytes.
unsafe fn configure() {
    let mut config = Config {
        palette: 1,
        start_row: 0,
        reserved: [0; 14],
        bytes_per_row: [0; 16],
        rows: [0; 16],
    };
    config.bytes_per_row[..8].fill(64);
    config.rows[..8].fill(16);
    // SAFETY: the caller has checked the instructions; `config` is 64 bytes, aligned.
    unsafe {
        std::arch::asm!(
            "ldtilecfg [{}]",
            in(reg) &raw const config,
            options(nostack, readonly),
        );
    }
}

/// Whether `f` gives the emulation's result for a small block, with sums added to C and without.
pub(super) fn agrees(f: TileFn, rows2: bool, cols2: bool) -> bool {
    const STEPS: usize = 3;
    const SIDE: usize = 2 * TILE;
    // bf16 numbers of both signs between 1/2 and 2.
    let mut state = 0x9E37_79B9_u32;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        0x3F00 | ((state >> 16) as u16 & 0x80FF)
    };
    let a: Vec<u16> = (0..2 * STEPS * LEFT).map(|_| next()).collect();
    let b: Vec<u16> = (0..STEPS * RIGHT).map(|_| next()).collect();
    [false, true].into_iter().all(|add| {
        let run = |f: TileFn| {
            let mut c = vec![0.5f32; SIDE * SIDE];
            let block = Block {
                a: [a.as_ptr(), a[STEPS * LEFT..].as_ptr()],
                b: b.as_ptr(),
                c: c.as_mut_ptr(),
                ldc: SIDE,
                steps: STEPS,
                add,
                rows2,
                cols2,
            };
            // SAFETY: operands and C are of full size; the caller has prepared this thread.
            unsafe { f(&block) };
            c
        };
        // Sums of 96 products below 4: a wrong layout is off by far more than another order.
        let pairs = run(f).into_iter().zip(run(tiles::emulated));
        pairs
            .into_iter()
            .all(|(got, want)| (got - want).abs() < 1e-3)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hardware_agrees_with_the_emulation() {
        if !(has_instructions() && may_use_tiles()) {
            println!("skipped: this machine has no AMX, so its instructions are not tested");
            return;
        }
        assert!(available(), "the tiles give a wrong result");
    }

    #[test]
    fn the_check_notices_a_wrong_block() {
        unsafe fn wrong(block: &Block) {
            let mut block = *block;
            block.steps -= 1;
            // SAFETY: as for the caller, with less to read.
            unsafe { tiles::emulated(&block) };
        }
        assert!(agrees(tiles::emulated, true, true));
        assert!(!agrees(wrong, true, true));
        assert!(!agrees(wrong, false, false));
    }

    #[test]
    fn configuration_is_as_the_instruction_reads_it() {
        assert_eq!(size_of::<Config>(), 64);
        assert_eq!(std::mem::offset_of!(Config, bytes_per_row), 16);
        assert_eq!(std::mem::offset_of!(Config, rows), 48);
    }

    #[test]
    fn the_emulation_multiplies() {
        // An independent count: element (r, k) of A is r + 1 at k = 5 only, B's row 5 is c + 1.
        let bf16 = |x: f32| (x.to_bits() >> 16) as u16;
        let mut a = vec![0u16; 2 * LEFT];
        let mut b = vec![0u16; RIGHT];
        for r in 0..32 {
            a[r / 16 * LEFT + r % 16 * 32 + 5] = bf16((r + 1) as f32);
            b[5 / 2 * 64 + 2 * r + 1] = bf16((r + 1) as f32);
        }
        let mut c = vec![1.0f32; 32 * 40];
        let block = Block {
            a: [a.as_ptr(), a[LEFT..].as_ptr()],
            b: b.as_ptr(),
            c: c.as_mut_ptr(),
            ldc: 40,
            steps: 1,
            add: true,
            rows2: true,
            cols2: true,
        };
        // SAFETY: full operands.
        unsafe { tiles::emulated(&block) };
        for r in 0..32 {
            for n in 0..40 {
                let want = if n < 32 {
                    1.0 + ((r + 1) * (n + 1)) as f32
                } else {
                    1.0
                };
                assert_eq!(c[r * 40 + n], want);
            }
        }
    }
}
