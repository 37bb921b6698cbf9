//! The links of a group that has many: objects of a fractal heap, which a B-tree of version 2 lists by their names' hashes
//! (HDF5 file format, III.A.2, III.G).

use super::{Objects, little, word};
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

/// How high a B-tree, and how deep a heap's blocks within blocks, at the most.
const MAX_DEPTH: usize = 16;
/// Most links of a group.
const MAX_LINKS: usize = 1 << 20;
/// Largest block of a heap, largest node of a tree, and largest object, bytes.
const MAX_BLOCK: u64 = 1 << 24;
/// Before the records of a node: its signature, version and type. Behind them is a checksum.
const NODE_START: usize = 6;
const CHECKSUM: usize = 4;
/// Bytes of a name's hash.
const HASH: usize = 4;

/// A heap's shape.
struct Heap {
    /// Bytes of an object's place and of its length.
    place: usize,
    id: usize,
    /// Blocks in a row, and bytes of a block of the first row.
    width: u64,
    first: u64,
    /// Rows of blocks with objects in them; the rows behind have blocks of blocks.
    direct_rows: u32,
    root: u64,
    /// Rows of the root; 0 where it has objects in it itself.
    rows: u32,
}

/// The objects of the heap at `heap` that the tree at `index` lists.
pub(super) fn objects(file: &mut Objects<'_>, heap: u64, index: u64) -> Option<Vec<Vec<u8>>> {
    let heap = Heap::read(file, heap)?;
    let mut known = BTreeMap::new();
    let mut out = Vec::new();
    for id in records(file, index)? {
        let id = id.get(HASH..HASH.checked_add(heap.id)?)?;
        // Huge and tiny objects are not managed ones: no link is such.
        if id.first()? & 0xf0 != 0 {
            return None;
        }
        let place = little(id.get(1..1 + heap.place)?)?;
        let length = little(id.get(1 + heap.place..)?)?;
        let (block, start, size) = heap.block(file, place, &mut known)?;
        if length > MAX_BLOCK || place.checked_add(length)? > start.checked_add(size)? {
            return None;
        }
        out.push(file.bytes(block.checked_add(place - start)?, length as usize)?);
    }
    Some(out)
}

impl Heap {
    fn read(file: &mut Objects<'_>, address: u64) -> Option<Self> {
        let head = file.bytes(address, 146)?;
        let half = |at: usize| u16::from_le_bytes([head[at], head[at + 1]]);
        // One with filters holds no links.
        if !head.starts_with(b"FRHP\0") || half(7) != 0 {
            return None;
        }
        let (width, first, largest) = (u64::from(half(110)), word(&head, 112)?, word(&head, 120)?);
        let place = usize::from(half(128)).div_ceil(8);
        let id = usize::from(half(5));
        let sound = first.is_power_of_two() && largest.is_power_of_two() && first <= largest;
        if !sound || largest > MAX_BLOCK || width == 0 || place > 8 || id <= 1 + place || id > 9 + place {
            return None;
        }
        Some(Self {
            place,
            id,
            width,
            first,
            direct_rows: largest.ilog2() - first.ilog2() + 2,
            root: word(&head, 132)?,
            rows: u32::from(half(140)),
        })
    }

    /// Bytes of a block in row `row`.
    fn size(&self, row: u32) -> Option<u64> {
        self.first.checked_mul(1_u64.checked_shl(row.saturating_sub(1))?)
    }

    /// The block in which `place` is: its address, its own place and its size. `known`: blocks of blocks that have been read.
    fn block(
        &self,
        file: &mut Objects<'_>,
        place: u64,
        known: &mut BTreeMap<u64, Vec<u8>>,
    ) -> Option<(u64, u64, u64)> {
        if self.rows == 0 {
            return Some((self.root, 0, self.first));
        }
        let (mut address, mut start, mut rows) = (self.root, 0, self.rows);
        for _ in 0..MAX_DEPTH {
            let within = place.checked_sub(start)?;
            // Rows 0 and 1 have blocks of one size; from there on each has the double.
            let of_first = self.width.checked_mul(self.first)?;
            let row = (within / of_first).checked_ilog2().map_or(0, |double| double + 1);
            if row >= rows {
                return None;
            }
            let size = self.size(row)?;
            let before = if row == 0 { 0 } else { of_first.checked_mul(1_u64.checked_shl(row - 1)?)? };
            let column = (within - before) / size;
            let bytes = match known.entry(address) {
                Entry::Occupied(known) => known.into_mut(),
                Entry::Vacant(unknown) => {
                    let entries = usize::try_from(u64::from(rows).checked_mul(self.width)?).ok()?;
                    let bytes = file.bytes(address, 13 + self.place + 8 * entries.min(1 << 16))?;
                    unknown.insert(bytes.starts_with(b"FHIB\0").then_some(bytes)?)
                }
            };
            let nth = usize::try_from(u64::from(row) * self.width + column).ok()?;
            let next = word(bytes, 13 + self.place + 8 * nth)?;
            start = start.checked_add(before)?.checked_add(column.checked_mul(size)?)?;
            address = next;
            if row < self.direct_rows {
                return Some((address, start, size));
            }
            rows = size.ilog2().checked_sub(of_first.ilog2())? + 1;
        }
        None
    }
}

/// The records of the B-tree of version 2 at `address`, which must be one of names.
fn records(file: &mut Objects<'_>, address: u64) -> Option<Vec<Vec<u8>>> {
    const BY_NAME: u8 = 5;
    let head = file.bytes(address, 38)?;
    let half = |at: usize| usize::from(u16::from_le_bytes([head[at], head[at + 1]]));
    let node = little(&head[6..10])? as usize;
    let (record, depth) = (half(10), half(12));
    if !head.starts_with(b"BTHD\0") || head[5] != BY_NAME || record == 0 || node as u64 > MAX_BLOCK {
        return None;
    }
    if depth > MAX_DEPTH {
        return None;
    }
    // By height above the leaves: bytes of a child's number of records, those in all below it included.
    let room = node.checked_sub(NODE_START + CHECKSUM)?;
    let leaf = (room / record) as u64;
    let own = enough(leaf);
    let (mut most, mut widths) = (leaf, vec![0]);
    for height in 1..=depth {
        let pointer = 8 + own + widths[height - 1];
        let records = (room.checked_sub(pointer)? / (record + pointer)) as u64;
        most = records.checked_add(1)?.checked_mul(most)?.checked_add(records)?;
        widths.push(enough(most));
    }
    let mut out = Vec::new();
    let mut open = vec![(word(&head, 16)?, half(24), depth)];
    while let Some((address, count, height)) = open.pop() {
        if count == 0 && address == u64::MAX {
            continue;
        }
        let bytes = file.bytes(address, node)?;
        if !bytes.starts_with(if height == 0 { b"BTLF\0" } else { b"BTIN\0" }) {
            return None;
        }
        let records = bytes.get(NODE_START..NODE_START.checked_add(count.checked_mul(record)?)?)?;
        out.extend(records.chunks_exact(record).map(<[u8]>::to_vec));
        if out.len() > MAX_LINKS {
            return None;
        }
        if height > 0 {
            let pointer = 8 + own + widths[height - 1];
            let pointers = bytes.get(NODE_START + records.len()..)?;
            for child in pointers.chunks_exact(pointer).take(count + 1) {
                let count = usize::try_from(little(&child[8..8 + own])?).ok()?;
                open.push((word(child, 0)?, count, height - 1));
            }
        }
    }
    Some(out)
}

/// Bytes that are enough for a number up to `most`.
fn enough(most: u64) -> usize {
    most.checked_ilog2().map_or(1, |bits| bits as usize / 8 + 1)
}
