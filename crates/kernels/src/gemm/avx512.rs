//! stub
pub(crate) use super::portable::PortableF32 as Avx512Bf16;
