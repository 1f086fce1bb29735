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
    /// x86-64 with AVX-512 F, BW, DQ, VL and BF16.
    Avx512,
    // AMX tiles belong here: a variant, a `Kernel` in `gemm/amx.rs`, a line in `with_kernel!`.
}

impl Cpu {
    /// The best supported family, or the one that `LUMI_CPU=portable|avx512` names.
    ///
    /// # Errors
    /// If `LUMI_CPU` names an unknown family or one this machine does not have.
    pub fn from_env() -> Result<Self, String> {
        let cpu = match std::env::var("LUMI_CPU").as_deref() {
            Err(_) | Ok("") if Self::Avx512.is_supported() => Self::Avx512,
            Err(_) | Ok("" | "portable") => Self::Portable,
            Ok("avx512") => Self::Avx512,
            Ok(other) => return Err(format!("LUMI_CPU={other}: expected portable or avx512")),
        };
        if cpu.is_supported() {
            Ok(cpu)
        } else {
            Err(format!("LUMI_CPU: this machine has no {cpu:?}"))
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
    pub fn is_supported(self) -> bool {
        match self {
            Self::Portable => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => {
                is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512bw")
                    && is_x86_feature_detected!("avx512dq")
                    && is_x86_feature_detected!("avx512vl")
                    && is_x86_feature_detected!("avx512bf16")
                    && is_x86_feature_detected!("avx2")
                    && is_x86_feature_detected!("fma")
            }
            #[cfg(not(target_arch = "x86_64"))]
            Self::Avx512 => false,
        }
    }
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
            Cpu::Avx512 => Isa::Avx512,
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
    /// The widest instructions that the portable path trusts.
    fn portable() -> Self {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            return Self::Avx2;
        }
        Self::Base
    }
}
