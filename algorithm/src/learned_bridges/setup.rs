//! From an experiment to the parts of learned bridges, and from settings that are automatic to numbers.

use super::correction::{Correction, CorrectionConfig};
use super::goal::{Goal, scales};
use super::hindsight::{Hindsight, HindsightConfig};
use super::imitation::{Imitation, ImitationConfig};
use super::own::OwnPaths;
use super::path::{Path, Paths, stride};
use crate::demonstration::Demonstration;
use crate::similarity::metric::APART;
use trestle_proto::NONE;
use trestle_proto::config::{self, GuideKind};
use trestle_proto::experiment::Experiment;
use trestle_proto::rng::{Purpose, stream};
use trestle_proto::space::EnvSpec;
use trestle_qnet::{AdamConfig, Layout, PlanError, init, kernels_of, network_of};

/// The radius where it is automatic, in units of the environment's scales: the neighbours of a cell, and those across its
/// corners. A mentor with longer steps does not widen it, so that no wall comes to lie within it.
const RADIUS: f64 = 1.5;
/// The window where it is automatic, in strides.
const WINDOW: f64 = 8.0;
/// The lookahead, likewise.
const LOOKAHEAD: f64 = 3.0;

/// Settings of learned bridges that make no sense with this environment and demonstration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LearnedError {
    /// Features that the environment does not have, or none.
    #[error(
        "mentor.learned.features = {found:?}; accepted for {env}: one or more of 0 to {last}, each once, in ascending order"
    )]
    Features {
        /// The features.
        found: Vec<usize>,
        /// Name of the environment.
        env: String,
        /// Its last feature.
        last: usize,
    },
    /// A mentor that stays where it is.
    #[error(
        "mentor.learned: no step of the demonstration changes the features {features:?}; accepted: other features, or a mentor \
         that moves"
    )]
    Still {
        /// The features.
        features: Vec<usize>,
    },
}

/// Puts numbers in the place of automatic features and lengths.
///
/// # Errors
/// Features that are not the environment's, or in which the mentor stays where it is.
pub fn resolve(
    settings: &mut config::Mentor,
    spec: &EnvSpec,
    mentor: &Demonstration,
) -> Result<(), LearnedError> {
    let dim = spec.obs_dim();
    let scale = scales(settings, spec).into_owned();
    let learned = &mut settings.learned;
    if learned.features.is_empty() {
        learned.features = automatic(settings.features.numbers().unwrap_or_default(), spec);
    }
    // A search ends with the first own path.
    if !spec.defines_success || learned.own_paths == 0 {
        learned.search = 0.0;
    }
    // Without inertia the observer comes back to the very states of its own paths, where it knows better than π.
    if spec.velocities.is_empty() || learned.imitate == 0.0 {
        learned.correct = 0.0;
    }
    let features = &learned.features;
    let ascending = features.is_sorted_by(|a, b| a < b);
    if !ascending || features.last().is_none_or(|&last| last >= dim) {
        let (found, env) = (features.clone(), spec.name.clone());
        return Err(LearnedError::Features { found, env, last: dim - 1 });
    }
    let median = median_step(features, &scale, spec, mentor)
        .ok_or_else(|| LearnedError::Still { features: features.clone() })?;
    // A slow mentor must not make the goals so near that any step passes them.
    let stride = median.max(1.0);
    let automatic = [
        (&mut learned.radius, RADIUS),
        (&mut learned.window, WINDOW * stride),
        (&mut learned.lookahead, LOOKAHEAD * stride),
    ];
    for (length, automatic) in automatic {
        if *length == 0.0 {
            *length = automatic;
        }
    }
    Ok(())
}

/// The features of goals where nobody chooses them: those in which states are compared, or else all that are neither velocities nor
/// categories, or else all that are no velocities.
fn automatic(compared: &[usize], spec: &EnvSpec) -> Vec<usize> {
    let (all, is_velocity) = (0..spec.obs_dim(), |feature: &usize| spec.velocities.contains(feature));
    let mut features: Vec<usize> = compared.to_vec();
    features.sort_unstable();
    if features.is_empty() {
        let counts = |feature: &usize| !is_velocity(feature) && !spec.categories.contains(feature);
        features = all.clone().filter(counts).collect();
    }
    if features.is_empty() {
        features = all.filter(|feature| !is_velocity(feature)).collect();
    }
    features
}

/// The median length of the mentor's steps, without those that lead nowhere; none without any other.
fn median_step(features: &[usize], scale: &[f32], spec: &EnvSpec, mentor: &Demonstration) -> Option<f64> {
    let number = |state: &[f32], f: usize| match spec.categories.contains(&f) {
        true => state[f] * APART,
        false => state[f] / scale[f],
    };
    let place = |m: usize| -> Vec<f32> { features.iter().map(|&f| number(mentor.state(m), f)).collect() };
    let mut steps: Vec<f32> = Vec::with_capacity(mentor.n_transitions());
    for i in 0..mentor.n_trajectories() {
        let states = mentor.trajectory(i);
        let lengths = states.clone().zip(states.skip(1)).map(|(m, next)| stride(&place(m), &place(next)));
        steps.extend(lengths.filter(|&length| length > 0.0));
    }
    steps.sort_unstable_by(f32::total_cmp);
    steps.get(steps.len() / 2).map(|&length| f64::from(length))
}

/// What π sees in `experiment`'s run, and its network; none without learned bridges.
///
/// # Errors
/// Settings that give no network.
pub fn policy_of(experiment: &Experiment) -> Result<Option<(Goal, Layout)>, PlanError> {
    let Some(sizes) = experiment.policy_sizes() else { return Ok(None) };
    let (_, encoding) = network_of(experiment)?;
    let (mentor, spec) = (&experiment.config.mentor, &experiment.spec);
    let goal = Goal::new(encoding, &mentor.learned.features, &scales(mentor, spec));
    let goal = goal.with_categories(spec, &experiment.one_hot_sizes());
    Ok(Some((goal, Layout::new(&sizes)?)))
}

/// The mentor's path in `experiment`'s run; none without learned bridges.
pub fn path_of(experiment: &Experiment, goal: &Goal) -> Option<Path> {
    let waypoints =
        experiment.waypoints.as_ref().filter(|_| experiment.config.guide() == Some(GuideKind::Learned))?;
    let radius = experiment.config.mentor.learned.radius as f32;
    Some(Path::of_mentor(waypoints, experiment.spec.obs_dim(), goal, radius))
}

/// The paths along which a tracker goes in `experiment`'s run, to begin with the mentor's alone; none without learned bridges.
pub fn paths_of(experiment: &Experiment, goal: &Goal) -> Option<Paths> {
    Some(Paths::new(path_of(experiment, goal)?, goal.dim(), experiment.config.mentor.learned.radius as f32))
}

/// What keeps own paths in `experiment`'s run, none yet; nothing without learned bridges, or with `own_paths = 0`.
///
/// # Errors
/// Settings that give no network.
pub fn own_of(experiment: &Experiment) -> Result<Option<OwnPaths>, PlanError> {
    let room = experiment.own_room();
    let Some((goal, _)) = policy_of(experiment)?.filter(|_| room.paths > 0) else { return Ok(None) };
    let ends = experiment.waypoints.iter().flat_map(|waypoints| {
        let states = waypoints.states.chunks_exact(experiment.spec.obs_dim()).zip(&waypoints.transition_of);
        states.filter(|(_, transition)| **transition == NONE).map(|(state, _)| state)
    });
    Ok(Some(OwnPaths::new(goal, room, experiment.config.mentor.learned.radius as f32, ends)))
}

/// All that learns π in `experiment`'s run, with the initial weights of the experiment's seed; none without learned bridges.
///
/// # Errors
/// Settings that give no network.
pub fn hindsight_of(experiment: &Experiment) -> Result<Option<Hindsight>, PlanError> {
    let Some((goal, layout)) = policy_of(experiment)? else { return Ok(None) };
    let (seed, learned) = (experiment.config.run.seed, &experiment.config.mentor.learned);
    let params = init(&layout, &mut stream(seed, Purpose::PolicyWeights, 0));
    let config = HindsightConfig {
        batch: learned.batch,
        horizon: learned.horizon,
        adam: AdamConfig { lr: learned.lr, ..AdamConfig::default() },
    };
    let rng = stream(seed, Purpose::PolicyReplay, 0);
    Ok(Some(Hindsight::new(goal, layout, params, config, rng, kernels_of(experiment)?)))
}

/// What imitates own paths in `experiment`'s run, if anything does.
///
/// # Errors
/// Settings that give no network.
pub fn imitation_of(experiment: &Experiment) -> Result<Option<Imitation>, PlanError> {
    let learned = &experiment.config.mentor.learned;
    if experiment.own_room().paths == 0 || learned.imitate == 0.0 {
        return Ok(None);
    }
    let (layout, _) = network_of(experiment)?;
    let config = ImitationConfig {
        weight: learned.imitate as f32,
        margin: learned.margin as f32,
        batch: experiment.config.learner.batch,
    };
    let (rng, kernels) = (stream(experiment.config.run.seed, Purpose::Imitation, 0), kernels_of(experiment)?);
    let corrected = policy_of(experiment)?.filter(|_| learned.correct > 0.0);
    let correction = corrected.map(|(goal, layout)| {
        let correct = CorrectionConfig {
            weight: learned.correct as f32,
            radius: learned.radius as f32,
            lookahead: learned.lookahead as f32,
            horizon: learned.horizon,
        };
        Correction::new(goal, layout, correct, config.batch, kernels)
    });
    Ok(Some(Imitation::new(layout, config, correction, rng, kernels)))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use trestle_proto::config::Learned;
    use trestle_proto::row::Element;

    /// States of a position, in units of 2, and its velocity.
    fn spec() -> EnvSpec {
        EnvSpec {
            name: "line".into(),
            element: Element::F32,
            shape: Vec::new(),
            low: vec![-99.0; 2],
            high: vec![99.0; 2],
            scale: vec![2.0, 1.0],
            integral: false,
            velocities: vec![1],
            actions: vec!["a".into(), "b".into()],
            best_return: None,
            goal_bonus: 0.0,
            defines_success: true,
            categories: Vec::new(),
            threshold: None,
        }
    }

    fn mentor(trajectories: &[&[f32]]) -> Demonstration {
        let mut mentor = Demonstration::new(vec!["x".into(), "v".into()]).unwrap();
        for positions in trajectories {
            let states: Vec<f32> = positions.iter().flat_map(|&x| [x, 7.0 * x]).collect();
            mentor.push_trajectory(&states, true).unwrap();
        }
        mentor
    }

    fn resolved(learned: Learned, mentor: &Demonstration) -> Result<Learned, LearnedError> {
        let mut settings = config::Mentor { learned, ..config::Mentor::default() };
        resolve(&mut settings, &spec(), mentor).map(|()| settings.learned)
    }

    #[test]
    fn features_and_scale_are_those_in_which_states_are_compared() {
        let mut settings = config::Mentor {
            features: config::Features::Numbers(vec![1, 0]),
            scale: vec![1.0, 7.0],
            ..config::Mentor::default()
        };
        // Both in units of 1.
        resolve(&mut settings, &spec(), &mentor(&[&[0.0, 6.0]])).unwrap();
        assert_eq!(settings.learned.features, [0, 1]);
        assert_eq!(settings.learned.lookahead, 3.0 * f64::from(72f32.sqrt()));
        // A change of a category is as long as a unit.
        let categories = |all: &[usize]| {
            let spec = EnvSpec { categories: all.to_vec(), velocities: Vec::new(), ..spec() };
            let mut settings = config::Mentor::default();
            resolve(&mut settings, &spec, &mentor(&[&[0.0, 6.0]])).unwrap();
            (settings.learned.features, settings.learned.lookahead)
        };
        assert_eq!(categories(&[0]), (vec![1], 126.0));
        assert_eq!(categories(&[0, 1]), (vec![0, 1], 3.0 * f64::from(2f32.sqrt())));
    }

    #[test]
    fn automatic_lengths_follow_the_mentor_unless_it_is_slow() {
        // Steps of 3, 4 and 5 units and one that leads nowhere; the way between trajectories is none.
        let fast = resolved(Learned::default(), &mentor(&[&[0.0, 6.0, 6.0, 14.0], &[90.0, 80.0]])).unwrap();
        assert_eq!(fast.features, [0]);
        assert_eq!((fast.radius, fast.window, fast.lookahead), (1.5, 32.0, 12.0));
        let slow = resolved(Learned::default(), &mentor(&[&[0.0, 0.5, 1.0]])).unwrap();
        assert_eq!((slow.radius, slow.window, slow.lookahead), (1.5, 8.0, 3.0));
        let given = Learned { radius: 0.25, features: vec![0, 1], ..Learned::default() };
        let kept = resolved(given, &mentor(&[&[0.0, 6.0]])).unwrap();
        assert_eq!((kept.radius, kept.features), (0.25, vec![0, 1]));
        assert!(kept.lookahead > 100.0, "the velocity counts as well");
    }

    #[test]
    fn without_successes_or_own_paths_none_is_looked_for() {
        for (defines_success, own_paths, search) in [(true, 1, 0.5), (false, 1, 0.0), (true, 0, 0.0)] {
            let learned = Learned { own_paths, ..Learned::default() };
            let mut settings = config::Mentor { learned, ..config::Mentor::default() };
            let spec = EnvSpec { defines_success, ..spec() };
            resolve(&mut settings, &spec, &mentor(&[&[0.0, 6.0]])).unwrap();
            assert_eq!(settings.learned.search, search);
        }
    }

    #[test]
    fn the_guide_corrects_only_where_states_have_velocities_and_own_paths_are_imitated() {
        for (velocities, imitate, correct) in [(vec![1], 1.0, 0.7), (vec![], 1.0, 0.0), (vec![1], 0.0, 0.0)] {
            let learned = Learned { imitate, correct: 0.7, ..Learned::default() };
            let mut settings = config::Mentor { learned, ..config::Mentor::default() };
            let spec = EnvSpec { velocities, ..spec() };
            resolve(&mut settings, &spec, &mentor(&[&[0.0, 6.0]])).unwrap();
            assert_eq!(settings.learned.correct, correct);
        }
    }

    #[test]
    fn what_makes_no_sense_is_refused_by_name() {
        let still = resolved(Learned::default(), &mentor(&[&[3.0, 3.0]])).unwrap_err().to_string();
        assert!(still.contains("no step of the demonstration changes the features [0]"), "{still}");
        for features in [vec![2], vec![1, 0], vec![0, 0]] {
            let learned = Learned { features, ..Learned::default() };
            let error = resolved(learned.clone(), &mentor(&[&[0.0, 6.0]])).unwrap_err();
            assert!(error.to_string().contains("accepted for line: one or more of 0 to 1"), "{error}");
            assert_eq!(
                error,
                LearnedError::Features { found: learned.features, env: "line".into(), last: 1 }
            );
        }
    }
}
