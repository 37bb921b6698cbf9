//! `[run]`: what is run, how long, and over how many processes.

use super::accepts::{any, at_least, between};
use crate::limits::{MAX_ACTORS, MAX_ROLLOUT};
use crate::{choices, settings};

settings! {
    /// `[run]`
    pub struct Run {
        /// The algorithm.
        algo: Algo = Algo::HaDiiqn;
        /// Seed of every random stream.
        seed: u64 = 0, between(0, i64::MAX as u64).in_words("0 to 2^63 - 1");
        /// The run ends with this many finished episodes, or with `env_steps`, whichever comes first. At least one of the two
        /// must be given.
        episodes: Option<u64> = None, at_least(1);
        /// The run ends with this many environment steps of all actors together.
        env_steps: Option<u64> = None, at_least(1);
        /// Whether the run also ends when it is solved, a tick after the third passing evaluation.
        stop_when_solved: bool = false;
        /// How the processes work together.
        mode: Mode = Mode::Lockstep;
        /// Actor processes.
        actors: u32 = 1, between(1, MAX_ACTORS);
        /// Environment steps of each actor in a tick.
        rollout: u32 = 32, between(1, MAX_ROLLOUT);
        /// 0: actors wait for the newest weights. 1: they collect with the weights of one tick earlier, while the learner
        /// trains. Only 0 with `mode = "free"`.
        lag: u32 = 0, between(0, 1).in_words("0 or 1");
        /// With `mode = "free"`: environment steps that all actors together may be ahead of what has been learnt from. 0: twice
        /// `actors` times `rollout`.
        ahead: u64 = 0, any("0, or 1 to 64 times `actors` times `rollout`");
        /// Instruction set of the network's kernels. All give the same bits.
        isa: IsaKind = IsaKind::Auto;
    }
}

choices! {
    /// The algorithms.
    pub enum Algo {
        /// Deep Q-network, no mentor (Mnih et al. 2015).
        Dqn = "dqn",
        /// Deep implicit imitation Q-network: every mentor transition counts as feasible.
        Diiqn = "diiqn",
        /// Heterogeneous-action DIIQN: feasibility and bridges.
        HaDiiqn = "ha-diiqn",
        /// Ours: double DQN that explores along the mentor's path by learned bridges.
        Trestle = "trestle",
    }
}

impl Algo {
    /// Whether it learns from annotations of a mentor's transitions, and so needs a mentor-server.
    pub fn has_mentor(self) -> bool {
        matches!(self, Self::Diiqn | Self::HaDiiqn)
    }
}

choices! {
    /// How the processes of a run work together.
    pub enum Mode {
        /// Tick by tick: the result depends on the configuration alone.
        Lockstep = "lockstep",
        /// Every actor streams, and only a process that dies is replaced; the result depends on the timing, too.
        Free = "free",
        /// The same algorithm in one process, to compare with.
        Reference = "reference",
    }
}

choices! {
    /// Instruction sets of the network's kernels.
    pub enum IsaKind {
        /// The fastest one that the machine has.
        Auto = "auto",
        /// x86-64 with AVX-512F.
        Avx512 = "avx512",
        /// x86-64 with AVX2 and FMA.
        Avx2 = "avx2",
        /// Portable code.
        Scalar = "scalar",
    }
}
