//! A broadcast of the Q-network's weights: one flat vector, and a header that says what it is.
//!
//! The payload is, layer by layer, the weights \[in\]\[out\] row-major and then the bias \[out\], all `f32`.

use crate::limits::MAX_SIZES;
use crate::message::Message;
use bytemuck::{Pod, Zeroable, cast_slice};

/// What is sent beside the weights.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct WeightsHeader {
    /// Identity of the run.
    pub run: u64,
    /// The round after which these weights stood; 0 for the initial ones.
    pub version: u64,
    /// The learner's start that they are of ([`crate::plan::RunPlan::generation`]).
    pub generation: u32,
    /// 0.
    pub reserved: u32,
    /// CRC-32C of the payload's bytes.
    pub checksum: u32,
    /// How many of `sizes` are used.
    pub n_sizes: u32,
    /// Units of the input, of each hidden layer and of the output.
    pub sizes: [u32; MAX_SIZES],
}

impl Message for WeightsHeader {
    const TYPE_NAME: &'static str = "trestle.WeightsHeader.v2";
}

/// Weights that cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum WeightsError {
    /// Another run's.
    #[error("weights are of run {found:016x}; this is run {expected:016x}")]
    Run {
        /// Their run.
        found: u64,
        /// This run.
        expected: u64,
    },
    /// Another network's.
    #[error("weights are of a network {found:?}; this run's is {expected:?}")]
    Sizes {
        /// Sizes in the header.
        found: Vec<u32>,
        /// Sizes of this run.
        expected: Vec<u32>,
    },
    /// Torn or damaged.
    #[error("weights version {version} have checksum {found:08x}; their header says {expected:08x}")]
    Checksum {
        /// Their version.
        version: u64,
        /// What was computed.
        found: u32,
        /// What was announced.
        expected: u32,
    },
}

impl WeightsHeader {
    /// The header of `weights`, of a network with `sizes` (at most [`MAX_SIZES`]).
    pub fn new(run: u64, generation: u16, version: u64, sizes: &[u32], weights: &[f32]) -> Self {
        let (generation, n_sizes) = (generation.into(), sizes.len() as u32);
        let mut header = Self { run, version, generation, n_sizes, ..Self::default() };
        header.sizes[..sizes.len()].copy_from_slice(sizes);
        header.checksum = crc32c::crc32c(cast_slice(weights));
        header
    }

    /// Copies what a peer sent into `into` (of the run's number of parameters) and checks the copy.
    pub fn receive(
        &self,
        run: u64,
        sizes: &[u32],
        payload: &[f32],
        into: &mut [f32],
    ) -> Result<(), WeightsError> {
        if self.run != run {
            return Err(WeightsError::Run { found: self.run, expected: run });
        }
        let found = &self.sizes[..(self.n_sizes as usize).min(MAX_SIZES)];
        if found != sizes || payload.len() != into.len() {
            return Err(WeightsError::Sizes { found: found.to_vec(), expected: sizes.to_vec() });
        }
        into.copy_from_slice(payload);
        let computed = crc32c::crc32c(cast_slice(into));
        if computed != self.checksum {
            return Err(WeightsError::Checksum {
                version: self.version,
                found: computed,
                expected: self.checksum,
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flipped_bit_is_found() {
        let sizes = [1, 2];
        let mut weights = [0.5, -1.0, 2.0, 3.0];
        let header = WeightsHeader::new(9, 0, 4, &sizes, &weights);
        let mut into = [0.0; 4];
        assert_eq!(header.receive(9, &sizes, &weights, &mut into), Ok(()));
        assert_eq!(into, weights);
        assert!(matches!(header.receive(8, &sizes, &weights, &mut into), Err(WeightsError::Run { .. })));
        assert!(matches!(header.receive(9, &[2, 1], &weights, &mut into), Err(WeightsError::Sizes { .. })));
        assert!(matches!(
            header.receive(9, &sizes, &weights[1..], &mut into),
            Err(WeightsError::Sizes { .. })
        ));
        weights[2] = -2.0;
        assert!(matches!(header.receive(9, &sizes, &weights, &mut into), Err(WeightsError::Checksum { .. })));
    }
}
