//! Soft links in groups of the old style, which the library takes for objects and fails over.
//!
//! A group of that style is a B-tree of symbol table nodes with the names in a heap (HDF5 file format, III.A to III.C). Here
//! its links are read, and a soft link becomes a hard one to what it leads to: in what the library is given in the place of
//! the node's bytes, not in the file. A link that leads nowhere is left out, and remembered for messages.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;

/// Most nodes that are read, and most links that are followed one after the other.
const MAX_NODES: usize = 1 << 20;
const MAX_FOLLOWED: usize = 16;
/// Largest heap of names that is read, bytes.
const MAX_HEAP: u64 = 16 << 20;
/// Bytes of an entry, and of what is before them in a node.
const ENTRY: usize = 40;
const NODE_HEADER: usize = 8;
/// Entries that a node has at most: twice the largest rank that is in use.
const MAX_ENTRIES: usize = 1 << 12;

/// What the library should see instead of the file's bytes, and what it should not see at all.
#[derive(Debug, Default)]
pub(super) struct Links {
    /// Bytes by their place in the file.
    pub(super) patches: BTreeMap<u64, Vec<u8>>,
    /// Paths of soft links that lead nowhere, and where they should lead.
    pub(super) dangling: Vec<(String, String)>,
}

/// The groups of a file.
struct Walk<'a> {
    file: &'a File,
    base: u64,
    nodes: usize,
    groups: Vec<Group>,
    /// The group by the address of its B-tree.
    known: BTreeMap<u64, usize>,
    root: (u64, usize),
}

#[derive(Default)]
struct Group {
    path: String,
    links: BTreeMap<String, Link>,
    /// Places and bytes of its nodes.
    nodes: Vec<(u64, Vec<u8>)>,
    heap: Vec<u8>,
}

#[derive(Clone)]
enum Link {
    /// An object by the address of its header, and its group if it is one.
    Hard(u64, Option<usize>),
    Soft(String),
}

/// The soft links of a file with a superblock of version 0 or 1 at `base`; nothing where it has another, or is damaged: the
/// library says what is wrong then.
pub(super) fn soft_links(file: &File, base: u64) -> Links {
    let mut walk = Walk { file, base, nodes: 0, groups: Vec::new(), known: BTreeMap::new(), root: (0, 0) };
    if walk.all().is_none() || walk.groups.iter().all(|group| group.softs().next().is_none()) {
        return Links::default();
    }
    walk.patched()
}

impl Group {
    fn softs(&self) -> impl Iterator<Item = (&String, &String)> {
        self.links.iter().filter_map(|(name, link)| match link {
            Link::Soft(target) => Some((name, target)),
            Link::Hard(..) => None,
        })
    }
}

impl Walk<'_> {
    /// Bytes at an address of the file.
    fn bytes(&mut self, address: u64, count: usize) -> Option<Vec<u8>> {
        self.nodes += 1;
        if self.nodes > MAX_NODES {
            return None;
        }
        let mut bytes = vec![0; count];
        self.file.read_exact_at(&mut bytes, self.base.checked_add(address)?).ok()?;
        Some(bytes)
    }

    fn all(&mut self) -> Option<()> {
        let start = self.bytes(0, 128)?;
        let entry = match (start[8], start[13], start[14]) {
            (0, 8, 8) => 56,
            (1, 8, 8) => 60,
            _ => return None,
        };
        let (header, tables) = (word(&start, entry + 8)?, self.tables(&start, entry)?);
        let root = self.group(String::new(), tables);
        self.root = (header, root);
        let mut at = 0;
        while at < self.groups.len() {
            self.read_group(at)?;
            at += 1;
        }
        Some(())
    }

    /// B-tree and heap of the group that the entry at `at` of `bytes` leads to; none where that is no group.
    fn tables(&mut self, bytes: &[u8], at: usize) -> Option<(u64, u64)> {
        if bytes.get(at + 16) == Some(&1) {
            return Some((word(bytes, at + 24)?, word(bytes, at + 32)?));
        }
        // What the entry does not say, the message 0x11 of the object's header does (of version 1, in its first block).
        let header = word(bytes, at + 8)?;
        let prefix = self.bytes(header, 16)?;
        let size = (u32::from_le_bytes(prefix[8..12].try_into().ok()?) as usize).min(1 << 16);
        if prefix[0] != 1 {
            return None;
        }
        let messages = self.bytes(header + 16, size)?;
        let mut at = 0;
        while at + 8 <= messages.len() {
            let [kind, length] = [at, at + 2].map(|at| u16::from_le_bytes([messages[at], messages[at + 1]]));
            if kind == 0x11 {
                return Some((word(&messages, at + 8)?, word(&messages, at + 16)?));
            }
            at += 8 + usize::from(length);
        }
        None
    }

    /// The group with these tables, to be read later if it is new.
    fn group(&mut self, path: String, (tree, heap): (u64, u64)) -> usize {
        let next = self.groups.len();
        let index = *self.known.entry(tree).or_insert(next);
        if index == next {
            self.groups.push(Group {
                path,
                nodes: vec![(tree, Vec::new()), (heap, Vec::new())],
                ..Group::default()
            });
        }
        index
    }

    fn read_group(&mut self, index: usize) -> Option<()> {
        let path = self.groups[index].path.clone();
        let [tree, heap] = [0, 1].map(|i: usize| self.groups[index].nodes[i].0);
        let head = self.bytes(heap, 32)?;
        let (size, data) = (word(&head, 8)?, word(&head, 24)?);
        if !head.starts_with(b"HEAP") || size > MAX_HEAP {
            return None;
        }
        let heap = self.bytes(data, size as usize)?;
        let mut nodes = Vec::new();
        self.leaves(tree, 64, &mut BTreeSet::new(), &mut nodes)?;
        let mut links = BTreeMap::new();
        for (_, node) in &nodes {
            for at in (NODE_HEADER..node.len()).step_by(ENTRY) {
                let name = name(&heap, word(node, at)?)?;
                let link = if node[at + 16] == 2 {
                    Link::Soft(self::name(&heap, word(node, at + 24)? & 0xffff_ffff)?)
                } else {
                    let below = format!("{path}/{name}");
                    let tables = self.tables(node, at);
                    Link::Hard(word(node, at + 8)?, tables.map(|tables| self.group(below, tables)))
                };
                links.insert(name, link);
            }
        }
        let group = &mut self.groups[index];
        (group.nodes, group.links, group.heap) = (nodes, links, heap);
        Some(())
    }

    /// The symbol table nodes below the B-tree's node at `address`, which is at most `depth` levels high.
    fn leaves(
        &mut self,
        address: u64,
        depth: usize,
        seen: &mut BTreeSet<u64>,
        out: &mut Vec<(u64, Vec<u8>)>,
    ) -> Option<()> {
        let head = self.bytes(address, 24)?;
        if !head.starts_with(b"TREE\0") || depth == 0 || !seen.insert(address) {
            return None;
        }
        let (level, count) = (head[5], usize::from(u16::from_le_bytes([head[6], head[7]])));
        let children = self.bytes(address + 24, 16 * count + 8)?;
        for i in 0..count {
            let child = word(&children, 16 * i + 8)?;
            if level > 0 {
                self.leaves(child, depth - 1, seen, out)?;
                continue;
            }
            let head = self.bytes(child, NODE_HEADER)?;
            let count = usize::from(u16::from_le_bytes([head[6], head[7]]));
            if !head.starts_with(b"SNOD") || count > MAX_ENTRIES || !seen.insert(child) {
                return None;
            }
            out.push((child, self.bytes(child, NODE_HEADER + ENTRY * count)?));
        }
        Some(())
    }

    /// The header's address of what `target` leads to from the group `from`.
    fn follow(&self, from: usize, target: &str, left: usize) -> Option<(u64, Option<usize>)> {
        let left = left.checked_sub(1)?;
        let (mut header, mut group) =
            if target.starts_with('/') { (self.root.0, self.root.1) } else { (0, from) };
        let mut parts = target.split('/').filter(|part| !part.is_empty() && *part != ".").peekable();
        if parts.peek().is_none() {
            return target.starts_with('/').then_some((header, Some(group)));
        }
        while let Some(part) = parts.next() {
            let (found, below) = match self.groups[group].links.get(part)? {
                Link::Hard(header, below) => (*header, *below),
                Link::Soft(next) => self.follow(group, next, left)?,
            };
            header = found;
            match (below, parts.peek()) {
                (below, None) => return Some((header, below)),
                (Some(below), Some(_)) => group = below,
                (None, Some(_)) => return None,
            }
        }
        None
    }

    fn patched(&self) -> Links {
        let mut out = Links::default();
        for (index, group) in self.groups.iter().enumerate() {
            for (address, node) in &group.nodes {
                let mut entries = Vec::new();
                for entry in node[NODE_HEADER..].chunks_exact(ENTRY) {
                    if entry[16] != 2 {
                        entries.extend_from_slice(entry);
                        continue;
                    }
                    let target = word(entry, 24)
                        .and_then(|at| name(&group.heap, at & 0xffff_ffff))
                        .unwrap_or_default();
                    match self.follow(index, &target, MAX_FOLLOWED) {
                        Some((header, _)) => {
                            entries.extend_from_slice(&entry[..8]);
                            entries.extend_from_slice(&header.to_le_bytes());
                            entries.extend_from_slice(&[0; ENTRY - 16]);
                        }
                        None => {
                            let own = word(entry, 0).and_then(|at| name(&group.heap, at)).unwrap_or_default();
                            out.dangling.push((format!("{}/{own}", group.path), target));
                        }
                    }
                }
                if entries == node[NODE_HEADER..] {
                    continue;
                }
                let count = (entries.len() / ENTRY) as u16;
                let mut bytes = [&node[..6], &count.to_le_bytes(), &entries].concat();
                bytes.resize(node.len(), 0);
                out.patches.insert(self.base + address, bytes);
            }
        }
        out
    }
}

/// The 8 bytes at `at`.
fn word(bytes: &[u8], at: usize) -> Option<u64> {
    Some(u64::from_le_bytes(bytes.get(at..at.checked_add(8)?)?.try_into().ok()?))
}

/// The text at `at` of a heap, which a zero ends.
fn name(heap: &[u8], at: u64) -> Option<String> {
    let rest = heap.get(usize::try_from(at).ok()?..)?;
    let end = rest.iter().position(|&byte| byte == 0)?;
    Some(String::from_utf8_lossy(&rest[..end]).into_owned())
}

/// What a link of the new style called `name` leads to, for messages: the library leaves out those that are no hard ones.
///
/// Its message is looked for in the file's first bytes (HDF5 file format, IV.A.2.g): version, flags, type, perhaps a creation
/// order and a character set, the name's length and the name, then the target.
pub(super) fn link_named(file: &File, name: &str) -> io::Result<Option<String>> {
    const LOOKED_AT: u64 = 16 << 20;
    let length = file.metadata()?.len().min(LOOKED_AT) as usize;
    let mut bytes = vec![0; length];
    file.read_exact_at(&mut bytes, 0)?;
    let found = bytes.windows(name.len().max(1)).enumerate().filter(|(_, window)| *window == name.as_bytes());
    Ok(found.map(|(at, _)| at).find_map(|at| target_at(&bytes, at, name.len())))
}

/// The target of the link whose name of `length` bytes is at `at`.
fn target_at(bytes: &[u8], at: usize, length: usize) -> Option<String> {
    let before = |count: usize| at.checked_sub(count).map(|at| bytes[at]);
    if before(1) != u8::try_from(length).ok() {
        return None;
    }
    let [order, set] = [0x04, 0x10];
    for flags in [0x08, 0x08 | order, 0x08 | set, 0x08 | order | set] {
        let skipped = 1 + usize::from(flags & set != 0) + 8 * usize::from(flags & order != 0);
        let (kind, own, version) = (before(skipped + 1), before(skipped + 2), before(skipped + 3));
        if own != Some(flags) || version != Some(1) {
            continue;
        }
        let value = bytes.get(at + length..)?;
        let size = usize::from(u16::from_le_bytes([*value.first()?, *value.get(1)?]));
        let value = value.get(2..2 + size)?;
        return match kind {
            Some(1) => Some(format!("a soft link to `{}`", String::from_utf8_lossy(value))),
            Some(64) => {
                let mut parts = value.get(1..)?.split(|&byte| byte == 0).map(String::from_utf8_lossy);
                Some(format!("a link to `{}` in the file `{}`", parts.clone().nth(1)?, parts.next()?))
            }
            _ => None,
        };
    }
    None
}
