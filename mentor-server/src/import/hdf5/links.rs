//! Links that the library does not follow.
//!
//! *Soft links of the old style* are objects to it, over which it fails. Here such a link becomes a hard one to its object: in
//! the bytes that the library is given in the place of the node, not in the file. A link that leads nowhere is left out.
//!
//! *Soft links of the new style* it passes over. [`Finder`] follows them to the path by which the library knows their object.
//!
//! *Links into other files* are followed by nobody. [`Finder`] tells them from names that are not there.

use super::objects::{ENTRY, Link, NODE_HEADER, Nodes, Objects, entries, entry_name};
use std::cell::RefCell;
use std::collections::{BTreeMap, VecDeque};
use std::fs::File;
use std::rc::Rc;

/// Most soft links that are followed on the way to one object.
const MAX_FOLLOWED: usize = 16;
/// Groups with more links than this are kept in memory, until so many links are.
const MANY: usize = 16;
const MAX_KEPT: usize = 1 << 20;

/// The end of a path.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Found {
    /// An object: its path by hard links alone, and its header's address.
    Object(String, u64),
    /// Nothing, and no link either.
    Nothing,
    /// The link at the first path leads into another file, or to something that only the format's own library knows, which is named
    /// in words.
    Unread(String, String),
    /// The link at the first path leads nowhere.
    Dead(String, String),
}

type Names = Rc<BTreeMap<String, Link>>;

/// Follows paths in a file.
#[derive(Debug)]
pub(super) struct Finder {
    file: File,
    base: u64,
    root: Option<u64>,
    /// Links of large groups by their headers' addresses.
    kept: RefCell<BTreeMap<u64, Names>>,
}

impl Finder {
    /// For an open file whose addresses count from `base`.
    pub(super) fn new(file: File, base: u64) -> Self {
        let root = Objects::new(&file, base).root();
        Self { file, base, root, kept: RefCell::default() }
    }

    /// The links of the group whose header is at `header`, if that is one.
    fn links(&self, header: u64) -> Option<Names> {
        if let Some(known) = self.kept.borrow().get(&header) {
            return Some(known.clone());
        }
        let links: Names = Rc::new(Objects::new(&self.file, self.base).links(header)?.into_iter().collect());
        let mut kept = self.kept.borrow_mut();
        let all: usize = kept.values().map(|links| links.len()).sum();
        if links.len() > MANY && all + links.len() <= MAX_KEPT {
            kept.insert(header, links.clone());
        }
        Some(links)
    }

    /// The names in the group at `path` that are no hard links.
    pub(super) fn linked(&self, path: &str) -> Vec<String> {
        let Found::Object(_, header) = self.find(path) else { return Vec::new() };
        let soft = |(name, link): (&String, &Link)| (!matches!(link, Link::Hard(_))).then(|| name.clone());
        self.links(header).map_or(Vec::new(), |links| links.iter().filter_map(soft).collect())
    }

    /// What `path` leads to from the root.
    pub(super) fn find(&self, path: &str) -> Found {
        let Some(root) = self.root else { return Found::Nothing };
        let parts = |path: &str| -> Vec<String> {
            path.split('/').filter(|part| !part.is_empty() && *part != ".").map(String::from).collect()
        };
        let mut open: VecDeque<String> = parts(path).into();
        let (mut at, mut header): (Vec<String>, u64) = (Vec::new(), root);
        // The soft link that is being followed, and how many names of its target are still to be found.
        let (mut link_at, mut of_target) = ((String::new(), String::new()), 0_usize);
        let mut followed = 0;
        while let Some(part) = open.pop_front() {
            let Some(link) = self.links(header).and_then(|links| links.get(&part).cloned()) else {
                let (own, target) = link_at;
                return match of_target {
                    0 => Found::Nothing,
                    _ => Found::Dead(own, format!("a soft link to `{target}`, which is not in the file")),
                };
            };
            let within = of_target > 0;
            of_target = of_target.saturating_sub(1);
            let own = || at.iter().chain([&part]).map(|part| format!("/{part}")).collect::<String>();
            match link {
                Link::Hard(next) => {
                    at.push(part);
                    header = next;
                }
                Link::Soft(target) => {
                    followed += 1;
                    // Of links that lead to links the first one is to blame.
                    if !within {
                        link_at = (own(), target.clone());
                    }
                    if followed > MAX_FOLLOWED {
                        return Found::Dead(own(), "a soft link that leads to itself".into());
                    }
                    if target.starts_with('/') {
                        at.clear();
                        header = root;
                    }
                    let target = parts(&target);
                    of_target += target.len();
                    target.into_iter().rev().for_each(|part| open.push_front(part));
                }
                Link::External { file, path } => {
                    return Found::Unread(own(), format!("a link to `{path}` in the file `{file}`"));
                }
                Link::Other(kind) => {
                    return Found::Unread(own(), format!("a link of the unknown kind {kind}"));
                }
            }
        }
        Found::Object(at.join("/"), header)
    }
}

/// The bytes of `file` that the library should see instead of the real ones, by their places, so that soft links of the old style are
/// hard ones. Empty where there are no such links, or where the file is damaged: the library says what is wrong then.
pub(super) fn hardened(file: &File, finder: &Finder) -> BTreeMap<u64, Vec<u8>> {
    let mut objects = Objects::new(file, finder.base);
    let mut patches = BTreeMap::new();
    let mut open: Vec<(u64, String)> = finder.root.map(|root| (root, String::new())).into_iter().collect();
    let mut seen = std::collections::BTreeSet::new();
    while let Some((header, path)) = open.pop() {
        if !seen.insert(header) {
            continue;
        }
        let Some(group) = objects.old_style(header) else { continue };
        for (name, link) in group.links() {
            if let Link::Hard(below) = link {
                open.push((below, format!("{path}/{name}")));
            }
        }
        for (address, node) in &group.nodes {
            if let Some(bytes) = without_soft(&group, node, &path, finder) {
                patches.insert(finder.base.saturating_add(*address), bytes);
            }
        }
    }
    patches
}

/// The node with hard links in the place of soft ones; none where it has no soft ones.
fn without_soft(group: &Nodes, node: &[u8], path: &str, finder: &Finder) -> Option<Vec<u8>> {
    let mut out: Vec<u8> = Vec::new();
    for entry in entries(node) {
        if group.target(entry).is_none() {
            out.extend_from_slice(entry);
            continue;
        }
        let own = entry_name(&group.heap, entry).unwrap_or_default();
        if let Found::Object(_, header) = finder.find(&format!("{path}/{own}")) {
            out.extend_from_slice(&entry[..8]);
            out.extend_from_slice(&header.to_le_bytes());
            out.extend_from_slice(&[0; ENTRY - 16]);
        }
    }
    if out == node[NODE_HEADER..] {
        return None;
    }
    let count = (out.len() / ENTRY) as u16;
    let mut bytes = [&node[..6], &count.to_le_bytes(), &out].concat();
    bytes.resize(node.len(), 0);
    Some(bytes)
}
