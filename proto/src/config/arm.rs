//! What a run is called: its algorithm, and what it has that the paper's has not.

use super::{Algo, CombineKind, Config, DrawKind, GuideKind, SelectionRule};

impl Config {
    /// What guides exploration, if anything does: never `auto`. Actions are known only to algorithms that have a mentor.
    pub fn guide(&self) -> Option<GuideKind> {
        let e = &self.exploration;
        let guide = match e.guide {
            GuideKind::Auto if self.run.algo == Algo::Trestle => GuideKind::Learned,
            GuideKind::Auto => GuideKind::Known,
            chosen => chosen,
        };
        let acts = guide == GuideKind::Learned || self.run.algo.has_mentor();
        (acts && (e.guide_start > 0.0 || e.guide_end > 0.0)).then_some(guide)
    }

    /// Whether whole bridges guide exploration.
    pub fn whole_bridges(&self) -> bool {
        self.exploration.guide_whole && self.guide() == Some(GuideKind::Known)
    }

    /// Whether rewards are shaped.
    pub fn shaped(&self) -> bool {
        self.shaping.potential > 0.0
    }

    /// Whether a demonstration is needed, be it for a mentor-server or not.
    pub fn needs_demonstration(&self) -> bool {
        self.run.algo.has_mentor() || self.needs_waypoints()
    }

    /// Whether actors or learner need the mentor's states themselves.
    pub fn needs_waypoints(&self) -> bool {
        self.guide().is_some() || self.shaped() || self.rival.kind.needs_states()
    }

    /// The name of the algorithm in results: that of `run.algo`, with a suffix for each extension of ours that is
    /// switched on, so that none can be taken for the paper's.
    pub fn arm(&self) -> String {
        let (mentor, with) = (&self.mentor, self.run.algo.has_mentor());
        let learned = self.guide() == Some(GuideKind::Learned);
        let imitates = learned && self.mentor.learned.imitate > 0.0;
        let rule = SelectionRule::suffix(&mentor.selection);
        let suffixes = [
            (with, rule.as_str()),
            (with && mentor.combine == CombineKind::Beside, "+beside"),
            (with && mentor.draw == DrawKind::Uniform, "+uniform"),
            (with && mentor.one_sided, "+one-sided"),
            (self.guide() == Some(GuideKind::Known), "+guided"),
            (self.whole_bridges(), "+whole-bridges"),
            (learned && self.run.algo != Algo::Trestle, "+learned-bridges"),
            (imitates && self.run.algo != Algo::Trestle, "+imitation"),
            (imitates && mentor.learned.correct > 0.0 && self.run.algo != Algo::Trestle, "+correction"),
            (self.shaped(), "+shaped"),
        ];
        let on = suffixes.iter().filter(|(on, _)| *on).map(|(_, suffix)| *suffix);
        std::iter::once(self.run.algo.name()).chain(on).chain(self.rival.kind.suffix()).collect()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use crate::config::testing::{Two, with};
    use crate::config::{load, to_toml};

    fn arm(sets: &[&str]) -> String {
        with("maze30", sets).unwrap().arm()
    }

    #[test]
    fn extensions_are_named_where_they_act() {
        assert_eq!(arm(&["run.algo=diiqn", "mentor.selection=min-distance"]), "diiqn");
        let all = [
            "exploration.guide_start=0.5",
            "mentor.selection=always",
            "mentor.combine=beside",
            "mentor.draw=uniform",
            "mentor.one_sided=true",
        ];
        assert_eq!(arm(&all), "ha-diiqn+always+beside+uniform+one-sided+guided");
        assert_eq!(arm(&[&all[..], &["run.algo=dqn"]].concat()), "dqn");
        assert_eq!(arm(&["run.algo=dqn", "shaping.potential=2"]), "dqn+shaped");
        let learned = ["exploration.guide=learned", "exploration.guide_start=0.5"];
        assert_eq!(arm(&[&["run.algo=dqn"], &learned[..]].concat()), "dqn+learned-bridges");
        assert_eq!(arm(&["run.algo=dqn", learned[0]]), "dqn");
        let imitating = ["run.algo=ha-diiqn", "mentor.learned.imitate=1", learned[0], learned[1]];
        assert_eq!(arm(&imitating), "ha-diiqn+learned-bridges+imitation");
        let corrected = [&imitating[..], &["mentor.learned.correct=1"]].concat();
        assert_eq!(arm(&corrected), "ha-diiqn+learned-bridges+imitation+correction");
        assert_eq!(arm(&["run.algo=trestle"]), "trestle");
        let whole = ["run.algo=ha-diiqn", "exploration.guide_start=0.5", "exploration.guide_whole=true"];
        assert_eq!(arm(&whole), "ha-diiqn+guided+whole-bridges");
    }

    #[test]
    fn whole_bridges_need_bridges_and_a_guide_that_knows_them() {
        let refused = |sets: &[&str]| {
            let sets = [&["exploration.guide_whole=true", "exploration.guide_start=0.5"], sets].concat();
            with("maze30", &sets).unwrap_err().to_string()
        };
        for (sets, accepted) in [
            (&["run.algo=dqn"][..], "false with run.algo = dqn, which has no bridges"),
            (&["run.algo=diiqn"], "false with run.algo = diiqn, which has no bridges"),
            (&["run.algo=trestle"], "false with run.algo = trestle, which has no bridges"),
            (&["mentor.bridges=false"], "false with mentor.bridges = false"),
            (&["mentor.k=1"], "false with mentor.k = 1"),
            (&["exploration.guide_start=0"], "false without a guide; exploration.guide_start"),
            (&["exploration.guide=learned"], "false with exploration.guide = learned"),
        ] {
            let error = refused(&[&["run.algo=ha-diiqn"], sets].concat());
            assert!(error.starts_with("exploration.guide_whole = true; accepted: "), "{error}");
            assert!(error.contains(accepted), "{error}");
        }
    }

    #[test]
    fn a_stored_configuration_of_one_algorithm_serves_the_others() {
        let stored = to_toml(&with("maze30", &["run.algo=trestle"]).unwrap());
        let former = stored.replace("guide = \"auto\"", "guide = \"learned\"");
        assert_ne!(stored, former);
        for text in [&stored, &former] {
            let file = tempfile::NamedTempFile::new().unwrap();
            std::fs::write(file.path(), text).unwrap();
            let arm = |algo: &str| {
                load(&Two, file.path().to_str().unwrap(), &[format!("run.algo={algo}")]).unwrap().arm()
            };
            assert_eq!(["trestle", "dqn", "ha-diiqn"].map(arm), ["trestle", "dqn", "ha-diiqn+guided"]);
        }
    }
}
