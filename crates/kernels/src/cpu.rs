//! Which instructions to use, and in which precision: decided once, at run time.

use std::sync::OnceLock;

/// Precision of the operands of matrix products; everything else is always `f32`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// `f32` operands and sums: about 1e-6 relative error, for parity.
    F32,
    /// `bf16` operands, `f32` sums: about 2e-3 relative error, for speed.
    /// On a path without bf16 instructions this computes in `f32`.
    Bf16,
}

/// A family of instructions the kernels are written for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cpu {
    /// Any machine, through the `gemm` crate (which itself uses AVX2, AVX-512 or NEON).
    Portable,
    /// x86-64 with AVX2 and FMA; always f32.
    Avx2,
    /// x86-64 with AVX-512 F, BW, DQ and VL; always f32.
    Avx512F32,
    /// x86-64 with AVX-512 F, BW, DQ, VL and BF16; f32 as `Avx512F32`.
    Avx512,
    /// That and AMX tiles for bf16, on Linux.
    Amx,
    /// The AMX kernel with its tile instructions computed in plain Rust: slow, for tests of
    /// everything around them on machines with AVX-512 alone. Never chosen by itself.
    AmxEmulated,
}

impl Cpu {
    /// All families with their names in `LUMI_CPU`; of those that choose themselves the best comes first.
    pub const ALL: [(Self, &str); 6] = [
        (Self::Amx, "amx"),
        (Self::Avx512, "avx512"),
        (Self::Avx512F32, "avx512-f32"),
        (Self::Avx2, "avx2"),
        (Self::Portable, "portable"),
        (Self::AmxEmulated, "amx-emulated"),
    ];

    /// The best supported family, or the one that `LUMI_CPU=amx|avx512|avx512-f32|avx2|portable|amx-emulated`
    /// names.
    ///
    /// # Errors
    /// If `LUMI_CPU` names an unknown family or one this machine does not have.
    pub fn from_env() -> Result<Self, String> {
        let asked = std::env::var("LUMI_CPU").unwrap_or_default();
        if asked.is_empty() {
            let best = Self::ALL.iter().find(|(cpu, _)| cpu.is_supported());
            return Ok(best.map_or(Self::Portable, |(cpu, _)| *cpu));
        }
        match Self::ALL.iter().find(|(_, name)| *name == asked) {
            Some((cpu, _)) if cpu.is_supported() => Ok(*cpu),
            Some(_) => Err(format!("LUMI_CPU={asked}: this machine does not have it")),
            None => {
                let names = Self::ALL.map(|(_, name)| name).join(", ");
                Err(format!("LUMI_CPU={asked}: expected one of {names}"))
            }
        }
    }

    /// [`Self::from_env`], decided once per process.
    ///
    /// # Panics
    /// Where that is an error; programs check it first.
    pub fn detect() -> Self {
        static CPU: OnceLock<Cpu> = OnceLock::new();
        *CPU.get_or_init(|| Self::from_env().unwrap_or_else(|e| panic!("{e}")))
    }

    /// Whether this machine has the instructions.
    ///
    /// For AMX this includes the system's permission and a small product that must come out right;
    /// both are asked for once per process.
    pub fn is_supported(self) -> bool {
        match self {
            Self::Portable => true,
            Self::Avx2 => has_avx2(),
            Self::Avx512F32 => has_avx512(),
            Self::Avx512 | Self::AmxEmulated => has_avx512_bf16(),
            #[cfg(target_arch = "x86_64")]
            Self::Amx => has_avx512_bf16() && crate::gemm::amx::available(),
            #[cfg(not(target_arch = "x86_64"))]
            Self::Amx => false,
        }
    }
}

fn has_avx2() -> bool {
    #[cfg(target_arch = "x86_64")]
    {
        is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")
    }
    #[cfg(not(target_arch = "x86_64"))]
    false
}

fn has_avx512() -> bool {
    #[cfg(target_arch = "x86_64")]
    {
        is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512vl")
            && has_avx2()
    }
    #[cfg(not(target_arch = "x86_64"))]
    false
}

fn has_avx512_bf16() -> bool {
    #[cfg(target_arch = "x86_64")]
    {
        has_avx512() && is_x86_feature_detected!("avx512bf16")
    }
    #[cfg(not(target_arch = "x86_64"))]
    false
}

/// Precision and instructions together; `Precision` alone converts into it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Compute {
    precision: Precision,
    cpu: Cpu,
}

impl Compute {
    /// Forces a family of instructions.
    ///
    /// # Panics
    /// If this machine does not have them.
    pub fn new(precision: Precision, cpu: Cpu) -> Self {
        assert!(cpu.is_supported(), "this machine has no {cpu:?}");
        Self { precision, cpu }
    }

    /// Precision of matrix operands.
    pub fn precision(self) -> Precision {
        self.precision
    }

    /// Family of instructions; supported by construction.
    pub fn cpu(self) -> Cpu {
        self.cpu
    }

    pub(crate) fn isa(self) -> Isa {
        match self.cpu {
            Cpu::Portable => Isa::portable(),
            Cpu::Avx2 => Isa::Avx2,
            Cpu::Avx512F32 | Cpu::Avx512 | Cpu::Amx | Cpu::AmxEmulated => Isa::Avx512,
        }
    }
}

impl From<Precision> for Compute {
    fn from(precision: Precision) -> Self {
        Self {
            precision,
            cpu: Cpu::detect(),
        }
    }
}

/// Instruction set of the row-wise passes. Values other than `Base` only exist on machines that
/// have the instructions: they are made here, after detection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(not(target_arch = "x86_64"), allow(dead_code))]
pub(crate) enum Isa {
    Base,
    Avx2,
    Avx512,
}

impl Isa {
    /// The widest instructions there are, for the portable path.
    fn portable() -> Self {
        if has_avx512() {
            Self::Avx512
        } else if has_avx2() {
            Self::Avx2
        } else {
            Self::Base
        }
    }
}
