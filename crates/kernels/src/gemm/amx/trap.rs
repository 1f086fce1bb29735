//! Test only: runs the assembly on machines without AMX. The processor refuses the tile
//! instructions; a handler of that signal decodes each from its bytes and computes what the manual
//! says (Intel SDM vol. 2, TILELOADD, TDPBF16PS and the others), then lets the program go on.
//!
//! This checks which instructions the assembler made of `tiles.rs` and `detect.rs`, with which
//! tiles, addresses, strides and loop counts. It is no measurement of real hardware.

use std::cell::RefCell;

use super::{AmxBf16, Compute, Cpu, Kernel, PANEL, detect, tiles};
use crate::buffer::Buf;
use crate::cpu::Precision;

/// Tiles and configuration of the thread under test.
struct State {
    config: [u8; 64],
    tiles: [[[u32; 16]; 16]; 8],
    /// Instructions seen: load, store, zero, multiply, configure and release.
    seen: [usize; 5],
}

thread_local! {
    static STATE: RefCell<State> = const { RefCell::new(State {
        config: [0; 64],
        tiles: [[[0; 16]; 16]; 8],
        seen: [0; 5],
    }) };
}

/// Registers of the interrupted program in the order of their numbers in instructions.
const GENERAL: [i32; 16] = [
    libc::REG_RAX,
    libc::REG_RCX,
    libc::REG_RDX,
    libc::REG_RBX,
    libc::REG_RSP,
    libc::REG_RBP,
    libc::REG_RSI,
    libc::REG_RDI,
    libc::REG_R8,
    libc::REG_R9,
    libc::REG_R10,
    libc::REG_R11,
    libc::REG_R12,
    libc::REG_R13,
    libc::REG_R14,
    libc::REG_R15,
];

extern "C" fn refused(_: i32, _: *mut libc::siginfo_t, context: *mut libc::c_void) {
    // SAFETY: the kernel passes the interrupted program's registers, and its next instruction is
    // readable; its memory operands are what the program itself would access.
    unsafe {
        let registers = &mut (*context.cast::<libc::ucontext_t>()).uc_mcontext.gregs;
        let at = registers[libc::REG_RIP as usize] as *const u8;
        let register = |n: u8| registers[GENERAL[n as usize] as usize] as usize;
        match STATE.with_borrow_mut(|state| step(state, at, register)) {
            Some(len) => registers[libc::REG_RIP as usize] += len as i64,
            None => std::process::abort(),
        }
    }
}

/// Runs one instruction; its length, or `None` if it is none of ours.
unsafe fn step(state: &mut State, at: *const u8, register: impl Fn(u8) -> usize) -> Option<usize> {
    // SAFETY: instructions are at most 15 bytes; ours are at most 10, inside the program's code.
    let code = unsafe { std::slice::from_raw_parts(at, 10) };
    // VEX with three bytes, map 0F38, W0, 128 bits.
    if code[0] != 0xC4 || code[1] & 0x1F != 2 || code[2] & 0x84 != 0 {
        return None;
    }
    let (prefix, vvvv) = (code[2] & 3, !(code[2] >> 3) & 15);
    let (opcode, modrm) = (code[3], code[4]);
    let (mode, reg, rm) = (modrm >> 6, modrm >> 3 & 7, modrm & 7);
    let high = |bit: u8| u8::from(code[1] & bit == 0) << 3;
    if mode == 3 {
        match (opcode, prefix, modrm) {
            (0x49, 0, 0xC0) => {
                state.config = [0; 64];
                state.seen[4] += 1;
            }
            (0x49, 3, _) if rm == 0 => {
                state.tiles[reg as usize] = [[0; 16]; 16];
                state.seen[2] += 1;
            }
            (0x5C, 2, _) => {
                multiply(&mut state.tiles, reg, rm, vvvv);
                state.seen[3] += 1;
            }
            _ => return None,
        }
        return Some(5);
    }
    // A memory operand: base (+ index << scale) + displacement.
    let (base, stride, after) = if rm == 4 {
        let sib = code[5];
        let index = sib >> 3 & 7 | high(0x40);
        let stride = if index == 4 {
            0
        } else {
            register(index) << (sib >> 6)
        };
        (sib & 7 | high(0x20), stride, 6)
    } else {
        (rm | high(0x20), 0, 5)
    };
    let (displacement, len) = match mode {
        0 if base & 7 != 5 => (0, after),
        1 => (code[after] as i8 as isize, after + 1),
        _ => return None,
    };
    let address = register(base).wrapping_add_signed(displacement);
    if (opcode, prefix, reg) == (0x49, 0, 0) {
        // SAFETY: the program's own operand.
        state.config = unsafe { (address as *const [u8; 64]).read() };
        state.seen[4] += 1;
        return Some(len);
    }
    // Tiles must be configured as the kernel says: palette 1, 16 rows of 64 bytes.
    let bytes = u16::from_le_bytes([state.config[16 + 2 * reg as usize], 0]);
    if opcode != 0x4B || (state.config[0], bytes, state.config[48 + reg as usize]) != (1, 64, 16) {
        return None;
    }
    for (r, row) in state.tiles[reg as usize].iter_mut().enumerate() {
        let line = (address + r * stride) as *mut [u32; 16];
        // SAFETY: the program's own operand.
        unsafe {
            match prefix {
                3 => *row = line.read_unaligned(),
                2 => line.write_unaligned(*row),
                _ => return None,
            }
        }
    }
    state.seen[usize::from(prefix == 2)] += 1;
    Some(len)
}

/// TDPBF16PS: `c[m][n] += Σ_k a[m][2k] b[k][2n] + a[m][2k + 1] b[k][2n + 1]`.
fn multiply(tiles: &mut [[[u32; 16]; 16]; 8], c: u8, a: u8, b: u8) {
    let (a, b) = (tiles[a as usize], tiles[b as usize]);
    let low = |x: u32| f32::from_bits(x << 16);
    let high = |x: u32| f32::from_bits(x & 0xFFFF_0000);
    for (row, left) in tiles[c as usize].iter_mut().zip(a) {
        for (n, c) in row.iter_mut().enumerate() {
            let (mut even, mut odd) = (0.0, 0.0);
            for (&a, right) in left.iter().zip(&b) {
                even += low(a) * low(right[n]);
                odd += high(a) * high(right[n]);
            }
            *c = (f32::from_bits(*c) + (even + odd)).to_bits();
        }
    }
}

#[test]
fn assembly_computes_what_the_emulation_does() {
    if !Cpu::AmxEmulated.is_supported() || Cpu::Amx.is_supported() {
        println!("skipped: needs AVX-512 BF16 without AMX (with it, the instructions are tested)");
        return;
    }
    // SAFETY: the handler is async-signal-safe: it touches its thread's state, which the program
    // under test does not.
    let previous = unsafe {
        let mut action: libc::sigaction = std::mem::zeroed();
        let mut previous = action;
        action.sa_sigaction = refused as *const () as usize;
        action.sa_flags = libc::SA_SIGINFO;
        assert_eq!(libc::sigaction(libc::SIGILL, &action, &mut previous), 0);
        previous
    };
    // SAFETY: refused instructions are computed by the handler from here on.
    unsafe { detect::prepare_thread() };
    STATE.with_borrow(|state| assert_eq!(state.seen, [0, 0, 0, 0, 1]));
    for (rows2, cols2, tiles) in [
        (true, true, 4),
        (true, false, 2),
        (false, true, 2),
        (false, false, 1),
    ] {
        let before = STATE.with_borrow(|state| state.seen);
        assert!(detect::agrees(tiles::hardware, rows2, cols2));
        let after = STATE.with_borrow(|state| state.seen);
        // Two runs of three steps; one of them starts from C, the other from zero.
        let loads = 6 * (2 + usize::from(rows2) + usize::from(cols2)) + tiles;
        let counts: Vec<usize> = after.iter().zip(before).map(|(a, b)| a - b).collect();
        assert_eq!(counts, [loads, 2 * tiles, tiles, 6 * tiles, 0]);
    }

    // Whole products of odd sizes, both kinds of left operand.
    let emulated = AmxBf16::new(Compute::new(Precision::Bf16, Cpu::AmxEmulated));
    let hardware = AmxBf16 {
        tiles: tiles::hardware,
        hardware: true,
    };
    for [m, n, k] in [[1, 1, 1], [33, 40, 70], [49, 95, 300], [16, 64, 513]] {
        let value = |i: usize| (i * 7919 % 1009) as f32 / 504.5 - 1.0;
        let a: Vec<f32> = (0..m * k).map(value).collect();
        let b: Vec<f32> = (0..k * n).map(|i| value(i + 31)).collect();
        assert_eq!(
            product(emulated, &a, &b, [m, n, k]),
            product(hardware, &a, &b, [m, n, k])
        );
    }
    // SAFETY: puts back what was there.
    unsafe {
        assert_eq!(
            libc::sigaction(libc::SIGILL, &previous, std::ptr::null_mut()),
            0
        );
    }
}

/// `[a·b, a·b + aᵀ·b]` of a [m, k] (for the second read as [k, m]) and b [k, n].
fn product(kernel: AmxBf16, a: &[f32], b: &[f32], [m, n, k]: [usize; 3]) -> [Vec<f32>; 2] {
    let mut right = Buf::new(kernel.packed_len(k, n));
    let right = kernel.view_rows(right.as_mut_ptr(), k, n);
    let mut rows = Buf::new(kernel.rows_len(m, k));
    let mut turned = Buf::new(kernel.packed_len(k, m.next_multiple_of(PANEL)));
    let turned = kernel.view_rows(turned.as_mut_ptr(), k, m);
    let mut c = vec![0.0; m * n];
    kernel.to_rows(a, k, m, k, &mut rows);
    // SAFETY: operands of the right sizes.
    unsafe {
        kernel.pack_rows(b, n, k, n, right, 0, 0);
        kernel.pack_rows(a, m, k, m, turned, 0, 0);
        kernel.gemm(kernel.left(&rows, m, k), right, c.as_mut_ptr(), n, false);
        let first = c.clone();
        kernel.gemm(super::Lhs::Packed(turned), right, c.as_mut_ptr(), n, true);
        [first, c]
    }
}
