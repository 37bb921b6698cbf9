//! A run as an experiment: all that decides what it computes. Two runs of one experiment in lockstep end with the same bits,
//! whatever happens to their processes.

use crate::acting::{Lengths, OptionRoom, Room, Rooms};
use crate::annotation::record_words;
use crate::batch::Spaces;
use crate::config::{Channels, Config, ConvLayer, EncodingKind, GuideKind, Mode};
use crate::limits::{MAX_OWN_NUMBERS, MAX_OWN_PLACES, TRANSITIONS_BUFFER};
use crate::space::{EnvSpec, Success, least};
use crate::waypoints::Waypoints;
use serde::{Deserialize, Serialize};

/// All that decides what a run computes, resolved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Experiment {
    /// The resolved configuration.
    pub config: Config,
    /// The environment's spaces.
    pub spec: EnvSpec,
    /// The demonstrations in the order of their transitions; none without a mentor.
    pub mentors: Vec<MentorPart>,
    /// The mentor's states, where actors or learner need them ([`Config::needs_waypoints`]).
    pub waypoints: Option<Waypoints>,
}

/// One of the demonstrations of a run. All of them together are the run's one list of mentor transitions.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MentorPart {
    /// Its name in metrics and reports.
    pub name: String,
    /// Its transitions, 1 or more.
    pub transitions: usize,
}

impl Experiment {
    /// Transitions of all demonstrations; 0 without a mentor.
    pub fn mentor_len(&self) -> usize {
        self.mentors.iter().map(|part| part.transitions).sum()
    }

    /// The lengths of what actors act with. There is a known action, or none, for each mentor transition where exploration is
    /// guided by them.
    pub fn acting(&self) -> Lengths {
        Lengths {
            weights: self.parameters(),
            known: if self.config.guide() == Some(GuideKind::Known) { self.mentor_len() } else { 0 },
            policy: self.policy_sizes().map_or(0, |sizes| parameters(&sizes)),
        }
    }

    /// Height, width and channels of the grid that the network's input is, and then of what each convolution gives; none without
    /// convolutions. Sizes of a grid that a kernel does not fit into mean nothing.
    pub fn grids(&self) -> Vec<[usize; 3]> {
        let learner = &self.config.learner;
        if learner.conv.is_empty() {
            return Vec::new();
        }
        let mut grid = match (&self.spec.shape[..], learner.conv_channels) {
            (&[height, width], _) => [height, width, 1],
            (&[height, width, channels], Channels::Last) | (&[channels, height, width], Channels::First) => {
                [height, width, channels]
            }
            _ => [0; 3],
        };
        let mut grids = vec![grid];
        for conv in &learner.conv {
            let places = |side: usize| side.saturating_sub(conv.kernel) / conv.stride.max(1) + 1;
            grid = [places(grid[0]), places(grid[1]), conv.channels];
            grids.push(grid);
        }
        grids
    }

    /// Parameters of the network, biases included.
    fn parameters(&self) -> usize {
        let (grids, sizes, convs) = (self.grids(), self.sizes(), &self.config.learner.conv);
        let of_conv = |(pair, conv): (&[[usize; 3]], &ConvLayer)| {
            (conv.kernel * conv.kernel * pair[0][2] + 1) * conv.channels
        };
        grids.windows(2).zip(convs).map(of_conv).sum::<usize>() + parameters(&sizes[convs.len()..])
    }

    /// Numbers of the network's input, of what each convolution and hidden layer gives, and of the output.
    pub fn sizes(&self) -> Vec<usize> {
        let input = match self.config.env.encoding {
            EncodingKind::Coordinates => self.mixed_sizes().iter().map(|&size| size.max(1)).sum(),
            EncodingKind::OneHot => self.one_hot_sizes().iter().sum(),
        };
        let hidden = self.config.learner.hidden.iter().copied();
        let planes = self.grids().into_iter().skip(1).map(|grid| grid.into_iter().product());
        std::iter::once(input).chain(planes).chain(hidden).chain([self.spec.n_actions()]).collect()
    }

    /// Steps of a bridge after its first one that are kept, at most; 0 unless whole bridges guide exploration.
    pub fn further(&self) -> usize {
        if self.config.whole_bridges() { self.config.mentor.k as usize - 1 } else { 0 }
    }

    /// Words of an annotation record.
    pub fn record_words(&self) -> usize {
        record_words(self.spec.obs_dim(), self.further())
    }

    /// How many options and own paths actors may get.
    pub fn rooms(&self) -> Rooms {
        Rooms { options: self.option_room(), own: self.own_room() }
    }

    /// How many options actors may get.
    fn option_room(&self) -> OptionRoom {
        match self.further() {
            0 => OptionRoom::default(),
            steps => OptionRoom {
                mentor: self.mentor_len(),
                steps,
                obs_dim: self.spec.obs_dim(),
                n_actions: self.spec.n_actions(),
            },
        }
    }

    /// How many own paths actors may get.
    pub fn own_room(&self) -> Room {
        let learned = &self.config.mentor.learned;
        let (dim, paths) = (learned.features.len(), learned.own_paths);
        if self.config.guide() != Some(GuideKind::Learned) || dim * paths == 0 {
            return Room::default();
        }
        Room { dim, paths, places: (MAX_OWN_NUMBERS / (dim * paths)).min(MAX_OWN_PLACES) }
    }

    /// Units of the input, the hidden layers and the output of the policy π of learned bridges: it sees a state as the
    /// Q-network does, and the way to a goal, of which a category has a number for each of its values. None without learned bridges.
    pub fn policy_sizes(&self) -> Option<Vec<usize>> {
        if self.config.guide() != Some(GuideKind::Learned) {
            return None;
        }
        let (network, learned) = (self.sizes(), &self.config.mentor.learned);
        let sizes = self.mixed_sizes();
        let way = learned.features.iter().map(|&feature| sizes.get(feature).map_or(1, |&size| size.max(1)));
        let input = network[0] + way.sum::<usize>();
        let hidden = learned.hidden.iter().copied();
        Some(std::iter::once(input).chain(hidden).chain([self.spec.n_actions()]).collect())
    }

    /// Number of values of each feature, for the one-hot encoding of whole-numbered features.
    pub fn one_hot_sizes(&self) -> Vec<usize> {
        self.spec.low.iter().zip(&self.spec.high).map(|(low, high)| (high - low) as usize + 1).collect()
    }

    /// Number of values of each feature that is a category, and 0 for each of the others.
    pub fn mixed_sizes(&self) -> Vec<usize> {
        let mut sizes = vec![0; self.spec.obs_dim()];
        let all = self.one_hot_sizes();
        self.spec.categories.iter().for_each(|&feature| sizes[feature] = all[feature]);
        sizes
    }

    /// What the run's transitions can be.
    pub fn spaces(&self) -> Spaces {
        let (actors, spec) = (self.config.run.actors, &self.spec);
        Spaces { actors, row: spec.row(), n_actions: spec.n_actions() }
    }

    /// Environment steps of a tick in lockstep.
    pub fn steps_per_tick(&self) -> u64 {
        u64::from(self.config.run.actors) * u64::from(self.config.run.rollout)
    }

    /// Batches of an actor that may be on their way, 1 to 64: in lockstep one, the tick's.
    pub fn window(&self) -> u64 {
        if self.config.run.mode != Mode::Free {
            return 1;
        }
        let ahead = match self.config.run.ahead {
            0 => 2 * self.steps_per_tick(),
            ahead => ahead,
        };
        (ahead / self.steps_per_tick()).clamp(1, TRANSITIONS_BUFFER as u64)
    }

    /// Return from which on an evaluation counts as optimal, if one is known.
    pub fn threshold(&self) -> Option<f64> {
        self.config.eval.threshold.or(self.spec.threshold).or(self.spec.best_return)
    }

    /// What counts as the success of an episode: what the environment says, or else a return that counts as solved.
    pub fn success(&self) -> Success {
        match self.threshold() {
            _ if self.spec.defines_success => Success::Said,
            Some(threshold) => Success::Return(least(threshold, self.config.eval.tolerance)),
            None => Success::Undefined,
        }
    }
}

/// Parameters of a fully connected network whose layers have these `sizes`, biases included.
fn parameters(sizes: &[usize]) -> usize {
    sizes.windows(2).map(|w| w[0] * w[1] + w[1]).sum()
}
