//! Minari's Arrow files: a folder an episode, `N/part-0.arrow` and, where it is long, `part-1.arrow` and so on. A row
//! is an observation; in the other columns the last row is padding. A single file is one episode.

use super::error::{ImportError, Place};
use super::metadata::{check_episodes, last_alone};
use super::sink::Sink;
use super::{MAX_SOURCE_BYTES, Options};
use arrow_array::cast::AsArray;
use arrow_array::types::{
    Float16Type, Float32Type, Float64Type, Int8Type, Int16Type, Int32Type, Int64Type, UInt8Type, UInt16Type,
    UInt32Type, UInt64Type,
};
use arrow_array::{Array, ArrayRef, ArrowPrimitiveType, BooleanArray, RecordBatch};
use arrow_buffer::Buffer;
use arrow_ipc::convert::fb_to_schema;
use arrow_ipc::reader::{FileDecoder, read_footer_length};
use arrow_ipc::{Block, root_as_footer, root_as_message};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use trestle_proto::regular_file;

/// Magic and padding before, footer length and magic after the contents.
const FRAME_BYTES: u64 = 8 + 10;
/// Largest footer, and largest batch of rows, bytes; Minari writes batches of up to 2^20 rows.
const MAX_FOOTER: u64 = 16 << 20;
const MAX_BATCH: u64 = 4 << 30;

/// Part `part` of episode `episode` of the data set in `dir`.
pub(super) fn part(dir: &Path, episode: u64, part: u64) -> PathBuf {
    dir.join(episode.to_string()).join(format!("part-{part}.arrow"))
}

/// Reads the episodes that are wanted into `sink`.
pub(super) fn read(path: &Path, options: &Options, sink: &mut Sink<'_>) -> Result<(), ImportError> {
    if path.is_file() {
        let terminal = episode(&[path.into()], options, sink)?;
        return sink.end(terminal);
    }
    let episodes = (0..).find(|&n| !part(path, n, 0).is_file()).unwrap_or(u64::MAX);
    check_episodes(path, episodes, path)?;
    for number in 0..episodes {
        if sink.satisfied() {
            break;
        }
        let terminal = if sink.wanted() {
            let parts: Vec<PathBuf> =
                (0..).map(|k| part(path, number, k)).take_while(|part| part.is_file()).collect();
            episode(&parts, options, sink)?
        } else {
            false
        };
        sink.end(terminal)?;
    }
    Ok(())
}

/// Reads an episode's states; says whether it was terminated.
fn episode(parts: &[PathBuf], options: &Options, sink: &mut Sink<'_>) -> Result<bool, ImportError> {
    let mut row = 0;
    let (mut terminations, mut place) = (Vec::new(), sink.place());
    for path in parts {
        place = Place::of(path).episode(sink.episode());
        let mut reader = Reader::open(path)?;
        while let Some(batch) = reader.batch()? {
            let column = |name: &str| {
                batch.column_by_name(name).ok_or_else(|| {
                    place.clone().refuse(format!("column {name}"), "missing", "a column of Minari's")
                })
            };
            let flags = column("terminations")?;
            let flags: &BooleanArray =
                flags.as_boolean_opt().filter(|f| f.null_count() == 0).ok_or_else(|| {
                    place.clone().refuse("terminations", flags.data_type(), "booleans without gaps")
                })?;
            terminations.extend(flags.iter().map(|flag| flag == Some(true)));
            let states = States::of(column("observations")?, options.key.as_deref(), &place)?;
            sink.columns(states.width, &[])?;
            for i in 0..batch.num_rows() {
                sink.row(row, |column| states.values[i * states.width + column])?;
                row += 1;
            }
        }
    }
    // The last row is padding.
    if terminations.pop().is_none() {
        return Err(place.refuse("the number of observations", 0, "1 or more"));
    }
    last_alone(&terminations, &place, "terminations")
}

/// Batches of a file, one at a time, each read only after its place has been checked.
struct Reader {
    file: File,
    path: PathBuf,
    decoder: FileDecoder,
    blocks: std::vec::IntoIter<Block>,
    bytes: u64,
}

impl Reader {
    fn open(path: &Path) -> Result<Self, ImportError> {
        let damaged = damaged(path);
        let mut file = regular_file::open(path, MAX_SOURCE_BYTES)?;
        let bytes = file.metadata().map_err(|e| damaged(&e))?.len();
        if bytes < FRAME_BYTES {
            return Err(damaged(&format!("{bytes} bytes are too few")));
        }
        let mut end = [0; 10];
        file.seek(SeekFrom::Start(bytes - 10)).map_err(|e| damaged(&e))?;
        file.read_exact(&mut end).map_err(|e| damaged(&e))?;
        let length = read_footer_length(end).map_err(|e| damaged(&e))? as u64;
        if length > MAX_FOOTER || length + FRAME_BYTES > bytes {
            return Err(damaged(&format!("a footer of {length} bytes in {bytes}")));
        }
        let mut footer = vec![0; length as usize];
        file.seek(SeekFrom::Start(bytes - 10 - length)).map_err(|e| damaged(&e))?;
        file.read_exact(&mut footer).map_err(|e| damaged(&e))?;
        let footer = root_as_footer(&footer).map_err(|e| damaged(&e))?;
        let schema = footer.schema().ok_or_else(|| damaged(&"no schema"))?;
        if footer.dictionaries().is_some_and(|dictionaries| !dictionaries.is_empty()) {
            return Err(damaged(&"dictionaries, which Minari does not write"));
        }
        let schema = guarded(|| fb_to_schema(schema)).ok_or_else(|| damaged(&"a schema that is none"))?;
        if ["observations", "terminations"].iter().any(|name| schema.field_with_name(name).is_err()) {
            let next = format!(
                "`python3 -c 'import pandas; pandas.read_feather(\"{}\").to_csv(\"demo.csv\", index=False)'` makes CSV of it",
                path.display()
            );
            return Err(
                Place::of(path).foreign("a table in Arrow's format (Feather) that is not Minari's", next)
            );
        }
        // Other columns, actions and rewards among them, are skipped.
        let wanted = |i: &usize| ["observations", "terminations"].contains(&schema.field(*i).name().as_str());
        let wanted = (0..schema.fields().len()).filter(wanted).collect();
        let blocks: Vec<Block> =
            footer.recordBatches().map(|b| b.iter().copied().collect()).unwrap_or_default();
        let decoder = FileDecoder::new(Arc::new(schema), footer.version()).with_projection(wanted);
        Ok(Self { file, path: path.into(), decoder, blocks: blocks.into_iter(), bytes })
    }

    fn batch(&mut self) -> Result<Option<RecordBatch>, ImportError> {
        let damaged = damaged(&self.path);
        let Some(block) = self.blocks.next() else { return Ok(None) };
        let [offset, header, body] = [block.offset(), i64::from(block.metaDataLength()), block.bodyLength()]
            .map(|n| u64::try_from(n).unwrap_or(u64::MAX));
        let length = header.saturating_add(body);
        if header < 8 || length > MAX_BATCH || offset.saturating_add(length) > self.bytes {
            return Err(damaged(&format!("a batch of {length} bytes at {offset} in {}", self.bytes)));
        }
        let mut data = vec![0; length as usize];
        self.file.seek(SeekFrom::Start(offset)).map_err(|e| damaged(&e))?;
        self.file.read_exact(&mut data).map_err(|e| damaged(&e))?;
        if !within(&data, header, body) {
            return Err(damaged(&"a batch that names places outside of it"));
        }
        let data = Buffer::from_vec(data);
        let decoded = guarded(|| self.decoder.read_record_batch(&block, &data));
        decoded.ok_or_else(|| damaged(&"a batch with counts that do not fit"))?.map_err(|e| damaged(&e))
    }
}

/// The library panics over some schemas and counts that are wrong, where it should refuse them: none then.
fn guarded<T>(read: impl FnOnce() -> T) -> Option<T> {
    catch_unwind(AssertUnwindSafe(read)).ok()
}

/// Whether all buffers that the message at the beginning of a batch names lie within its body.
fn within(data: &[u8], header: u64, body: u64) -> bool {
    let header = &data[..header as usize];
    // A marker stands before the message's length since format 0.15.
    let skipped = if header.starts_with(&[0xff; 4]) { 8 } else { 4 };
    let message = root_as_message(header.get(skipped..).unwrap_or_default());
    let Some(batch) = message.ok().and_then(|message| message.header_as_record_batch()) else { return false };
    let inside = |offset: i64, length: i64| {
        let ends = u64::try_from(offset).ok().zip(u64::try_from(length).ok());
        ends.and_then(|(offset, length)| offset.checked_add(length)).is_some_and(|end| end <= body)
    };
    batch.length() >= 0
        && batch.buffers().is_none_or(|buffers| buffers.iter().all(|b| inside(b.offset(), b.length())))
}

fn damaged(path: &Path) -> impl Fn(&dyn std::fmt::Display) -> ImportError {
    let path = path.to_path_buf();
    move |error| ImportError::Io {
        path: path.clone(),
        message: format!("cannot be read as Arrow IPC, it may be cut off or damaged: {error}"),
    }
}

/// The observations of a batch, row-major.
struct States {
    width: usize,
    values: Vec<f64>,
}

impl States {
    fn of(column: &ArrayRef, key: Option<&str>, place: &Place) -> Result<Self, ImportError> {
        let mut column = column;
        let mut names = key.into_iter().flat_map(|key| key.split('/'));
        while let Some(fields) = column.as_struct_opt() {
            let accepted = format!("one of {}", fields.column_names().join(", "));
            let refuse = |value: String| place.clone().refuse("--key", value, &accepted);
            let name = names.next();
            let name = name.ok_or_else(|| refuse("missing, and the observations are a dictionary".into()))?;
            column =
                fields.column_by_name(name).ok_or_else(|| refuse(format!("`{}`", key.unwrap_or(name))))?;
        }
        if names.next().is_some() {
            let accepted = "the name of an array of numbers";
            return Err(place.clone().refuse("--key", format!("`{}`", key.unwrap_or("")), accepted));
        }
        let (numbers, width) = match column.as_fixed_size_list_opt() {
            Some(list) if list.null_count() == 0 => (list.values(), list.value_length().max(0) as usize),
            _ => (column, 1),
        };
        let values =
            floats(numbers).filter(|values| values.len() == column.len() * width).ok_or_else(|| {
                let accepted = "numbers, or lists of equal length of them, without gaps";
                place.clone().refuse("the type of the observations", column.data_type(), accepted)
            })?;
        Ok(Self { width, values })
    }
}

/// The numbers of an array without gaps.
fn floats(array: &ArrayRef) -> Option<Vec<f64>> {
    fn of<T: ArrowPrimitiveType>(array: &ArrayRef, to: impl Fn(T::Native) -> f64) -> Option<Vec<f64>> {
        Some(array.as_primitive_opt::<T>()?.values().iter().map(|&x| to(x)).collect())
    }
    if array.null_count() > 0 {
        return None;
    }
    of::<Float32Type>(array, f64::from)
        .or_else(|| of::<Float16Type>(array, f64::from))
        .or_else(|| of::<Float64Type>(array, |x| x))
        .or_else(|| of::<Int8Type>(array, f64::from))
        .or_else(|| of::<Int16Type>(array, f64::from))
        .or_else(|| of::<Int32Type>(array, f64::from))
        .or_else(|| of::<Int64Type>(array, |x| x as f64))
        .or_else(|| of::<UInt8Type>(array, f64::from))
        .or_else(|| of::<UInt16Type>(array, f64::from))
        .or_else(|| of::<UInt32Type>(array, f64::from))
        .or_else(|| of::<UInt64Type>(array, |x| x as f64))
}
