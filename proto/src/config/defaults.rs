//! What an algorithm brings along: defaults of its own, which lie below every preset and file.

use super::Algo;

impl Algo {
    /// Settings as TOML whose defaults are others with this algorithm.
    pub(super) fn defaults(self) -> &'static str {
        match self {
            Self::Dqn | Self::Diiqn | Self::HaDiiqn => "",
            Self::Trestle => TRESTLE,
        }
    }
}

const TRESTLE: &str = r#"
[exploration]
guide_start = 0.9
guide_end = 0.0
# The guide goes with ε.
guide_decay_steps = 0

[mentor.learned]
imitate = 1.0
correct = 1.0
"#;

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use crate::config::testing::with;
    use crate::config::{GuideKind, from_table};

    #[test]
    fn an_algorithm_brings_its_defaults_along_and_every_layer_wins_over_them() {
        let exploration = |sets: &[&str]| with("maze30-tuned", sets).unwrap().exploration;
        let plain = exploration(&[]);
        let own = exploration(&["run.algo=trestle"]);
        assert_eq!((plain.guide, own.guide), (GuideKind::Auto, GuideKind::Auto));
        assert_eq!((own.guide_start, own.guide_decay_steps), (0.9, 0));
        // Whatever the order.
        assert_eq!(exploration(&["exploration.guide_start=0.5", "run.algo=trestle"]).guide_start, 0.5);
        let text = "[run]\nalgo = \"trestle\"\nepisodes = 9\n[exploration]\nguide_decay_steps = 7\n";
        let file = from_table(&(), text.parse().unwrap(), &[]).unwrap().exploration;
        assert_eq!((file.guide_start, file.guide_decay_steps), (0.9, 7));
    }

    #[test]
    fn trestle_without_its_guide_is_refused() {
        let refused = |set| with("maze30", &["run.algo=trestle", set]).unwrap_err().to_string();
        let guide = refused("exploration.guide=known");
        assert_eq!(guide, "exploration.guide = known; accepted: auto or learned with run.algo = trestle");
        assert!(
            refused("exploration.guide_start=0")
                .starts_with("exploration.guide_start = 0; accepted: above 0")
        );
    }
}
