//! The mentor-server as a whole: its answers, its refusals, and that one can take over from another.

#![allow(clippy::unwrap_used)]

use super::*;
use crate::similarity::testing::cases;
use proptest::prelude::*;
use trestle_proto::annotation::{Further, record_words};
use trestle_proto::batch::{Batch, BatchHeader, FIRST, Spaces, TERMINATED, TRUNCATED};
use trestle_proto::config::{InferenceKind, MetricKind, Threshold};
use trestle_proto::row::Element;

/// A transition of the tests: actor, s, s', action, reward, flags.
type Step = (u32, [f32; 2], [f32; 2], u32, f32, u32);

fn spec() -> EnvSpec {
    EnvSpec {
        name: "grid".into(),
        element: Element::F32,
        shape: Vec::new(),
        low: vec![0.0; 2],
        high: vec![9.0; 2],
        scale: vec![1.0; 2],
        integral: false,
        categories: Vec::new(),
        velocities: Vec::new(),
        actions: ["E", "N", "W", "S"].map(String::from).to_vec(),
        best_return: None,
        threshold: None,
        goal_bonus: 0.0,
        defines_success: true,
    }
}

fn demo(paths: &[&[[f32; 2]]]) -> Demonstration {
    let mut demo = Demonstration::new(vec!["x".into(), "y".into()]).unwrap();
    paths.iter().for_each(|path| demo.push_trajectory(&path.concat(), true).unwrap());
    demo
}

fn batch(actor: u32, steps: &[Step]) -> Checked<Batch> {
    let mut batch = Batch::default();
    batch.prepare(BatchHeader { actor, count: steps.len() as u32, obs_dim: 2, ..BatchHeader::default() });
    for (i, (_, obs, next_obs, action, reward, flags)) in steps.iter().enumerate() {
        batch.set(i, &Transition { obs, next_obs, action: *action, reward: *reward, flags: *flags });
    }
    batch.check(&Spaces { actors: 64, row: 2.into(), n_actions: 4 }).unwrap()
}

/// A mentor that went diagonally, from (0, 0) to (2, 2), which no action of the observer does.
fn diagonal(config: &config::Mentor, algo: Algo, replay: usize) -> Mentor {
    let demo = demo(&[&[[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]]);
    Mentor::new(&demo, config, algo, &spec(), replay, 7).unwrap()
}

/// East, then north: to (1, 1) in two steps.
const CORNER: [Step; 2] =
    [(0, [0.0, 0.0], [1.0, 0.0], 0, -1.0, FIRST), (0, [1.0, 0.0], [1.0, 1.0], 1, -2.0, 0)];

#[test]
fn an_infeasible_step_is_bridged() {
    let mut mentor = diagonal(&config::Mentor::default(), Algo::HaDiiqn, 10);
    let mut out = Observed::default();
    mentor.observe(50, batch(0, &CORNER).transitions(), &mut out).unwrap();
    assert_eq!(out.mentor, [0, NONE]);
    assert_eq!(out.changed.len(), record_words(2, 0));
    let estimate = mentor.table().estimate(0).unwrap();
    // North from (1, 0) is as near as east from (0, 0), ½ both, but begins elsewhere.
    assert_eq!((estimate.action, estimate.e_kl, estimate.reward), (0, 0.5, -1.0));
    assert_eq!((estimate.start_kl, mentor.table().estimate(1)), (0.0, None));
    let bridge = mentor.table().bridge(0).unwrap();
    assert_eq!((bridge.action, bridge.length, bridge.reward, bridge.end_kl), (0, 2, -1.0, 0.0));
    assert_eq!((bridge.next_obs, bridge.terminated), (&[1.0, 0.0][..], false));
    assert_eq!(mentor.table().bridge(1), None);
    let stats = mentor.stats();
    assert_eq!((stats.mentor, stats.feasible, stats.bridged, stats.stored), (2, 0, 1, 2));
    assert_eq!((stats.bridge_len_mean, stats.e_kl_mean), (2.0, 0.5));
    // The same again says nothing new.
    let again = CORNER.map(|s| (s.0, s.1, s.2, s.3, s.4, 0));
    mentor.observe(52, batch(1, &again).transitions(), &mut out).unwrap();
    assert_eq!((out.mentor.as_slice(), out.changed.len()), (&[0, NONE][..], 0));
}

#[test]
fn a_whole_bridge_is_kept_where_that_is_asked_for() {
    let mut mentor = diagonal(&config::Mentor::default(), Algo::HaDiiqn, 10).keeping_whole_bridges();
    let mut out = Observed::default();
    mentor.observe(0, batch(0, &CORNER).transitions(), &mut out).unwrap();
    assert_eq!(out.changed.len(), record_words(2, 3));
    assert_eq!(mentor.table().further(0), Some(Further { actions: &[1], states: &[1.0, 0.0] }));
    assert_eq!(mentor.table().further(1), None);
}

#[test]
fn bridges_are_looked_for_only_where_they_are_wanted() {
    let off = config::Mentor { bridges: false, ..config::Mentor::default() };
    let lenient = config::Mentor { e_infeas: Threshold::Kl(0.6), ..config::Mentor::default() };
    let defaults = config::Mentor::default();
    for (config, algo) in [(&off, Algo::HaDiiqn), (&lenient, Algo::HaDiiqn), (&defaults, Algo::Diiqn)] {
        let mut mentor = diagonal(config, algo, 10);
        mentor.observe(0, batch(0, &CORNER).transitions(), &mut Observed::default()).unwrap();
        assert!(mentor.table().estimate(0).is_some());
        assert_eq!(mentor.table().bridge(0), None);
    }
}

#[test]
fn a_bridge_outlives_its_transitions() {
    let mut mentor = diagonal(&config::Mentor::default(), Algo::HaDiiqn, 2);
    let mut out = Observed::default();
    mentor.observe(0, batch(0, &CORNER).transitions(), &mut out).unwrap();
    let elsewhere: Vec<Step> =
        (0..9).map(|i| (0, [9.0, i as f32], [9.0, i as f32 + 1.0], 1, 0.0, 0)).collect();
    mentor.observe(2, batch(0, &elsewhere).transitions(), &mut out).unwrap();
    assert_eq!(mentor.stats().stored, 2);
    assert_eq!(mentor.table().bridge(0).unwrap().length, 2);
}

#[test]
fn refusals_take_nothing_in() {
    let mut mentor = diagonal(&config::Mentor::default(), Algo::HaDiiqn, 10);
    let mut out = Observed::default();
    mentor.observe(3, batch(0, &CORNER).transitions(), &mut out).unwrap();
    let fits = batch(0, &CORNER);
    let mut refused = |first| {
        let error = mentor.observe(first, fits.transitions(), &mut out).unwrap_err();
        assert_eq!(mentor.rebuild(first, fits.transitions()).unwrap_err().to_string(), error.to_string());
        assert_eq!((mentor.stats().stored, mentor.history.expected()), (2, Some(5)));
        (error.status(), error.to_string())
    };
    let (status, text) = refused(6);
    assert_eq!(
        (status, text.as_str()),
        (OUT_OF_ORDER, "transitions begin with number 6 of the history; accepted: 5, where it ends")
    );
    assert_eq!(refused(4).0, OUT_OF_ORDER);
}

#[test]
fn settings_and_demonstrations_are_checked() {
    let new = |demo: &Demonstration, edit: fn(&mut config::Mentor), replay| {
        let mut config = config::Mentor::default();
        edit(&mut config);
        Mentor::new(demo, &config, Algo::HaDiiqn, &spec(), replay, 0).unwrap_err().to_string()
    };
    let sound = demo(&[&[[0.0, 0.0], [1.0, 1.0]]]);
    assert_eq!(new(&sound, |c| c.k = 65, 10), "mentor.k = 65; accepted: 1 to 64");
    assert_eq!(new(&sound, |c| c.n = 0, 10), "mentor.n = 0; accepted: 1 to 64");
    assert_eq!(
        new(&sound, |c| c.e_th = Threshold::Kl(f64::NAN), 10),
        "mentor.e_th = NaN; accepted: a number above 0"
    );
    assert_eq!(
        new(&sound, |c| c.e_infeas = Threshold::Auto, 10),
        "mentor.e_infeas = auto; accepted: a number above 0"
    );
    assert!(new(&sound, |_| (), 0).starts_with("learner.replay = 0"));
    assert!(new(&demo(&[]), |_| (), 10).contains("no transition"));
    let mut narrow = Demonstration::new(vec!["x".into()]).unwrap();
    narrow.push_trajectory(&[0.0, 1.0], false).unwrap();
    assert!(new(&narrow, |_| (), 10).contains("1 features; accepted: 2, as"));
}

#[test]
fn queries_answer_and_refuse() {
    let path = [[0.0, 0.0], [0.25, 0.0], [1.0, 1.0], [0.0, 0.25], [5.0, 5.0]];
    let config = config::Mentor { n: 2, ..config::Mentor::default() };
    let mut mentor = Mentor::new(&demo(&[&path]), &config, Algo::HaDiiqn, &spec(), 10, 7).unwrap();
    mentor.observe(0, batch(0, &CORNER).transitions(), &mut Observed::default()).unwrap();
    assert_eq!(mentor.similar(&[0.0, 0.125], 9).unwrap(), [(0, 0.0078125), (3, 0.0078125), (1, 0.0390625)]);
    assert_eq!(mentor.similar(&[0.0, 0.125], 1).unwrap(), [(0, 0.0078125)]);
    assert_eq!(mentor.similar(&[8.0, 8.0], 9).unwrap(), []);
    assert!(mentor.similar(&[0.0], 9).unwrap_err().to_string().contains("features is 1; accepted: 2"));
    assert!(mentor.similar(&[0.0, f32::NAN], 9).is_err());
    let mut words = Vec::new();
    mentor.bridge(&[0.0, 0.0], 0, &mut words).unwrap();
    assert_eq!(words.len(), record_words(2, 0));
    mentor.bridge(&[3.0, 0.0], 0, &mut words).unwrap();
    mentor.bridge(&[1.0, 1.0], 2, &mut words).unwrap();
    assert_eq!(words.len(), record_words(2, 0));
    assert_eq!(mentor.bridge(&[0.0, 0.0], 4, &mut words).unwrap_err().status(), OUT_OF_RANGE);
    let mut all = Vec::new();
    mentor.annotations(0, 4, &mut all).unwrap();
    assert_eq!(all[..record_words(2, 0)], words);
    for (first, count) in [(0, 5), (4, 1), (u32::MAX, 1), (1, u32::MAX)] {
        assert_eq!(mentor.annotations(first, count, &mut all).unwrap_err().status(), OUT_OF_RANGE);
        assert_eq!(mentor.transitions(first, count, &mut all).unwrap_err().status(), OUT_OF_RANGE);
    }
    let (mut sent, mut got) = (Vec::new(), MentorTransitions::new(2));
    mentor.transitions(0, 1, &mut sent).unwrap();
    mentor.transitions(1, 3, &mut sent).unwrap();
    got.decode(&sent).unwrap();
    assert_eq!(&got, mentor.mentor_transitions());
}

#[test]
fn draws_are_even_and_depend_on_the_position_alone() {
    let demo = demo(&[&[[0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [5.0, 5.0]]]);
    let mut mentor = Mentor::new(&demo, &config::Mentor::default(), Algo::HaDiiqn, &spec(), 10, 1).unwrap();
    let stay: Vec<Step> = vec![(0, [0.0; 2], [0.0; 2], 0, 0.0, 0); 3000];
    let mut out = Observed::default();
    mentor.observe(0, batch(0, &stay).transitions(), &mut out).unwrap();
    let counts = [0, 1, 2].map(|j| out.mentor.iter().filter(|&&m| m == j).count());
    // Standard deviation 26: six of them either way.
    assert!(counts.iter().all(|c| (845..=1155).contains(c)), "{counts:?}");
    let drawn = out.mentor.clone();
    let mut late = Mentor::new(&demo, &config::Mentor::default(), Algo::Diiqn, &spec(), 10, 1).unwrap();
    late.observe(2000, batch(3, &stay[2000..]).transitions(), &mut out).unwrap();
    assert_eq!(out.mentor, drawn[2000..]);
}

#[derive(Clone, Debug)]
struct Run {
    config: config::Mentor,
    algo: Algo,
    replay: usize,
    /// Most states and links that a bridge search looks at.
    limit: usize,
    /// Whether bridges are kept from beginning to end.
    whole: bool,
    paths: Vec<Vec<[f32; 2]>>,
    steps: Vec<Step>,
    cut: prop::sample::Index,
}

fn runs() -> impl Strategy<Value = Run> {
    let point = || (0i8..12, 0i8..12).prop_map(|(x, y)| [f32::from(x) / 3.0, f32::from(y) / 3.0]);
    let settings =
        (any::<[bool; 2]>(), any::<bool>(), 1u32..5, 1u32..4, prop_oneof![Just(0.06), Just(0.1), Just(0.3)])
            .prop_map(|([delta, any], cross_reference, k, n, e_th)| config::Mentor {
                inference: if any { InferenceKind::Any } else { InferenceKind::Similar },
                metric: if delta { MetricKind::Delta } else { MetricKind::Kl },
                cross_reference,
                k,
                n,
                e_th: Threshold::Kl(e_th),
                e_infeas: Threshold::Kl(0.05),
                ..config::Mentor::default()
            });
    let moves = proptest::collection::vec((0u32..3, 0u32..4, -2i8..3, 0u8..15), 20..120);
    let scale = (
        any::<bool>(),
        1usize..40,
        prop_oneof![Just(usize::MAX), 5usize..60],
        prop_oneof![3 => Just(Algo::HaDiiqn), 1 => Just(Algo::Diiqn)],
    );
    let paths = proptest::collection::vec(proptest::collection::vec(point(), 2..7), 1..3);
    (settings, scale, paths, moves, any::<prop::sample::Index>()).prop_map(
        |(config, (whole, replay, limit, algo), paths, moves, cut)| {
            let mut places = [[0.0f32; 2]; 3];
            let mut fresh = [true; 3];
            let steps = moves.into_iter().map(|(actor, action, reward, end)| {
                let a = actor as usize;
                let (axis, sign) = [(0, 1.0), (1, 1.0), (0, -1.0), (1, -1.0)][action as usize];
                let obs = places[a];
                let mut next = obs;
                // Thirds, added up, do not quite meet again: similar states, but not equal ones.
                next[axis] = (next[axis] + sign / 3.0).clamp(0.0, 2.0);
                let flags =
                    [TERMINATED, TRUNCATED, 0][usize::from(end.min(2))] | if fresh[a] { FIRST } else { 0 };
                fresh[a] = end < 2;
                places[a] = if end < 2 { [0.0; 2] } else { next };
                (actor, obs, next, action, f32::from(reward), flags)
            });
            Run { config, algo, replay, limit, whole, paths, steps: steps.collect(), cut }
        },
    )
}

impl Run {
    fn mentor(&self) -> Mentor {
        let paths: Vec<&[[f32; 2]]> = self.paths.iter().map(Vec::as_slice).collect();
        let mut mentor =
            Mentor::new(&demo(&paths), &self.config, self.algo, &spec(), self.replay, 11).unwrap();
        mentor.search.limit = self.limit;
        if self.whole { mentor.keeping_whole_bridges() } else { mentor }
    }
}

/// Calls `each` with the stretches of `steps` that belong to one actor, and their positions.
fn stretches(steps: &[Step], first: usize, mut each: impl FnMut(u64, Checked<Transitions<'_>>)) {
    let mut at = first;
    for stretch in steps.chunk_by(|a, b| a.0 == b.0) {
        each(at as u64, batch(stretch[0].0, stretch).transitions());
        at += stretch.len();
    }
}

proptest! {
    #![proptest_config(cases(300))]

    #[test]
    fn what_is_not_finite_is_refused(
        value in prop_oneof![Just(f32::NAN), Just(f32::INFINITY), Just(f32::NEG_INFINITY), Just(-f32::NAN)],
    ) {
        let mentor = diagonal(&config::Mentor::default(), Algo::HaDiiqn, 10);
        prop_assert!(mentor.similar(&[0.0, value], 3).is_err() && mentor.bridge(&[value, 0.0], 0, &mut Vec::new()).is_err());
        let mut demo = Demonstration::new(vec!["x".into()]).unwrap();
        prop_assert!(demo.push_trajectory(&[0.0, value, 1.0], false).is_err() && demo.n_states() == 0);
    }

    #[test]
    fn another_one_takes_over_without_a_trace(run in runs()) {
        let cut = run.cut.index(run.steps.len());
        let mut first = run.mentor();
        stretches(&run.steps[..cut], 0, |at, batch| {
            first.observe(at, batch, &mut Observed::default()).unwrap();
        });
        let mut second = run.mentor();
        let from = cut.saturating_sub(run.replay);
        stretches(&run.steps[from..cut], from, |at, batch| second.rebuild(at, batch).unwrap());
        let mut records = Vec::new();
        first.annotations(0, first.table().len() as u32, &mut records).unwrap();
        second.restore(&records).unwrap();
        prop_assert_eq!(first.stats(), second.stats());
        let (mut one, mut other) = (Observed::default(), Observed::default());
        let mut outcomes = Vec::new();
        stretches(&run.steps[cut..], cut, |at, batch| {
            first.observe(at, batch, &mut one).unwrap();
            second.observe(at, batch, &mut other).unwrap();
            outcomes.push((one.clone(), other.clone()));
        });
        for (one, other) in outcomes {
            prop_assert_eq!(one, other);
        }
        prop_assert_eq!(first.stats(), second.stats());
    }

    #[test]
    fn answers_name_what_changed_and_what_is_similar(run in runs()) {
        let mut mentor = run.mentor();
        let mut mirror = mentor.table().clone();
        let mut out = Observed::default();
        let mut faults = Vec::new();
        stretches(&run.steps, 0, |at, batch| {
            let before = mentor.table().clone();
            mentor.observe(at, batch, &mut out).unwrap();
            mirror.apply(&out.changed).unwrap();
            let named: Vec<u32> = out.changed.chunks_exact(mirror.record_words()).map(|r| r[0]).collect();
            let differs = |j: &u32| {
                let j = *j as usize;
                before.estimate(j) != mirror.estimate(j) || before.bridge(j) != mirror.bridge(j)
                    || before.further(j) != mirror.further(j)
            };
            let expected: Vec<u32> = (0..mirror.len() as u32).filter(differs).collect();
            if &mirror != mentor.table() || named != expected || out.mentor.len() != batch.len() {
                faults.push(format!("changed: {named:?} instead of {expected:?}"));
            }
            for (i, &j) in out.mentor.iter().enumerate() {
                let similar = mentor.similar(batch.get(i).obs, 1000).unwrap();
                let sound = if j == NONE { similar.is_empty() } else { similar.iter().any(|s| s.0 == j) };
                if !sound {
                    faults.push(format!("{j} is not among {similar:?}"));
                }
            }
        });
        prop_assert_eq!(faults, Vec::<String>::new());
        let below = (0..mirror.len()).filter(|&j| mirror.errors()[j] < mentor.rule.e_infeas).count();
        prop_assert_eq!(mentor.stats().feasible as usize, below);
    }
}
