//! An HDF5 file's groups as they lie in it: which links each has, of the old style and of the new one.
//!
//! The library follows hard links alone. So links of the other kinds are read here (HDF5 file format, III.A to III.C for groups of
//! the old style, III.A.2 and IV.A for object headers, and `dense` for groups with many links). Bytes that do not look as they
//! should are no link: the library says what is wrong with a file.

mod dense;

use std::collections::BTreeSet;
use std::fs::File;
use std::os::unix::fs::FileExt;

/// Most reads of one file, all groups together.
const MAX_READS: usize = 1 << 21;
/// Largest block of an object header, and largest heap of names, bytes.
const MAX_HEADER: usize = 1 << 20;
const MAX_HEAP: u64 = 16 << 20;
/// Most blocks of an object header.
const MAX_BLOCKS: usize = 1 << 10;
/// How high a B-tree of the old style is, at the most.
const MAX_HEIGHT: usize = 64;
/// Bytes of an entry of a symbol table, and of the header before the entries of a node.
pub(super) const ENTRY: usize = 40;
pub(super) const NODE_HEADER: usize = 8;
/// Entries that a node has at most: twice the largest rank that is in use.
const MAX_ENTRIES: usize = 1 << 12;
/// Kinds of messages in an object header.
const LINK_INFO: u16 = 0x02;
const LINK: u16 = 0x06;
const CONTINUATION: u16 = 0x10;
const SYMBOL_TABLE: u16 = 0x11;

/// The target of a name in a group.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Link {
    /// An object, by the address of its header.
    Hard(u64),
    /// A path in the same file.
    Soft(String),
    /// A path in another file.
    External { file: String, path: String },
    /// A kind that a user of the format has made up, by its number.
    Other(u8),
}

/// Nodes of a group of the old style, by their places in the file, and its names.
#[derive(Debug, Default)]
pub(super) struct Nodes {
    pub(super) nodes: Vec<(u64, Vec<u8>)>,
    pub(super) heap: Vec<u8>,
}

/// The file's bytes.
#[derive(Debug)]
pub(super) struct Objects<'a> {
    file: &'a File,
    /// Where addresses count from.
    pub(super) base: u64,
    reads: usize,
}

impl<'a> Objects<'a> {
    pub(super) fn new(file: &'a File, base: u64) -> Self {
        Self { file, base, reads: 0 }
    }

    /// `count` bytes at an address.
    pub(super) fn bytes(&mut self, address: u64, count: usize) -> Option<Vec<u8>> {
        self.reads += 1;
        if self.reads > MAX_READS {
            return None;
        }
        let mut bytes = vec![0; count];
        self.file.read_exact_at(&mut bytes, self.base.checked_add(address)?).ok()?;
        Some(bytes)
    }

    /// The address of the root group's header.
    pub(super) fn root(&mut self) -> Option<u64> {
        let start = self.bytes(0, 96)?;
        let at = match (start[8], start[13], start[14], start[9], start[10]) {
            (0, 8, 8, ..) => 64,
            (1, 8, 8, ..) => 68,
            (2 | 3, _, _, 8, 8) => 36,
            _ => return None,
        };
        word(&start, at)
    }

    /// The links of the group whose header is at `header`; none where that is no group.
    pub(super) fn links(&mut self, header: u64) -> Option<Vec<(String, Link)>> {
        let messages = self.messages(header)?;
        let of = |wanted: u16| messages.iter().filter(move |(kind, _)| *kind == wanted).map(|(_, body)| body);
        if let Some(tables) = of(SYMBOL_TABLE).next() {
            let nodes = self.nodes(word(tables, 0)?, word(tables, 8)?)?;
            return Some(nodes.links());
        }
        let mut bodies: Vec<Vec<u8>> = of(LINK).cloned().collect();
        let info = of(LINK_INFO).next();
        if info.is_none() && bodies.is_empty() {
            return None;
        }
        if let Some(info) = info {
            let at = 2 + 8 * usize::from(info.get(1)? & 1);
            let (heap, index) = (word(info, at)?, word(info, at + 8)?);
            if heap != u64::MAX {
                bodies.extend(dense::objects(self, heap, index)?);
            }
        }
        bodies.iter().map(|body| link(body)).collect()
    }

    /// The nodes of the old-style group whose header is at `header`; none where that is something else.
    pub(super) fn old_style(&mut self, header: u64) -> Option<Nodes> {
        let messages = self.messages(header)?;
        let (_, tables) = messages.iter().find(|(kind, _)| *kind == SYMBOL_TABLE)?;
        self.nodes(word(tables, 0)?, word(tables, 8)?)
    }

    /// Kinds and bodies of the messages in an object header.
    fn messages(&mut self, header: u64) -> Option<Vec<(u16, Vec<u8>)>> {
        let prefix = self.bytes(header, 16)?;
        let mut out = Vec::new();
        // Blocks with messages still to be read: address and length.
        let mut blocks = Vec::new();
        let second = prefix.starts_with(b"OHDR");
        let mut flags = 0;
        if second {
            flags = prefix[5];
            let start = 6 + 16 * u64::from(flags >> 5 & 1) + 4 * u64::from(flags >> 4 & 1);
            let width = 1 << (flags & 3);
            let size = little(&self.bytes(header.checked_add(start)?, width)?)?;
            blocks.push((header.checked_add(start + width as u64)?, size));
        } else if prefix[0] == 1 {
            blocks.push((header.checked_add(16)?, little(&prefix[8..12])?));
        } else {
            return None;
        }
        let mut read = 0;
        while let Some((address, size)) = blocks.pop() {
            let size = usize::try_from(size).ok().filter(|&size| size <= MAX_HEADER)?;
            read += 1;
            if read > MAX_BLOCKS {
                return None;
            }
            let block = self.bytes(address, size)?;
            let mut at = 0;
            // Behind the last message there may be a gap.
            while let Some((kind, body)) = message(&block, &mut at, second.then_some(flags)) {
                if kind == CONTINUATION {
                    let (address, length) = (word(body, 0)?, word(body, 8)?);
                    // A signature before, and a checksum behind the messages.
                    blocks.push(if second {
                        (address.checked_add(4)?, length.checked_sub(8)?)
                    } else {
                        (address, length)
                    });
                } else if [LINK_INFO, LINK, SYMBOL_TABLE].contains(&kind) {
                    out.push((kind, body.to_vec()));
                }
            }
        }
        Some(out)
    }

    /// The nodes of the group with a B-tree and a heap at these addresses.
    fn nodes(&mut self, tree: u64, heap: u64) -> Option<Nodes> {
        let head = self.bytes(heap, 32)?;
        let (size, data) = (word(&head, 8)?, word(&head, 24)?);
        if !head.starts_with(b"HEAP") || size > MAX_HEAP {
            return None;
        }
        let heap = self.bytes(data, size as usize)?;
        let mut nodes = Vec::new();
        self.leaves(tree, MAX_HEIGHT, &mut BTreeSet::new(), &mut nodes)?;
        let known =
            |(_, node): &(u64, Vec<u8>)| entries(node).all(|entry| entry_name(&heap, entry).is_some());
        if !nodes.iter().all(known) {
            return None;
        }
        Some(Nodes { nodes, heap })
    }

    /// The symbol table nodes below the B-tree's node at `address`, which is at most `height` levels high.
    fn leaves(
        &mut self,
        address: u64,
        height: usize,
        seen: &mut BTreeSet<u64>,
        out: &mut Vec<(u64, Vec<u8>)>,
    ) -> Option<()> {
        let head = self.bytes(address, 24)?;
        if !head.starts_with(b"TREE\0") || height == 0 || !seen.insert(address) {
            return None;
        }
        let (level, count) = (head[5], usize::from(u16::from_le_bytes([head[6], head[7]])));
        let children = self.bytes(address + 24, 16 * count + 8)?;
        for i in 0..count {
            let child = word(&children, 16 * i + 8)?;
            if level > 0 {
                self.leaves(child, height - 1, seen, out)?;
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
}

impl Nodes {
    pub(super) fn links(&self) -> Vec<(String, Link)> {
        let of = |entry: &[u8]| Some((entry_name(&self.heap, entry)?, self.link(entry)?));
        self.nodes.iter().flat_map(|(_, node)| entries(node)).filter_map(of).collect()
    }

    /// What an entry leads to.
    fn link(&self, entry: &[u8]) -> Option<Link> {
        match self.target(entry) {
            Some(target) => Some(Link::Soft(target)),
            None => word(entry, 8).map(Link::Hard),
        }
    }

    /// The path of an entry that is a soft link.
    pub(super) fn target(&self, entry: &[u8]) -> Option<String> {
        if entry[16] != 2 {
            return None;
        }
        name(&self.heap, word(entry, 24)? & 0xffff_ffff)
    }
}

/// The entries of a symbol table node.
pub(super) fn entries(node: &[u8]) -> impl Iterator<Item = &[u8]> {
    node[NODE_HEADER..].chunks_exact(ENTRY)
}

/// An entry's own name.
pub(super) fn entry_name(heap: &[u8], entry: &[u8]) -> Option<String> {
    name(heap, word(entry, 0)?)
}

/// The message at `at` of a block, and moves `at` behind it. `flags`: the flags of a header of version 2.
fn message<'a>(block: &'a [u8], at: &mut usize, flags: Option<u8>) -> Option<(u16, &'a [u8])> {
    let head = block.get(*at..)?;
    let (kind, size, start) = match flags {
        Some(flags) => {
            let start = if flags & 4 != 0 { 6 } else { 4 };
            (u16::from(*head.first()?), u16::from_le_bytes([*head.get(1)?, *head.get(2)?]), start)
        }
        None => {
            let half = |at: usize| Some(u16::from_le_bytes([*head.get(at)?, *head.get(at + 1)?]));
            (half(0)?, half(2)?, 8)
        }
    };
    let body = head.get(start..start + usize::from(size))?;
    *at += start + usize::from(size);
    Some((kind, body))
}

/// The link that a message describes, and its name.
fn link(body: &[u8]) -> Option<(String, Link)> {
    let (&version, &flags) = (body.first()?, body.get(1)?);
    if version != 1 {
        return None;
    }
    let mut at = 2;
    let kind = if flags & 0x08 != 0 {
        at += 1;
        *body.get(2)?
    } else {
        0
    };
    at += if flags & 0x04 != 0 { 8 } else { 0 } + usize::from(flags & 0x10 != 0);
    let width = 1 << (flags & 3);
    let length = usize::try_from(little(body.get(at..at + width)?)?).ok()?;
    at += width;
    let name = String::from_utf8_lossy(body.get(at..at.checked_add(length)?)?).into_owned();
    let rest = body.get(at + length..)?;
    let value = || rest.get(2..2 + usize::from(u16::from_le_bytes([*rest.first()?, *rest.get(1)?])));
    let link = match kind {
        0 => Link::Hard(word(rest, 0)?),
        1 => Link::Soft(String::from_utf8_lossy(value()?).into_owned()),
        64 => {
            let mut parts = value()?.get(1..)?.split(|&byte| byte == 0).map(String::from_utf8_lossy);
            let (file, path) = (parts.next()?.into_owned(), parts.next()?.into_owned());
            Link::External { file, path }
        }
        other => Link::Other(other),
    };
    Some((name, link))
}

/// The 8 bytes at `at`.
pub(super) fn word(bytes: &[u8], at: usize) -> Option<u64> {
    Some(u64::from_le_bytes(bytes.get(at..at.checked_add(8)?)?.try_into().ok()?))
}

/// Up to 8 bytes as a number.
pub(super) fn little(bytes: &[u8]) -> Option<u64> {
    (bytes.len() <= 8).then(|| bytes.iter().rev().fold(0, |number, &byte| number << 8 | u64::from(byte)))
}

/// The text at `at` of a heap, which a zero ends.
fn name(heap: &[u8], at: u64) -> Option<String> {
    let rest = heap.get(usize::try_from(at).ok()?..)?;
    let end = rest.iter().position(|&byte| byte == 0)?;
    Some(String::from_utf8_lossy(&rest[..end]).into_owned())
}
