//! What a file is, seen from its first bytes: a format that is read, or one that has a name and a way out.

use super::hdf5;
use flate2::read::MultiGzDecoder;
use std::fs::File;
use std::io::{self, Read};
use std::os::unix::fs::FileExt;
use std::path::Path;

/// As much of a file's beginning as is looked at, bytes.
const START: usize = 4096;
const HDF5: &[u8] = b"\x89HDF\r\n\x1a\n";
/// What a file is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Empty,
    Hdf5,
    Arrow,
    Npy,
    Npz,
    /// Text that may be a table, in whichever encoding, compressed with gzip or not.
    Text,
    /// Something that is not read.
    Foreign(Foreign),
}

/// A known format that is not read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Foreign {
    /// Its name, with an article.
    pub(crate) what: &'static str,
    /// What to do instead, in a sentence.
    pub(crate) next: String,
}

/// First bytes, a name, and what to do; `{}` is the file.
const MAGIC: &[(&[u8], &str, &str)] = &[
    (
        b"PAR1",
        "Parquet",
        "`python3 -c 'import pandas; pandas.read_parquet(\"{}\").to_csv(\"demo.csv\", index=False)'` makes CSV of it",
    ),
    (
        b"FEA1",
        "a Feather file of version 1",
        "`python3 -c 'import pandas; pandas.read_feather(\"{}\").to_csv(\"demo.csv\", index=False)'` makes CSV of it",
    ),
    (b"\x28\xb5\x2f\xfd", "compressed with Zstandard", "decompress it: `zstd -d {}`"),
    (b"\xfd7zXZ\x00", "compressed with XZ", "decompress it: `xz -dk {}`"),
    (b"BZh", "compressed with bzip2", "decompress it: `bzip2 -dk {}`"),
    (b"\x04\x22\x4d\x18", "compressed with LZ4", "decompress it: `lz4 -d {}`"),
    (b"7z\xbc\xaf\x27\x1c", "a 7z archive", "unpack it: `7z x {}`"),
    (
        b"SQLite format 3\0",
        "an SQLite database",
        "export the table of states as CSV: `sqlite3 -header -csv {} 'SELECT * FROM ...' > demo.csv`",
    ),
    (
        b"#ROSBAG",
        "a ROS bag",
        "export the topic of the states as CSV: `rostopic echo -b {} -p /TOPIC > demo.csv`",
    ),
    (b"\x89MCAP0\r\n", "an MCAP recording", "export the topic of the states as CSV or NPY first"),
    (
        b"MATLAB 5.0 MAT-file",
        "a MATLAB file of version 5",
        "`python3 -c 'import scipy.io, numpy; numpy.save(\"demo.npy\", scipy.io.loadmat(\"{}\")[\"NAME\"])'` takes one array out of it",
    ),
    (
        b"version https://git-lfs.github.com/spec/",
        "a Git LFS pointer, not the data",
        "`git lfs pull` in its repository fetches them",
    ),
    (b"/annex/objects/", "a git-annex pointer, not the data", "`git annex get {}` fetches them"),
    (b"%PDF", "a PDF document", "take the table out of it as CSV"),
    (b"\x89PNG", "a PNG image", "states are numbers: CSV, NPY, NPZ, HDF5 or Arrow IPC"),
    (b"\xff\xd8\xff", "a JPEG image", "states are numbers: CSV, NPY, NPZ, HDF5 or Arrow IPC"),
    (b"\xd0\xcf\x11\xe0", "a spreadsheet or document of Microsoft Office", "save its table as CSV"),
    (b"\x7fELF", "a program", "give the file with the states"),
];

const TEXTUAL: &str = "CSV, NPY, NPZ, HDF5 or Arrow IPC";

/// What the open file is; `path` is for what to do. The file's position stays where it is.
///
/// # Errors
/// What the operating system says of reading.
pub(crate) fn kind(file: &File, path: &Path) -> io::Result<Kind> {
    let mut start = vec![0; START];
    let length = read_up_to(|buffer, at| file.read_at(buffer, at), &mut start)?;
    start.truncate(length);
    if start.is_empty() {
        return Ok(Kind::Empty);
    }
    if hdf5::signature(file)?.is_some() {
        return Ok(Kind::Hdf5);
    }
    Ok(of(&start, path))
}

/// Fills `buffer` as far as there is something; says how far.
fn read_up_to(read: impl Fn(&mut [u8], u64) -> io::Result<usize>, buffer: &mut [u8]) -> io::Result<usize> {
    let mut filled = 0;
    while filled < buffer.len() {
        match read(&mut buffer[filled..], filled as u64) {
            Ok(0) => break,
            Ok(n) => filled += n,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(filled)
}

/// What begins with these bytes.
fn of(start: &[u8], path: &Path) -> Kind {
    let foreign = |what, next: &str| {
        Kind::Foreign(Foreign { what, next: next.replace("{}", &path.display().to_string()) })
    };
    if start.starts_with(b"\x93NUMPY") {
        return Kind::Npy;
    }
    if start.starts_with(b"ARROW1") {
        return Kind::Arrow;
    }
    if start.starts_with(b"PK\x03\x04") || start.starts_with(b"PK\x05\x06") {
        return zip(start, &foreign);
    }
    if start.starts_with(&[0x1f, 0x8b]) {
        return gzip(start, path, &foreign);
    }
    if let Some((_, what, next)) = MAGIC.iter().find(|(magic, _, _)| start.starts_with(magic)) {
        return foreign(what, next);
    }
    // The stream format of Arrow: a message's mark, and its length.
    if start.starts_with(&[0xff; 4]) && start.get(6..8) == Some(&[0, 0]) {
        let next = "`python3 -c 'import pyarrow as a; a.ipc.open_stream(\"{}\").read_pandas().to_csv(\"demo.csv\", index=False)'` makes \
                    CSV of it";
        return foreign("an Arrow stream", next);
    }
    // A pickle of protocol 2 to 5.
    if matches!(start, [0x80, 2..=5, ..]) {
        let next = "it can run code when it is loaded, so load it only if you trust it, and store its states with \
                    `numpy.save(\"demo.npy\", states)`";
        return foreign("a Python pickle", next);
    }
    if start.get(257..262) == Some(b"ustar") {
        return foreign("a tar archive", "unpack it: `tar xf {}`");
    }
    textual(start).map_or(Kind::Text, |(what, next)| foreign(what, next))
}

/// What a ZIP archive is, by the name of its first member.
fn zip(start: &[u8], foreign: &impl Fn(&'static str, &str) -> Kind) -> Kind {
    let length = start.get(26..28).map_or(0, |n| usize::from(u16::from_le_bytes([n[0], n[1]])));
    let name = String::from_utf8_lossy(start.get(30..30 + length).unwrap_or_default()).into_owned();
    if name.ends_with(".npy") || start.starts_with(b"PK\x05\x06") {
        return Kind::Npz;
    }
    if name.ends_with("data.pkl") || name.contains(".data/") {
        let next = "`python3 -c 'import torch; print(torch.load(\"{}\"))'` shows it; store its states with `numpy.save`";
        return foreign("a file of PyTorch", next);
    }
    let office = ["[Content_Types].xml", "xl/", "docProps/", "_rels/", "mimetype"];
    if office.iter().any(|begin| name.starts_with(begin)) {
        let next = "save its table as CSV, or `python3 -c 'import pandas; pandas.read_excel(\"{}\").to_csv(\"demo.csv\", index=False)'` \
                    makes CSV of its first sheet";
        return foreign("a spreadsheet or document", next);
    }
    foreign("a ZIP archive without arrays of NumPy", "unpack it: `unzip {}`")
}

/// What a gzip stream holds.
fn gzip(start: &[u8], path: &Path, foreign: &impl Fn(&'static str, &str) -> Kind) -> Kind {
    let mut inside = Vec::new();
    // The beginning of a stream ends early: what came before the error counts.
    let _ = MultiGzDecoder::new(start).take(START as u64).read_to_end(&mut inside);
    let unpack = "decompress it first: `gunzip -k {}`";
    if inside.starts_with(HDF5) {
        return foreign("HDF5 that is compressed as a whole with gzip", unpack);
    }
    if inside.starts_with(&[0x1f, 0x8b]) {
        return foreign("compressed twice with gzip", unpack);
    }
    match of(&inside, path) {
        Kind::Npy | Kind::Npz | Kind::Arrow => foreign("compressed as a whole with gzip", unpack),
        Kind::Foreign(Foreign { what: "a tar archive", .. }) => {
            foreign("a tar archive that is compressed with gzip", "unpack it: `tar xzf {}`")
        }
        inner => inner,
    }
}

/// A name for text that is no table, and what to do.
fn textual(start: &[u8]) -> Option<(&'static str, &'static str)> {
    if start.starts_with(&[0xff, 0xfe, 0, 0]) || start.starts_with(&[0, 0, 0xfe, 0xff]) {
        return Some(("UTF-32 text", "`iconv -f UTF-32 -t UTF-8 {} > demo.csv` makes UTF-8 of it"));
    }
    if start.starts_with(&[0xff, 0xfe]) || start.starts_with(&[0xfe, 0xff]) || is_bare_utf16(start) {
        return None;
    }
    if start.contains(&0) {
        return Some(("neither text nor a format that is known", TEXTUAL));
    }
    let text = start.strip_prefix(b"\xef\xbb\xbf").unwrap_or(start).trim_ascii_start();
    let begins = |prefix: &[u8]| text.get(..prefix.len()).is_some_and(|own| own.eq_ignore_ascii_case(prefix));
    let html = begins(b"<!doctype html") || begins(b"<html") || begins(b"<head");
    if html || (begins(b"<!--") && text.to_ascii_lowercase().windows(5).any(|part| part == b"<html")) {
        let next = "a page was downloaded in the data's place (a login, an error, a view of the file); download the raw file";
        return Some(("an HTML page, not the data", next));
    }
    if begins(b"<") {
        return Some(("XML", "export the table of states as CSV"));
    }
    if let Some(next) = json(text) {
        return Some(("JSON", next));
    }
    if text.starts_with(b"../") && text.windows(20).any(|part| part == b"/.git/annex/objects/") {
        return Some(("a git-annex pointer, not the data", "`git annex get {}` fetches them"));
    }
    if begins(b"@relation") {
        return Some((
            "ARFF",
            "`python3 -c 'import pandas, scipy.io.arff as a; pandas.DataFrame(a.loadarff(\"{}\")[0]).to_csv(\"demo.csv\", index=False)'` makes CSV of it",
        ));
    }
    None
}

/// How to make something else of text that begins as JSON does; none of other text.
fn json(text: &[u8]) -> Option<&'static str> {
    const LINES: &str = "`python3 -c 'import pandas; pandas.read_json(\"{}\", lines=True).to_csv(\"demo.csv\", index=False)'` \
        makes CSV of one object a line";
    const TABLE: &str = "`python3 -c 'import pandas; pandas.read_json(\"{}\").to_csv(\"demo.csv\", index=False)'` makes CSV of a \
        table";
    const ROWS: &str = "`python3 -c 'import pandas; pandas.read_json(\"{}\", lines=True).to_csv(\"demo.csv\", index=False, \
        header=False)'` makes CSV of one list a line";
    const LISTS: &str = "`python3 -c 'import json, numpy; numpy.save(\"demo.npy\", numpy.array(json.load(open(\"{}\")), \"f4\"))'` \
        makes NPY of lists of equal length";
    const ONE: &str = "`python3 -c 'import json, numpy; numpy.save(\"demo.npy\", \
        numpy.array(json.load(open(\"{}\"))[\"NAME\"], \"f4\"))'` makes NPY of the lists of equal length that are called NAME";
    let inside = text.get(1..)?.trim_ascii_start();
    let ended = |end: &[u8]| text.windows(end.len()).any(|part| part == end);
    match (text[0], *inside.first()?) {
        // Behind the first name is a list, or another object.
        (b'{', b'"') if !ended(b"}\n{") && !ended(b"}\r\n{") => {
            let value = inside.split(|&byte| byte == b':').nth(1).map(<[u8]>::trim_ascii_start);
            Some(match value.and_then(<[u8]>::first) {
                Some(b'{') => TABLE,
                Some(b'[') => ONE,
                _ => LINES,
            })
        }
        (b'{', _) => Some(LINES),
        (b'[', b'{') => Some(TABLE),
        (b'[', _) if ended(b"]\n[") || ended(b"]\r\n[") => Some(ROWS),
        (b'[', b'[' | b']' | b'"' | b'-' | b'0'..=b'9') => Some(LISTS),
        _ => None,
    }
}

/// Whether these bytes are UTF-16 without a mark: in ASCII, which tables mostly are, every second byte is 0 then.
pub(super) fn is_bare_utf16(start: &[u8]) -> bool {
    let pairs = start.as_chunks::<2>().0;
    let zero = |which: usize| pairs.iter().filter(|pair| pair[which] == 0).count();
    let (even, odd) = (zero(0), zero(1));
    pairs.len() >= 2
        && ((even == 0 && odd * 10 > pairs.len() * 9) || (odd == 0 && even * 10 > pairs.len() * 9))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use flate2::Compression;
    use flate2::write::GzEncoder;
    use std::io::Write;

    fn kind_of(bytes: &[u8]) -> Kind {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("data");
        std::fs::write(&path, bytes).unwrap();
        kind(&File::open(&path).unwrap(), &path).unwrap()
    }

    fn foreign_of(bytes: &[u8]) -> String {
        match kind_of(bytes) {
            Kind::Foreign(foreign) => format!("{}: {}", foreign.what, foreign.next),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn each_format_is_known_by_its_first_bytes() {
        assert_eq!(kind_of(b""), Kind::Empty);
        assert_eq!(kind_of(b"\x93NUMPY\x01\x00"), Kind::Npy);
        assert_eq!(kind_of(b"ARROW1\0\0"), Kind::Arrow);
        for text in [
            &b"x,y\n1,2\n"[..],
            b"[section]\nx = 1\n",
            b"\xef\xbb\xbfx\n1\n",
            b"\xff\xfex\0\n\0",
            b"x\0\n\x001\0\n\0",
            b"1 2\n",
            b"\n\n",
        ] {
            assert_eq!(kind_of(text), Kind::Text, "{text:?}");
        }
        // HDF5 behind a user block, which can be anything.
        for block in [512, 1024, 4096] {
            let mut bytes = b"x,y\n".to_vec();
            bytes.resize(block, 0);
            bytes.extend(HDF5);
            assert_eq!(kind_of(&bytes), Kind::Hdf5);
        }
        // As openpyxl writes it: the name of the first member has 16 bytes.
        let workbook = [&b"PK\x03\x04"[..], &[0; 22], &[16, 0, 0, 0], b"docProps/app.xml"].concat();
        for (bytes, what) in [
            (&b"PAR1...."[..], "Parquet: `python3"),
            (
                b"version https://git-lfs.github.com/spec/v1\noid sha256:00\n",
                "a Git LFS pointer, not the data: `git lfs pull`",
            ),
            (b"\n<!DOCTYPE HTML><title>Sign in", "an HTML page, not the data: a page was downloaded"),
            (b"[[0, 1], [1, 1]]", "JSON: `python3"),
            (b"\xef\xbb\xbf {\"x\": 1}", "JSON: `python3"),
            (b"[[0,1]\n,[1,1]]\n", "JSON: `python3 -c 'import json, numpy"),
            (b"[0,1]\n[1,1]\n", "JSON: `python3 -c 'import pandas; pandas.read_json(\""),
            (b"[ {\"x\": 1}]", "JSON: `python3 -c 'import pandas"),
            (b"{\"obs\": [[0, 1]]}", "JSON: `python3 -c 'import json, numpy"),
            (b"{\"x\": {\"0\": 1}}", "JSON: `python3 -c 'import pandas"),
            (b"../../.git/annex/objects/a/b/c", "a git-annex pointer"),
            (b"<!-- saved -->\n<html>", "an HTML page"),
            (b"\xff\xff\xff\xff\xd0\x00\x00\x00\x10", "an Arrow stream"),
            (&workbook, "a spreadsheet or document: save its table"),
            (b"\x80\x04\x95", "a Python pickle: "),
            (b"\0\0\0\0", "neither text"),
            (b"SQLite format 3\0", "an SQLite database"),
        ] {
            let found = foreign_of(bytes);
            assert!(found.starts_with(what), "{found}");
            assert!(!found.contains("{}"), "{found}");
        }
    }

    #[test]
    fn what_is_compressed_is_looked_into() {
        let packed = |bytes: &[u8]| {
            let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
            encoder.write_all(bytes).unwrap();
            encoder.finish().unwrap()
        };
        assert_eq!(kind_of(&packed(b"x,y\n1,2\n")), Kind::Text);
        assert!(foreign_of(&packed(b"\x93NUMPY\x01\x00")).contains("gunzip -k"));
        assert!(foreign_of(&packed(HDF5)).starts_with("HDF5 that is compressed"));
        assert!(foreign_of(&packed(b"[1]")).starts_with("JSON"));
        assert!(foreign_of(&packed(&packed(b"x\n1\n"))).starts_with("compressed twice"));
        let mut tar = vec![b'a'; 512];
        tar[257..262].copy_from_slice(b"ustar");
        assert!(foreign_of(&packed(&tar)).contains("tar xzf"));
    }
}
