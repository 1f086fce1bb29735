//! TensorBoard event files: scalars and pictures.
//!
//! A file is a row of records, each an `Event` message of TensorFlow's `event.proto` in protocol-buffer encoding, framed
//! as TFRecord: length, checksum of the length, message, checksum of the message. Few fields are needed, so they are
//! encoded here.

use lumi_core::{Error, Result};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// A file that events are appended to.
pub struct EventFile {
    file: File,
    path: PathBuf,
}

impl EventFile {
    /// A new file in `folder`. TensorBoard joins the files of a folder by step, so that a resumed run goes on in one curve.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn create(folder: &Path) -> Result<Self> {
        let now = seconds();
        // Two runs within a second get different names.
        let names = (0..).map(|i| folder.join(format!("events.out.tfevents.{now:.0}.{i}.lumi")));
        for path in names {
            match File::create_new(&path) {
                Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => {}
                Err(e) => return Err(Error::io(&path, e)),
                Ok(file) => {
                    let mut events = Self { file, path };
                    let mut event = Message::default();
                    event.double(1, now);
                    event.bytes(3, b"brain.Event:2");
                    events.append(&event)?;
                    return Ok(events);
                }
            }
        }
        unreachable!("there are always more numbers")
    }

    /// One number.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn scalar(&mut self, tag: &str, step: u64, value: f32) -> Result<()> {
        let mut entry = Message::default();
        entry.bytes(1, tag.as_bytes());
        entry.float(2, value);
        self.summary(step, &entry)
    }

    /// One RGB picture as PNG.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn picture(&mut self, tag: &str, step: u64, size: [usize; 2], png: &[u8]) -> Result<()> {
        let [width, height] = size;
        let mut image = Message::default();
        image.integer(1, height as u64);
        image.integer(2, width as u64);
        image.integer(3, 3);
        image.bytes(4, png);
        let mut entry = Message::default();
        entry.bytes(1, tag.as_bytes());
        entry.bytes(4, &image.0);
        self.summary(step, &entry)
    }

    fn summary(&mut self, step: u64, entry: &Message) -> Result<()> {
        let mut summary = Message::default();
        summary.bytes(1, &entry.0);
        let mut event = Message::default();
        event.double(1, seconds());
        event.integer(2, step);
        event.bytes(5, &summary.0);
        self.append(&event)
    }

    fn append(&mut self, event: &Message) -> Result<()> {
        let length = (event.0.len() as u64).to_le_bytes();
        let mut record = Vec::with_capacity(event.0.len() + 16);
        record.extend(length);
        record.extend(masked(&length).to_le_bytes());
        record.extend(&event.0);
        record.extend(masked(&event.0).to_le_bytes());
        self.file
            .write_all(&record)
            .map_err(|e| Error::io(&self.path, e))
    }
}

fn seconds() -> f64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0.0, |d| d.as_secs_f64())
}

/// TFRecord's checksum: CRC-32C, rotated and offset so that data that holds checksums is safe.
fn masked(data: &[u8]) -> u32 {
    crc32c::crc32c(data)
        .rotate_right(15)
        .wrapping_add(0xa282_ead8)
}

/// A protocol-buffer message as its bytes.
#[derive(Default)]
struct Message(Vec<u8>);

impl Message {
    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.0.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
    }

    fn key(&mut self, field: u64, wire: u64) {
        self.varint(field << 3 | wire);
    }

    fn integer(&mut self, field: u64, value: u64) {
        self.key(field, 0);
        self.varint(value);
    }

    fn double(&mut self, field: u64, value: f64) {
        self.key(field, 1);
        self.0.extend(value.to_le_bytes());
    }

    fn bytes(&mut self, field: u64, value: &[u8]) {
        self.key(field, 2);
        self.varint(value.len() as u64);
        self.0.extend(value);
    }

    fn float(&mut self, field: u64, value: f32) {
        self.key(field, 5);
        self.0.extend(value.to_le_bytes());
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn records_are_framed_with_their_checksums() {
        let folder = tempfile::tempdir().unwrap();
        let mut events = EventFile::create(folder.path()).unwrap();
        events.scalar("loss", 300, 0.5).unwrap();
        events.picture("p", 1, [2, 1], b"png").unwrap();
        let bytes = std::fs::read(&events.path).unwrap();
        let mut rest = &bytes[..];
        let mut messages = Vec::new();
        while !rest.is_empty() {
            let length = u64::from_le_bytes(rest[..8].try_into().unwrap()) as usize;
            let sum = |at: usize| u32::from_le_bytes(rest[at..at + 4].try_into().unwrap());
            assert_eq!(sum(8), masked(&rest[..8]));
            assert_eq!(sum(12 + length), masked(&rest[12..12 + length]));
            messages.push(&rest[12..12 + length]);
            rest = &rest[16 + length..];
        }
        assert_eq!(messages.len(), 3);
        // Field 2 (step) as varint 300, then field 5 (summary) with tag and value, byte by byte.
        let tail = [
            0x10, 0xac, 0x02, 0x2a, 0x0d, 0x0a, 0x0b, 0x0a, 0x04, b'l', b'o', b's', b's', 0x15, 0,
            0, 0, 0x3f,
        ];
        assert_eq!(messages[1][9..], tail);
        // CRC-32C of "123456789" is the check value of the algorithm.
        assert_eq!(crc32c::crc32c(b"123456789"), 0xe306_9283);
    }
}
