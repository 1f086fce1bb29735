//! What the tests of several crates share: the place of shared files, and golden tensors as plain arrays.
//!
//! All but [`extra`] panics on trouble: a test whose data is missing must fail, not pass silently.

use safetensors::{Dtype, SafeTensors};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A file or folder of the test data, `tests/data` in the workspace.
///
/// # Panics
/// If it does not exist.
#[must_use]
pub fn shared(path: &str) -> PathBuf {
    let full = workspace().join("tests/data").join(path);
    assert!(full.exists(), "test data {} not found", full.display());
    full
}

/// A file or folder of what is too large for the repository, or may not be in it: beside the workspace in `shared`, or where the
/// environment variable `LUMITOKENS_SHARED` says. `None`, and a line that says so, where it is not there: a test then checks
/// what it can without.
#[must_use]
pub fn extra(path: &str) -> Option<PathBuf> {
    let root = std::env::var_os("LUMITOKENS_SHARED")
        .map_or_else(|| workspace().join("../shared"), PathBuf::from);
    let full = root.join(path);
    if full.exists() {
        return Some(full);
    }
    println!("not checked: {} is not there", full.display());
    None
}

/// The folder of the bundled scene and its manifest.
#[must_use]
pub fn demo() -> PathBuf {
    workspace().join("assets/demo")
}

fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// One tensor as `f32`, whatever its type in the file (integers become their values).
#[derive(Clone, Debug)]
pub struct Tensor {
    /// Sizes of the axes, outermost first.
    pub shape: Vec<usize>,
    /// Row-major values.
    pub data: Vec<f32>,
}

impl Tensor {
    /// The values as rows of `N`.
    ///
    /// # Panics
    /// If they do not divide into such rows.
    #[must_use]
    pub fn rows<const N: usize>(&self) -> Vec<[f32; N]> {
        assert_eq!(self.data.len() % N, 0, "rows of {N} in {:?}", self.shape);
        let row = |chunk: &[f32]| std::array::from_fn(|i| chunk[i]);
        self.data.chunks_exact(N).map(row).collect()
    }

    /// Largest absolute difference from `other`.
    ///
    /// # Panics
    /// If the lengths differ.
    #[must_use]
    pub fn max_difference(&self, other: &[f32]) -> f32 {
        assert_eq!(
            self.data.len(),
            other.len(),
            "length against {:?}",
            self.shape
        );
        let difference = |(a, b): (&f32, &f32)| (a - b).abs();
        self.data
            .iter()
            .zip(other)
            .map(difference)
            .fold(0.0, |m, d| if d > m || d.is_nan() { d } else { m })
    }
}

/// All tensors of a shared safetensors file.
///
/// # Panics
/// If the file is missing, malformed or holds a type other than f32, f64, i64, i32 or u8.
#[must_use]
pub fn golden(path: &str) -> BTreeMap<String, Tensor> {
    let path = shared(path);
    let fail = |what: String| -> ! { panic!("{}: {what}", path.display()) };
    let bytes = std::fs::read(&path).unwrap_or_else(|e| fail(e.to_string()));
    let file = SafeTensors::deserialize(&bytes).unwrap_or_else(|e| fail(e.to_string()));
    file.iter()
        .map(|(name, view)| {
            let raw = view.data();
            let data = match view.dtype() {
                Dtype::F32 => numbers(raw, |b: [u8; 4]| f32::from_le_bytes(b)),
                Dtype::F64 => numbers(raw, |b: [u8; 8]| f64::from_le_bytes(b) as f32),
                Dtype::I64 => numbers(raw, |b: [u8; 8]| i64::from_le_bytes(b) as f32),
                Dtype::I32 => numbers(raw, |b: [u8; 4]| i32::from_le_bytes(b) as f32),
                Dtype::U8 => raw.iter().map(|&b| f32::from(b)).collect(),
                other => fail(format!("{name} has type {other:?}")),
            };
            (
                name.to_owned(),
                Tensor {
                    shape: view.shape().to_vec(),
                    data,
                },
            )
        })
        .collect()
}

fn numbers<const N: usize>(raw: &[u8], decode: impl Fn([u8; N]) -> f32) -> Vec<f32> {
    raw.chunks_exact(N)
        .map(|c| decode(std::array::from_fn(|i| c[i])))
        .collect()
}
