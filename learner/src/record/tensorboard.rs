//! TensorBoard's event files: scalars over steps, as records of protocol buffers.
//!
//! A record is its length (u64, little-endian), the masked CRC-32C of those eight bytes, the payload, and the
//! payload's masked CRC-32C. A payload is an `Event` message; of its fields only those named here are
//! written. The writer is our own because the crates that offer one depend on unmaintained ones.

use super::error::{RecordError, io};
use std::fs::{File, OpenOptions};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// What the names of event files begin with.
const PREFIX: &str = "events.out.tfevents.";
/// Version of the format that TensorBoard expects in the first event.
const FILE_VERSION: &str = "brain.Event:2";

/// What an event says.
enum Content<'a> {
    /// The file's format, in its first event.
    FileVersion,
    /// The process starts: points of earlier files from this step on are void.
    Start,
    /// Values by tag.
    Scalars(&'a [(&'a str, f32)]),
}

/// An open event file. Buffered until [`EventWriter::flush`].
#[derive(Debug)]
pub(super) struct EventWriter {
    path: PathBuf,
    file: BufWriter<File>,
    record: Vec<u8>,
}

impl EventWriter {
    /// A new file beside those already in `dir`, named so that TensorBoard reads it after them. Of what they
    /// hold, TensorBoard drops the points from step `first_step` on.
    pub(super) fn create(dir: &Path, first_step: u64) -> Result<Self, RecordError> {
        let stamp = (wall_time() as u64).max(newest_stamp(dir)?.map_or(0, |newest| newest + 1));
        let path = dir.join(format!("{PREFIX}{stamp:010}.{}.{}", host_name(), std::process::id()));
        let file =
            OpenOptions::new().write(true).create_new(true).open(&path).map_err(io("create", &path))?;
        let mut writer = Self { path, file: BufWriter::new(file), record: Vec::new() };
        writer.write(0, &Content::FileVersion)?;
        writer.write(first_step, &Content::Start)?;
        writer.flush()?;
        Ok(writer)
    }

    /// Adds one point to the curve of each tag.
    pub(super) fn scalars(&mut self, step: u64, values: &[(&str, f32)]) -> Result<(), RecordError> {
        self.write(step, &Content::Scalars(values))
    }

    /// Hands all events to the operating system.
    pub(super) fn flush(&mut self) -> Result<(), RecordError> {
        self.file.flush().map_err(io("write", &self.path))
    }

    fn write(&mut self, step: u64, content: &Content) -> Result<(), RecordError> {
        self.record.clear();
        put_record(&mut self.record, &event(wall_time(), step, content));
        self.file.write_all(&self.record).map_err(io("write", &self.path))
    }
}

/// Seconds since 1970.
fn wall_time() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}

/// The latest time in a name of an event file in `dir`. TensorBoard reads files in the order of their names,
/// and a run may be resumed within a second, or after the clock was set back.
fn newest_stamp(dir: &Path) -> Result<Option<u64>, RecordError> {
    let mut newest = None;
    for entry in std::fs::read_dir(dir).map_err(io("list", dir))? {
        let name = entry.map_err(io("list", dir))?.file_name();
        let stamp = name.to_str().and_then(|name| name.strip_prefix(PREFIX)?.split('.').next()?.parse().ok());
        // A time beyond ten digits is none that this file wrote: it would break the order of names.
        newest = newest.max(stamp.filter(|stamp| *stamp < 9_999_999_999));
    }
    Ok(newest)
}

/// The machine's name, of characters that may stand in a file name.
fn host_name() -> String {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let clean = |c: char| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' };
    let name: String = name.trim().chars().take(64).map(clean).collect();
    if name.is_empty() { "localhost".into() } else { name }
}

/// Appends a record that holds `payload`.
fn put_record(out: &mut Vec<u8>, payload: &[u8]) {
    let length = (payload.len() as u64).to_le_bytes();
    out.extend_from_slice(&length);
    out.extend_from_slice(&masked_crc(&length).to_le_bytes());
    out.extend_from_slice(payload);
    out.extend_from_slice(&masked_crc(payload).to_le_bytes());
}

/// CRC-32C, rotated and shifted as the record format wants it.
fn masked_crc(bytes: &[u8]) -> u32 {
    crc32c::crc32c(bytes).rotate_right(15).wrapping_add(0xa282_ead8)
}

/// An `Event`: 1 wall_time (double), 2 step (int64), 3 file_version (string), 5 summary, 7 session_log. A
/// `SessionLog`: 1 status (enum, 1 is START). A `Summary`: 1 value, repeated.
fn event(wall_time: f64, step: u64, content: &Content) -> Vec<u8> {
    let mut out = vec![tag(1, FIXED_64)];
    out.extend_from_slice(&wall_time.to_le_bytes());
    if step != 0 {
        out.push(tag(2, VARINT));
        put_varint(&mut out, step);
    }
    match content {
        Content::FileVersion => put_bytes(&mut out, 3, FILE_VERSION.as_bytes()),
        Content::Start => put_bytes(&mut out, 7, &[tag(1, VARINT), 1]),
        Content::Scalars(values) => {
            let mut summary = Vec::new();
            for (name, value) in *values {
                put_bytes(&mut summary, 1, &scalar(name, *value));
            }
            put_bytes(&mut out, 5, &summary);
        }
    }
    out
}

/// A `Summary.Value`: 1 tag (string), 2 simple_value (float).
fn scalar(name: &str, value: f32) -> Vec<u8> {
    let mut out = Vec::with_capacity(name.len() + 16);
    put_bytes(&mut out, 1, name.as_bytes());
    out.push(tag(2, FIXED_32));
    out.extend_from_slice(&value.to_le_bytes());
    out
}

const VARINT: u8 = 0;
const FIXED_64: u8 = 1;
const LENGTH_DELIMITED: u8 = 2;
const FIXED_32: u8 = 5;

/// The byte before a field, for field numbers below 16.
const fn tag(field: u8, wire_type: u8) -> u8 {
    field << 3 | wire_type
}

fn put_bytes(out: &mut Vec<u8>, field: u8, bytes: &[u8]) {
    out.push(tag(field, LENGTH_DELIMITED));
    put_varint(out, bytes.len() as u64);
    out.extend_from_slice(bytes);
}

/// Seven bits a byte, the lowest first; the top bit says that more follow.
fn put_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// Written by the real TensorBoard: see tests/golden/tensorboard_events.py, which has the same events.
    const GOLDEN: &[u8] = include_bytes!("../../../tests/golden/tensorboard.events");

    #[test]
    fn bytes_are_tensorboards() {
        let long: Vec<String> = (0..8).map(|i| format!("mentor/a_rather_long_name_{i:02}")).collect();
        let long: Vec<(&str, f32)> =
            long.iter().enumerate().map(|(i, name)| (name.as_str(), i as f32)).collect();
        let several = [("rollout/ep_rew_mean", -3.4), ("time/fps", 0.0), ("bridge/len_mean", 1e30)];
        let events = [
            event(1_700_000_000.0, 0, &Content::FileVersion),
            event(1_700_000_000.25, 0, &Content::Start),
            event(1_700_000_001.5, 1, &Content::Scalars(&[("train/loss", 0.125)])),
            event(1_700_000_002.0, 300, &Content::Scalars(&several)),
            event(1_700_000_003.0, 1 << 40, &Content::Scalars(&long)),
            event(1_700_000_004.0, 301, &Content::Start),
        ];
        let mut bytes = Vec::new();
        for event in &events {
            put_record(&mut bytes, event);
        }
        assert_eq!(bytes, GOLDEN);
    }

    #[test]
    fn later_files_have_later_names() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("events.out.tfevents.9000000000.a.1"), b"").unwrap();
        std::fs::write(dir.path().join("events.out.tfevents.x"), b"").unwrap();
        let first = EventWriter::create(dir.path(), 0).unwrap();
        let second = EventWriter::create(dir.path(), 8).unwrap();
        let name = |writer: &EventWriter| writer.path.file_name().unwrap().to_str().unwrap().to_owned();
        assert!(name(&first).starts_with("events.out.tfevents.9000000001."));
        assert!(name(&second).starts_with("events.out.tfevents.9000000002."));
        assert!(name(&first).ends_with(&format!(".{}", std::process::id())));
    }

    #[test]
    fn a_file_holds_whole_records() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = EventWriter::create(dir.path(), 0).unwrap();
        writer.scalars(7, &[("train/loss", 0.5)]).unwrap();
        writer.flush().unwrap();
        let mut rest = std::fs::read(&writer.path).unwrap();
        let mut payloads = Vec::new();
        while !rest.is_empty() {
            let length = u64::from_le_bytes(rest[..8].try_into().unwrap()) as usize;
            let record: Vec<u8> = rest.drain(..length + 16).collect();
            let mut expected = Vec::new();
            put_record(&mut expected, &record[12..12 + length]);
            assert_eq!(record, expected);
            payloads.push(record[12..12 + length].to_vec());
        }
        assert_eq!(payloads.len(), 3);
        assert!(payloads[2].ends_with(&scalar("train/loss", 0.5)));
    }

    #[test]
    fn a_missing_directory_is_named() {
        let error = EventWriter::create(Path::new("/nonexistent/run"), 0).unwrap_err();
        assert!(error.to_string().contains("/nonexistent/run"));
    }
}
