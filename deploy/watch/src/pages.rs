//! The pages that browsers look at, each read once however many browsers there are.

use crate::folder::FolderPage;
use crate::locks::Locks;
use crate::root::{Below, Root};
use crate::run::{RunPage, is_run};
use crate::timeline;
use serde_json::json;
use std::collections::BTreeMap;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Runs and folders that are remembered, at most; the one that was looked at longest ago is forgotten first.
const MAX_PAGES: usize = 24;
/// Least time between two looks at the files of a page.
const LOOK_EVERY: Duration = Duration::from_millis(900);

/// All pages below a folder.
#[derive(Debug)]
pub(crate) struct Pages {
    root: Root,
    known: Mutex<BTreeMap<Below, Known>>,
    locks: Mutex<(Option<Instant>, Locks)>,
}

#[derive(Clone, Debug)]
struct Known {
    page: Arc<Mutex<Page>>,
    used: Instant,
}

/// What a page shows, and its number: another one if it shows something else.
#[derive(Clone, Debug)]
pub(crate) struct Shown {
    pub(crate) number: u64,
    pub(crate) json: Arc<str>,
}

#[derive(Debug)]
struct Page {
    contents: Option<Contents>,
    looked: Option<Instant>,
    shown: Shown,
}

#[derive(Debug)]
enum Contents {
    Run(Box<RunPage>),
    Folder(FolderPage),
}

/// A lock that a panic elsewhere does not take away.
fn held<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Pages {
    pub(crate) fn new(root: Root) -> Self {
        Self { root, known: Mutex::default(), locks: Mutex::default() }
    }

    fn page(&self, below: &Below) -> Arc<Mutex<Page>> {
        let mut known = held(&self.known);
        if !known.contains_key(below) && known.len() == MAX_PAGES {
            let oldest = known.iter().min_by_key(|(_, known)| known.used).map(|(below, _)| below.clone());
            oldest.map(|below| known.remove(&below));
        }
        let entry = known.entry(below.clone()).or_insert_with(|| Known {
            page: Arc::new(Mutex::new(Page {
                contents: None,
                looked: None,
                shown: Shown { number: 0, json: "null".into() },
            })),
            used: Instant::now(),
        });
        entry.used = Instant::now();
        Arc::clone(&entry.page)
    }

    fn locks(&self) -> Locks {
        let mut locks = held(&self.locks);
        if locks.0.is_none_or(|at| at.elapsed() >= LOOK_EVERY) {
            *locks = (Some(Instant::now()), Locks::now());
        }
        locks.1.clone()
    }

    /// What the page of `below` shows now. Reads files: not for the thread that serves.
    pub(crate) fn look(&self, below: &Below) -> Shown {
        let locks = self.locks();
        let page = self.page(below);
        let mut page = held(&page);
        page.look(&self.root, below, &locks)
    }

    /// The timeline of the run `below` from line `from` on.
    ///
    /// # Errors
    /// There is none.
    pub(crate) fn timeline(&self, below: &Below, from: u64) -> io::Result<String> {
        let dir = self.root.dir(below)?;
        let page = self.page(below);
        let page = held(&page);
        match &page.contents {
            Some(Contents::Run(run)) => timeline::answer(&dir, run.extent(), from),
            _ => Err(io::ErrorKind::NotFound.into()),
        }
    }

    /// The configuration of the run `below` as text; none without a run.
    pub(crate) fn settings(&self, below: &Below) -> Option<String> {
        crate::facts::configuration_text(&self.root.dir(below).ok()?)
    }
}

impl Page {
    fn look(&mut self, root: &Root, below: &Below, locks: &Locks) -> Shown {
        if self.looked.is_none_or(|at| at.elapsed() >= LOOK_EVERY) {
            let json = self.contents(root, below, locks).unwrap_or_else(|error| {
                self.contents = None;
                let fault = (error.kind() != io::ErrorKind::NotFound).then(|| error.to_string());
                let path = root.path_of(below);
                json!({"kind": "missing", "below": below.to_string(), "path": path, "fault": fault})
                    .to_string()
            });
            if *json != *self.shown.json {
                self.shown = Shown { number: self.shown.number + 1, json: json.into() };
            }
            self.looked = Some(Instant::now());
        }
        self.shown.clone()
    }

    fn contents(&mut self, root: &Root, below: &Below, locks: &Locks) -> io::Result<String> {
        match (is_run(&root.dir(below)?), &mut self.contents) {
            (true, Some(Contents::Run(run))) => run.look(root, locks),
            (false, Some(Contents::Folder(folder))) => folder.look(root, locks),
            (true, other) => {
                let mut run = RunPage::new(below.clone());
                let json = run.look(root, locks);
                *other = Some(Contents::Run(Box::new(run)));
                json
            }
            (false, other) => {
                let mut folder = FolderPage::new(below.clone());
                let json = folder.look(root, locks);
                *other = Some(Contents::Folder(folder));
                json
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::fs;

    #[test]
    fn pages_that_nobody_looks_at_are_forgotten() {
        let place = tempfile::tempdir().unwrap();
        let pages = Pages::new(Root::new(place.path()).unwrap());
        for name in 0..3 * MAX_PAGES {
            fs::create_dir(place.path().join(name.to_string())).unwrap();
            let shown = pages.look(&Below::parse(&name.to_string()).unwrap());
            assert!(shown.json.contains("\"kind\":\"folder\""), "{}", shown.json);
        }
        assert_eq!(held(&pages.known).len(), MAX_PAGES);
    }

    #[test]
    fn a_folder_may_come_and_go() {
        let place = tempfile::tempdir().unwrap();
        let root = Root::new(&place.path().join("later")).unwrap();
        let mut page = Page { contents: None, looked: None, shown: Shown { number: 0, json: "null".into() } };
        let mut look = || {
            page.looked = None;
            let shown = page.look(&root, &Below::default(), &Locks::default());
            (shown.number, serde_json::from_str::<serde_json::Value>(&shown.json).unwrap()["kind"].clone())
        };
        assert_eq!(look(), (1, "missing".into()));
        assert_eq!(look().0, 1);
        fs::create_dir(place.path().join("later")).unwrap();
        assert_eq!(look(), (2, "folder".into()));
        fs::remove_dir(place.path().join("later")).unwrap();
        assert_eq!(look(), (3, "missing".into()));
    }
}
