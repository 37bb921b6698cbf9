//! The moments of a run that its map shows: the file `timeline.jsonl`, handed on line by line.
//!
//! The file is small, so nothing of it is kept: a page asks for the moments that it does not have yet.

use crate::root::Dir;
use crate::tail::{Sink, Tail};
use serde::Serialize;
use serde::de::IgnoredAny;
use std::io::{self, BufRead, BufReader, Read};
use trestle_proto::run_files::TIMELINE_FILE;

/// Longest line that is handed on, bytes.
const MAX_LINE: usize = 1 << 20;
/// Bytes of one answer, about: a page that wants more asks again. Fifty that begin at once then take little memory.
const MAX_ANSWER: usize = 512 << 10;

/// How much of the timeline there is.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub(crate) struct Extent {
    /// Changes when earlier moments have changed: a page that has others begins anew.
    pub(crate) edition: String,
    /// Lines, the head included.
    pub(crate) lines: u64,
}

/// What has been seen of the timeline.
#[derive(Debug, Default)]
pub(crate) struct Timeline {
    tail: Tail,
    count: Count,
}

#[derive(Debug, Default)]
struct Count {
    editions: u64,
    lines: u64,
}

impl Sink for Count {
    // As `answer` reads them, with their ends.
    const LONGEST: usize = MAX_LINE - 1;

    fn restart(&mut self) {
        self.editions += 1;
        self.lines = 0;
    }

    fn line(&mut self, _: &[u8]) {
        self.lines += 1;
    }
}

impl Timeline {
    /// How much there is now.
    ///
    /// # Errors
    /// A file that is there and cannot be read.
    pub(crate) fn look(&mut self, dir: &Dir) -> io::Result<Extent> {
        self.tail.look(dir, TIMELINE_FILE, usize::MAX, &mut self.count)?;
        let inode = self.tail.identity().map_or(0, |identity| identity.ino);
        Ok(Extent { edition: format!("{inode:x}-{}", self.count.editions), lines: self.count.lines })
    }
}

/// The head and the moments from line `from` on, as one JSON object: `{"edition", "from", "head", "moments"}`. A torn line
/// and all after it are left for the next time.
///
/// # Errors
/// What the system says.
pub(crate) fn answer(dir: &Dir, extent: &Extent, from: u64) -> io::Result<String> {
    let (file, _) = dir.open(TIMELINE_FILE)?;
    let mut reader = BufReader::new(file);
    let (mut head, mut moments) = (String::from("null"), String::new());
    let mut line = Vec::new();
    for number in 0.. {
        line.clear();
        let read = (&mut reader).take(MAX_LINE as u64).read_until(b'\n', &mut line)?;
        if read == 0 || line.pop() != Some(b'\n') || moments.len() > MAX_ANSWER {
            break;
        }
        if number > 0 && number < from {
            continue;
        }
        let sound = serde_json::from_slice::<IgnoredAny>(&line).is_ok();
        let text = if sound { std::str::from_utf8(&line).unwrap_or("null") } else { "null" };
        match number {
            0 => head = text.into(),
            _ => {
                if !moments.is_empty() {
                    moments.push(',');
                }
                moments.push_str(text);
            }
        }
    }
    let edition = &extent.edition;
    Ok(format!(
        "{{\"edition\":\"{edition}\",\"from\":{},\"head\":{head},\"moments\":[{moments}]}}",
        from.max(1)
    ))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::root::{Below, Root};
    use std::fs;

    #[test]
    fn moments_are_handed_on_once_and_rubbish_never() {
        let place = tempfile::tempdir().unwrap();
        let dir = Root::new(place.path()).unwrap().dir(&Below::default()).unwrap();
        let mut timeline = Timeline::default();
        assert_eq!(timeline.look(&dir).unwrap().lines, 0);
        let path = place.path().join(TIMELINE_FILE);
        fs::write(&path, "{\"v\":1}\n{\"a\":1}\n</script>\n{\"a\":3}\n{\"a\":").unwrap();
        let extent = timeline.look(&dir).unwrap();
        assert_eq!(extent.lines, 4);
        let parsed = |from| -> serde_json::Value {
            serde_json::from_str(&answer(&dir, &extent, from).unwrap()).unwrap()
        };
        assert_eq!(parsed(0)["moments"], serde_json::json!([{"a": 1}, null, {"a": 3}]));
        assert_eq!(parsed(3)["moments"], serde_json::json!([{"a": 3}]));
        assert_eq!((&parsed(4)["head"]["v"], &parsed(4)["moments"]), (&1.into(), &serde_json::json!([])));
        fs::write(&path, "{\"v\":1}\n").unwrap();
        let anew = timeline.look(&dir).unwrap();
        assert!(anew.edition != extent.edition && anew.lines == 1);
    }

    #[test]
    fn a_moment_of_a_large_map_is_counted_as_long_as_it_is_answered() {
        let place = tempfile::tempdir().unwrap();
        let dir = Root::new(place.path()).unwrap().dir(&Below::default()).unwrap();
        let path = place.path().join(TIMELINE_FILE);
        let mut timeline = Timeline::default();
        let line = |length: usize| format!("\"{}\"\n", "x".repeat(length - 2));
        for (length, counted) in [(MAX_LINE - 1, 2), (MAX_LINE, 1)] {
            fs::write(&path, format!("{{}}\n{}", line(length))).unwrap();
            // A look has a budget: as many as it takes.
            let mut extent = timeline.look(&dir).unwrap();
            for _ in 0..8 {
                extent = timeline.look(&dir).unwrap();
            }
            assert_eq!(extent.lines, counted, "{length}");
            let answered = answer(&dir, &extent, 0).unwrap();
            assert_eq!(answered.contains("xxx"), counted == 2, "{length}");
        }
    }
    #[test]
    fn a_long_timeline_takes_several_answers() {
        let place = tempfile::tempdir().unwrap();
        let dir = Root::new(place.path()).unwrap().dir(&Below::default()).unwrap();
        let moment = format!("\"{}\"\n", "x".repeat(200 << 10));
        fs::write(place.path().join(TIMELINE_FILE), format!("{{}}\n{}", moment.repeat(8))).unwrap();
        let extent = Timeline::default().look(&dir).unwrap();
        let mut counts = Vec::new();
        while counts.iter().sum::<usize>() < 8 {
            let from = 1 + counts.iter().sum::<usize>() as u64;
            let answered = answer(&dir, &extent, from).unwrap();
            assert!(answered.len() < MAX_ANSWER + MAX_LINE);
            let answered: serde_json::Value = serde_json::from_str(&answered).unwrap();
            counts.push(answered["moments"].as_array().unwrap().len());
        }
        assert_eq!(counts, [3, 3, 2]);
    }
}
