//! Numbers in memory that starts at a cache line.

use std::ops::{Deref, DerefMut};

use bytemuck::{Pod, Zeroable, cast_slice, cast_slice_mut};

/// One cache line, and one register of AVX-512.
#[derive(Clone, Copy, Debug, Zeroable, Pod)]
#[repr(C, align(64))]
struct Line([f32; 16]);

/// A slice of `f32` with memory of its own that starts at a cache line; zeros at first.
///
/// The kernels accept any slice, but an AVX-512 access that is not aligned touches two cache lines. So scratch memory, and
/// parameters that single rows go through, are kept here.
#[derive(Clone, Debug)]
pub struct AlignedBuffer {
    lines: Vec<Line>,
    len: usize,
}

impl AlignedBuffer {
    /// `len` zeros.
    pub fn new(len: usize) -> AlignedBuffer {
        AlignedBuffer { lines: vec![Line::zeroed(); len.div_ceil(16)], len }
    }
}

impl Deref for AlignedBuffer {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        &cast_slice(&self.lines)[..self.len]
    }
}

impl DerefMut for AlignedBuffer {
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut cast_slice_mut(&mut self.lines)[..self.len]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_aligned_and_as_long_as_asked_for() {
        for len in [0, 1, 16, 17, 1000] {
            let mut buffer = AlignedBuffer::new(len);
            assert_eq!(*buffer, vec![0.0; len]);
            assert_eq!(buffer.as_ptr() as usize % 64, 0);
            buffer.fill(1.0);
            assert_eq!(*buffer.clone(), vec![1.0; len]);
        }
    }
}
