//! Datasets as tables of numbers.

use super::{Source, copied, unreadable};
use crate::import::error::{ImportError, Place};
use crate::import::rows::{self, Rows};
use half::{bf16, f16};
use hdf5_pure::{DType, Dataset, Datatype, DatatypeByteOrder, Error, FormatError, Layout};
use std::path::{Path, PathBuf};
use trestle_proto::limits::MAX_MENTOR_TRANSITIONS;

/// About how much is decoded at once, bytes.
const WINDOW_BYTES: u64 = 1 << 20;
/// What a filter is called that is not read, by its number.
const FILTERS: [(u16, &str); 11] = [
    (4, "SZIP"),
    (5, "n-bit packing"),
    (305, "LZO"),
    (307, "bzip2"),
    (32001, "Blosc"),
    (32004, "LZ4"),
    (32008, "bitshuffle"),
    (32013, "ZFP"),
    (32015, "Zstandard"),
    (32017, "SZ"),
    (32026, "Blosc2"),
];
/// Those that are read: gzip, shuffle, Fletcher's checksum, scale and offset, LZF.
const READ: [u16; 5] = [1, 2, 3, 6, 32000];

/// How a dataset stores a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Element {
    /// As the library reads it.
    Plain,
    /// A number of an enumeration of so many bytes, as h5py stores booleans.
    Enum { bytes: usize, big_endian: bool },
    /// 16 bits of floating point: IEEE's, or else bfloat16; big-endian or not.
    Half { ieee: bool, big_endian: bool },
}

/// A dataset of numbers with one row a state.
pub(super) struct Table {
    dataset: Dataset,
    element: Element,
    path: PathBuf,
    shape: Vec<u64>,
    rows: u64,
    width: usize,
    window: u64,
}

impl Table {
    /// The dataset at `at`; `place` and `what` are for messages.
    pub(super) fn new(source: &Source, at: &str, place: &Place, what: &str) -> Result<Self, ImportError> {
        let (path, dataset) = (source.path.as_path(), source.dataset(at)?);
        readable(&dataset, path, place, what)?;
        let dtype = dataset.dtype().map_err(unreadable(path))?;
        let of_half = match &dtype {
            DType::Other(other) => half(other),
            _ => None,
        };
        let (bytes, element) = match (&dtype, of_half) {
            (_, Some(half)) => (2, half),
            (DType::Enum(_), _) => {
                let bytes = dataset.element_size().map_err(unreadable(path))?;
                let big_endian = dataset.datatype().is_ok_and(|kind| is_big_endian(&kind));
                (bytes, Element::Enum { bytes: bytes.clamp(1, 8) as usize, big_endian })
            }
            (DType::I8 | DType::U8, _) => (1, Element::Plain),
            (DType::I16 | DType::U16, _) => (2, Element::Plain),
            (DType::F32 | DType::I32 | DType::U32, _) => (4, Element::Plain),
            (DType::F64 | DType::I64 | DType::U64, _) => (8, Element::Plain),
            (DType::Compound(_), _) => {
                let next = format!(
                    "`python3 -c 'import h5py, numpy; numpy.save(\"demo.npy\", h5py.File(\"{}\")[\"{at}\"][()])'` makes NPY \
                     of them, whose fields --columns chooses",
                    path.display()
                );
                return Err(place
                    .clone()
                    .foreign(format!("a file whose {what} are records ({dtype})"), next));
            }
            (other, _) => {
                let accepted = "numbers of up to 64 bits";
                return Err(place.clone().refuse(format!("the type of {what}"), other, accepted));
            }
        };
        let shape = dataset.shape().map_err(unreadable(path))?;
        let refuse = |value: String| place.clone().refuse(format!("the shape of {what}"), value, "(T, D)");
        let [rows, features @ ..] = &shape[..] else { return Err(refuse("()".into())) };
        let width = features.iter().try_fold(1_u64, |a, &b| a.checked_mul(b)).and_then(|w| w.try_into().ok());
        let width: usize = width.ok_or_else(|| refuse(format!("{shape:?}")))?;
        // Whole chunks, so that none is decoded twice.
        let chunk = dataset.chunk_shape().map_err(unreadable(path))?.and_then(|chunk| chunk.first().copied());
        let chunk = chunk.unwrap_or(1).max(1);
        let row_bytes = (width as u64).saturating_mul(bytes).max(1);
        let window = (WINDOW_BYTES / row_bytes / chunk).max(1).saturating_mul(chunk);
        let rows = *rows;
        Ok(Self { dataset, element, path: path.into(), shape, rows, width, window })
    }

    /// The sides of the dataset.
    pub(super) fn shape(&self) -> &[u64] {
        &self.shape
    }

    /// All flags of one episode, one a step.
    pub(super) fn all_flags(&mut self, place: &Place, what: &str) -> Result<Vec<bool>, ImportError> {
        if self.width != 1 || self.rows > MAX_MENTOR_TRANSITIONS as u64 {
            let value = format!("({}, {})", self.rows, self.width);
            let accepted = format!("(T,), T up to {MAX_MENTOR_TRANSITIONS}");
            return Err(place.clone().refuse(format!("the shape of {what}"), value, accepted));
        }
        let rows = self.rows;
        rows::flags(self, 0, rows, place, what)
    }
}

/// Whether the numbers of an enumeration begin with their highest byte.
fn is_big_endian(kind: &Datatype) -> bool {
    let Datatype::Enumeration { base_type, .. } = kind else { return false };
    matches!(**base_type, Datatype::FixedPoint { byte_order: DatatypeByteOrder::BigEndian, .. })
}

/// Which 16 bits of floating point these are.
fn half(kind: &Datatype) -> Option<Element> {
    let Datatype::FloatingPoint { size: 2, byte_order, layout } = kind else { return None };
    let big_endian = match byte_order {
        DatatypeByteOrder::LittleEndian => false,
        DatatypeByteOrder::BigEndian => true,
        DatatypeByteOrder::Vax => return None,
    };
    match (layout.exponent_size, layout.mantissa_size, layout.exponent_bias) {
        (5, 10, 15) => Some(Element::Half { ieee: true, big_endian }),
        (8, 7, 127) => Some(Element::Half { ieee: false, big_endian }),
        _ => None,
    }
}

/// Refuses what the library cannot read, by its name.
fn readable(dataset: &Dataset, path: &Path, place: &Place, what: &str) -> Result<(), ImportError> {
    let layout = dataset.layout();
    if matches!(layout, Err(Error::Format(FormatError::UnsupportedExternalStorage))) {
        let kind = format!("a file whose {what} lie in another file (external storage)");
        return Err(place.clone().foreign(kind, copied(path, "")));
    }
    if matches!(layout, Ok(Layout::Virtual) | Err(Error::Format(FormatError::UnsupportedVirtualLayout))) {
        let kind = format!("a file whose {what} are a virtual dataset, made of other files or datasets");
        return Err(place.clone().foreign(kind, copied(path, "")));
    }
    let Some(filter) = dataset.filters().into_iter().find(|filter| !READ.contains(filter)) else {
        return Ok(());
    };
    let name = FILTERS.iter().find(|(id, _)| *id == filter).map_or("an unknown filter", |(_, name)| name);
    let kind = format!("a file whose {what} are compressed with {name} (filter {filter})");
    let next = match filter {
        4 | 5 => format!("`h5repack -f GZIP=4 {} repacked.hdf5`, or {}", path.display(), copied(path, "")),
        _ => copied(path, ", hdf5plugin"),
    };
    Err(place.clone().foreign(kind, next))
}

impl Rows for Table {
    fn rows(&self) -> u64 {
        self.rows
    }

    fn width(&self) -> usize {
        self.width
    }

    fn window(&self) -> u64 {
        self.window
    }

    fn read(&mut self, first: u64, count: u64) -> Result<Vec<f64>, ImportError> {
        let raw = || self.dataset.read_raw_rows(first, count).map_err(|error| self.failed(error));
        let values: Vec<f64> = match self.element {
            Element::Plain => self.dataset.read_f64_rows(first, count).map_err(|error| self.failed(error))?,
            Element::Enum { bytes, big_endian } => {
                let number = |element: &[u8]| {
                    let shift = |number: u64, byte: &u8| number << 8 | u64::from(*byte);
                    let number = if big_endian {
                        element.iter().fold(0, shift)
                    } else {
                        element.iter().rev().fold(0, shift)
                    };
                    number as f64
                };
                raw()?.chunks_exact(bytes).map(number).collect()
            }
            Element::Half { ieee, big_endian } => {
                let wide = |&pair: &[u8; 2]| {
                    let bits = if big_endian { u16::from_be_bytes(pair) } else { u16::from_le_bytes(pair) };
                    if ieee { f16::from_bits(bits).to_f64() } else { bf16::from_bits(bits).to_f64() }
                };
                raw()?.as_chunks::<2>().0.iter().map(wide).collect()
            }
        };
        let expected = count.saturating_mul(self.width as u64);
        if values.len() as u64 != expected {
            let place = Place::of(&self.path).row(first);
            return Err(place.refuse("the number of numbers", values.len(), expected));
        }
        Ok(values)
    }
}

impl Table {
    /// What the library says of rows that it cannot read.
    fn failed(&self, error: Error) -> ImportError {
        match error {
            Error::Format(FormatError::UnsupportedExternalStorage) => {
                let kind = "a file whose data lie in another file (external storage)";
                Place::of(&self.path).foreign(kind, copied(&self.path, ""))
            }
            error => unreadable(&self.path)(error),
        }
    }
}
