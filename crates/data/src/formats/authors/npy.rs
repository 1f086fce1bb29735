//! NumPy's array files, as far as light rays need them: format 1.0, little-endian `f4`, C order, `[n, 10]`.

use lumi_core::light::authors::RayRow;
use lumi_core::{Error, Result};

const MAGIC: &[u8] = b"\x93NUMPY\x01\x00";

/// The rows of a file.
///
/// # Errors
/// Says which part of the file is not as it must be. Nothing is allocated beyond the bytes' own size.
pub(crate) fn parse(bytes: &[u8]) -> Result<Vec<RayRow>> {
    let wrong = |field: &str, expected: &str| Error::value(field, expected);
    let rest = bytes.strip_prefix(MAGIC);
    let rest = rest.ok_or_else(|| wrong("npy", "expected a NumPy 1.0 array file"))?;
    let cut = || wrong("npy header", "expected a complete header");
    let (length, rest) = rest.split_first_chunk::<2>().ok_or_else(cut)?;
    let length = usize::from(u16::from_le_bytes(*length));
    let (header, data) = rest.split_at_checked(length).ok_or_else(cut)?;
    let header: String = header
        .iter()
        .map(|b| char::from(*b))
        .filter(|c| !c.is_whitespace())
        .collect();
    let has = |text: &str| header.contains(text);
    if !has("'descr':'<f4'") || !has("'fortran_order':False") {
        let expected = format!("expected little-endian f4 in C order, found {header}");
        return Err(Error::value("npy header", expected));
    }
    let rows = data.len() / size_of::<RayRow>();
    let shape = format!("'shape':({rows},10)");
    if !has(&shape) || data.len() != rows * size_of::<RayRow>() {
        let expected = format!("expected [n, 10] and its data in full, found {header}");
        return Err(Error::value("npy shape", expected));
    }
    let number = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
    let row = |row: &[u8]| {
        let mut out: RayRow = [0.0; 10];
        for (v, b) in out.iter_mut().zip(row.chunks_exact(4)) {
            *v = number(b);
        }
        out
    };
    Ok(data.chunks_exact(size_of::<RayRow>()).map(row).collect())
}

/// A file of rows.
pub(super) fn encode(rows: &[RayRow]) -> Vec<u8> {
    let mut header = format!(
        "{{'descr': '<f4', 'fortran_order': False, 'shape': ({}, 10), }}",
        rows.len()
    );
    // The data begin at a multiple of 64 bytes, and a newline ends the header.
    let unpadded = MAGIC.len() + 2 + header.len() + 1;
    header.push_str(&" ".repeat(unpadded.next_multiple_of(64) - unpadded));
    header.push('\n');
    let mut bytes = MAGIC.to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.bytes());
    bytes.extend(rows.as_flattened().iter().flat_map(|v| v.to_le_bytes()));
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_come_back_and_broken_files_do_not() {
        let rows: Vec<RayRow> = (0..7).map(|i| [i as f32; 10]).collect();
        let bytes = encode(&rows);
        assert_eq!(bytes.len(), 128 + 7 * 40);
        assert_eq!(parse(&bytes).expect("reads"), rows);
        for n in [0, 5, 9, 60, 128, bytes.len() - 1] {
            assert!(parse(&bytes[..n]).is_err(), "{n}");
        }
        let text = String::from_utf8_lossy(&bytes[10..128]).into_owned();
        for (from, to) in [("<f4", "<f8"), ("False", "True "), ("(7", "(9")] {
            let mut changed = bytes.clone();
            changed[10..128].copy_from_slice(text.replace(from, to).as_bytes());
            assert!(parse(&changed).is_err(), "{to}");
        }
    }
}
