//! `learner.conv`: the convolutions that a network begins with.

use super::setting::in_words;
use super::{ConfigError, Field, Value, refuse};
use crate::limits::{MAX_KERNEL, MAX_WIDTH};
use serde::{Deserialize, Serialize};

/// A convolution: a square kernel at every position where it fits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ConvLayer {
    /// Numbers that it gives at each position.
    pub channels: usize,
    /// Rows and columns of the kernel.
    pub kernel: usize,
    /// Rows and columns from one position to the next.
    #[serde(default = "one")]
    pub stride: usize,
}

fn one() -> usize {
    1
}

impl ConvLayer {
    /// Whether its numbers are in range; whether the kernel fits only the environment knows.
    pub fn in_range(&self) -> bool {
        let side = 1..=MAX_KERNEL;
        (1..=MAX_WIDTH).contains(&self.channels) && side.contains(&self.kernel) && side.contains(&self.stride)
    }
}

impl Field for Vec<ConvLayer> {
    fn kind() -> String {
        "list of tables".into()
    }

    fn accepted() -> String {
        format!(
            "tables {{ channels, kernel, stride }}: 1 to {MAX_WIDTH}, 1 to {MAX_KERNEL}, 1 to {MAX_KERNEL} (1 if left out)"
        )
    }

    fn read(value: Value, key: &str, accepted: &str) -> Result<Self, ConfigError> {
        value.clone().try_into().map_err(|_| refuse(key, in_words(&value), accepted))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn the_stride_may_be_left_out() {
        let read = |text: &str| {
            let table: toml::Table = format!("conv = {text}").parse().unwrap();
            Vec::<ConvLayer>::read(table["conv"].clone(), "learner.conv", "tables")
        };
        let layer = ConvLayer { channels: 16, kernel: 3, stride: 1 };
        assert_eq!(read("[{ channels = 16, kernel = 3 }]").unwrap(), [layer]);
        assert!(read("[]").unwrap().is_empty());
        assert!(layer.in_range() && !ConvLayer { kernel: 0, ..layer }.in_range());
        for bad in ["[{ channels = 16 }]", "[{ channels = 16, kernel = 3, padding = 1 }]", "3", "[-1]"] {
            assert!(read(bad).unwrap_err().to_string().contains("learner.conv"), "{bad}");
        }
    }
}
