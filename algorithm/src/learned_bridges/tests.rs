//! Learned bridges against naive oracles, and what they learn on a line.

#![allow(clippy::unwrap_used)]

use super::correction::{Correction, CorrectionConfig};
use super::goal::{Goal, draw, softmax};
use super::hindsight::{Hindsight, HindsightConfig};
use super::path::{Path, Paths, Place, distance};
use super::tracker::{Pace, Tracker};
use crate::replay::Replay;
use proptest::prelude::*;
use rand::{Rng, SeedableRng};
use trestle_proto::NONE;
use trestle_proto::acting::OwnPlaces;
use trestle_proto::batch::{FIRST, TERMINATED, TRUNCATED, Transition};
use trestle_proto::rng::Stream;
use trestle_proto::waypoints::Waypoints;
use trestle_qnet::{AdamConfig, Encoding, Isa, Kernels, Layout, Workspace, argmax, forward, init};

const PACE: Pace =
    Pace { window: 10.0, lookahead: 1.0, gate: true, idle: 0, roam: 0, back_off: 1.0, search: 0.0 };

/// States of a position and a velocity, each from -8 to 8; goals are positions, in units of 2.
fn goal() -> Goal {
    let encoding = Encoding::Scale { low: vec![-8.0; 2], high: vec![8.0; 2] };
    Goal::new(encoding, &[0], &[2.0, 1.0])
}

fn hindsight(batch: usize, horizon: usize, seed: u64, kernels: Kernels) -> Hindsight {
    let layout = Layout::new(&[3, 9, 7, 3]).unwrap();
    let mut rng = Stream::seed_from_u64(seed);
    let params = init(&layout, &mut rng);
    let config = HindsightConfig { batch, horizon, adam: AdamConfig { lr: 0.02, ..AdamConfig::default() } };
    Hindsight::new(goal(), layout, params, config, rng, kernels)
}

/// Actor, state, next state and flags of a transition.
type Walked = (u32, [f32; 2], [f32; 2], u32);

/// Two actors' walks over whole positions: actions are to the left, none, to the right.
fn walks(capacity: usize, steps: usize, seed: u64) -> (Replay, Vec<Walked>) {
    let mut replay = Replay::new(capacity, 2).unwrap();
    let mut rng = Stream::seed_from_u64(seed);
    let (mut places, mut history) = ([None; 2], Vec::new());
    for _ in 0..steps {
        let actor = rng.random_range(0..2u32);
        let place: &mut Option<[f32; 2]> = &mut places[actor as usize];
        let first = if place.is_none() { FIRST } else { 0 };
        let obs = place.unwrap_or_else(|| [rng.random_range(-6..=6) as f32, 0.0]);
        let action = rng.random_range(0..3u32);
        let change = action as f32 - 1.0;
        let next_obs = [(obs[0] + change).clamp(-8.0, 8.0), change];
        let ends = [0, 0, 0, 0, 0, 0, TERMINATED, TRUNCATED][rng.random_range(0..8usize)];
        let flags = first | ends;
        replay.push(&Transition { obs: &obs, next_obs: &next_obs, action, reward: 0.0, flags }, actor, NONE);
        history.push((actor, obs, next_obs, flags));
        *place = (ends == 0).then_some(next_obs);
    }
    (replay, history)
}

/// The loss in `f64`, from the definition.
fn naive_loss(hindsight: &Hindsight, params: &[f64], replay: &Replay) -> f64 {
    let pairs = hindsight.pairs();
    let mut loss = 0.0;
    for &(slot, last) in pairs {
        let (mut a, mut b) = (Vec::new(), Vec::new());
        let (own, end) = (replay.obs(slot).wide(&mut a), replay.next_obs(last).wide(&mut b));
        let mut x: Vec<f64> = own.iter().map(|&v| f64::from(v) / 8.0).collect();
        x.push(f64::from(end[0] - own[0]) / 2.0);
        let layers = hindsight.layout().layers();
        for (l, layer) in layers.iter().enumerate() {
            let (w, b) = (&params[layer.weights()], &params[layer.bias()]);
            let sum =
                |o: usize| (0..layer.inputs).map(|i| x[i] * w[i * layer.outputs + o]).sum::<f64>() + b[o];
            let out: Vec<f64> = (0..layer.outputs).map(sum).collect();
            x = if l + 1 == layers.len() { out } else { out.into_iter().map(|v| v.max(0.0)).collect() };
        }
        let whole: f64 = x.iter().map(|v| v.exp()).sum();
        loss -= (x[replay.get(slot).action as usize].exp() / whole).ln();
    }
    loss / pairs.len() as f64
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    /// The gradient against differences of the loss, the same on every instruction set.
    #[test]
    fn gradients_are_those_of_the_cross_entropy(batch in 1usize..9, horizon in 1usize..7, seed in 0u64..1000) {
        let (replay, _) = walks(30, 50, seed);
        let mut scalar = hindsight(batch, horizon, seed, Kernels::new(Isa::Scalar).unwrap());
        let (loss, grad) = scalar.gradient(&replay);
        let params: Vec<f64> = scalar.params().iter().map(|&p| f64::from(p)).collect();
        prop_assert!((loss - naive_loss(&scalar, &params, &replay)).abs() < 1e-5);
        for (at, &grad) in grad.iter().enumerate() {
            let moved = |by: f64| {
                let mut params = params.clone();
                params[at] += by;
                naive_loss(&scalar, &params, &replay)
            };
            let (below, here, above) = (moved(-1e-5), moved(0.0), moved(1e-5));
            let (left, right) = ((here - below) / 1e-5, (above - here) / 1e-5);
            // At a kink of a ReLU either side will do.
            let error = (f64::from(grad) - left).abs().min((f64::from(grad) - right).abs());
            prop_assert!(error < 1e-3, "{}: {} {} {}", at, grad, left, right);
        }
        for isa in Isa::available() {
            let mut other = hindsight(batch, horizon, seed, Kernels::new(isa).unwrap());
            prop_assert_eq!(other.gradient(&replay).1, grad.clone(), "{}", isa);
        }
    }

    /// Every drawn state that an own path is near, and no other, with the action that π likes best on the way to the place ahead; the
    /// second best where the best is most of what was done there and brought the observer no closer.
    #[test]
    fn states_near_own_paths_are_corrected(
        own in prop::collection::vec(prop::collection::vec(-6i8..=6, 2..6), 0..3),
        radius in 0.1f32..1.5, lookahead in 0.0f32..4.0, horizon in 1usize..7, seed in 0u64..1000,
    ) {
        let (replay, _) = walks(30, 50, seed);
        let hindsight = hindsight(1, 1, seed, Kernels::detect());
        let (layout, params) = (hindsight.layout().clone(), hindsight.params());
        let config = CorrectionConfig { weight: 1.0, radius, lookahead, horizon };
        let mut correction = Correction::new(goal(), layout.clone(), config, 40, Kernels::detect());
        // In units of 2, and no two equally near: no place is in the middle of two others.
        let path = |path: &Vec<i8>| path.iter().map(|&x| f32::from(x) + 0.01 * f32::from(x * x)).collect();
        let paths: Vec<Vec<f32>> = own.iter().map(path).collect();
        let lengths: Vec<u32> = paths.iter().map(|path| path.len() as u32).collect();
        correction.renew(&OwnPlaces { lengths, places: paths.concat() });
        let mut rng = Stream::seed_from_u64(seed);
        let mut drawn = Vec::new();
        if !paths.is_empty() {
            replay.sample(&mut rng.clone(), 40, &mut drawn);
        }
        let way = |places: &[f32]| places.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum::<f32>();
        let at = |slot: Option<usize>, next: usize| {
            let mut wide = Vec::new();
            slot.map_or_else(|| replay.next_obs(next), |slot| replay.obs(slot)).wide(&mut wide).to_vec()
        };
        let mut expected = Vec::new();
        for slot in drawn.into_iter().map(|slot| slot as usize) {
            let obs = at(Some(slot), 0);
            let away = |place: f32| (place - obs[0] / 2.0).abs();
            // What is left of a path from each of its places on.
            let rests = || paths.iter().flat_map(|path| (0..path.len()).map(|m| &path[m..]));
            let there = rests().filter(|rest| away(rest[0]) <= radius).min_by(|a, b| way(a).total_cmp(&way(b)));
            let near = || {
                let within = rests().filter(|rest| away(rest[0]) <= 2.0 * radius);
                within.min_by(|a, b| away(a[0]).total_cmp(&away(b[0])))
            };
            let Some(rest) = there.or_else(near) else { continue };
            let ahead = (0..rest.len()).find(|&m| way(&rest[..=m]) >= lookahead).unwrap_or(rest.len() - 1);
            let (mut x, mut outputs) = ([0.0; 3], [0.0; 3]);
            goal().encode(&obs, &[rest[ahead]], &mut x);
            let mut workspace = Workspace::with_kernels(&layout, 1, Kernels::detect());
            forward(&layout, params, &x, 1, &mut workspace, &mut outputs);
            let best = argmax(&outputs);
            let steps: Vec<usize> = replay.path(slot, horizon).collect();
            let same = steps.iter().filter(|&&slot| replay.get(slot).action as usize == best).count();
            let left = |obs: Vec<f32>| (obs[0] / 2.0 - rest[ahead]).abs();
            let closest = steps.iter().map(|&slot| left(at(None, slot))).fold(f32::INFINITY, f32::min);
            if 2 * same > steps.len() && closest > 0.9 * left(obs) {
                outputs[best] = f32::NEG_INFINITY;
            }
            expected.push((slot, argmax(&outputs) as u32));
        }
        prop_assert_eq!(correction.draw(40, &replay, params, &mut rng), expected);
    }

    /// Goals are states of the same actor's same episode, 1 to `horizon` steps later: a walk through the plain history.
    #[test]
    fn goals_lie_ahead_in_the_same_episode(capacity in 1usize..40, horizon in 1usize..7, seed in 0u64..1000) {
        let (replay, history) = walks(capacity, 60, seed);
        let mut hindsight = hindsight(32, horizon, seed, Kernels::detect());
        hindsight.gradient(&replay);
        prop_assert_eq!(hindsight.pairs().len(), 32);
        for &(slot, last) in hindsight.pairs() {
            let number = |slot: usize| {
                (replay.first_index()..replay.next_index()).find(|&i| replay.slot(i) == slot).unwrap() as usize
            };
            let (from, to) = (number(slot), number(last));
            let actor = history[from].0;
            let between: Vec<_> = history[from..=to].iter().filter(|step| step.0 == actor).collect();
            prop_assert!(from <= to && history[to].0 == actor && between.len() <= horizon);
            let ends = |step: &&&(u32, [f32; 2], [f32; 2], u32)| step.3 & (TERMINATED | TRUNCATED) != 0;
            prop_assert_eq!(between[..between.len() - 1].iter().filter(ends).count(), 0);
        }
    }

    /// The place on the path against a scan of all mentor states.
    #[test]
    fn the_tracker_equals_a_scan(
        lengths in prop::collection::vec(2usize..9, 1..4),
        places in prop::collection::vec(-8i8..=8, 40),
        walk in prop::collection::vec(-8i8..=8, 1..20),
        radius in prop::sample::select(vec![0.5f32, 1.0, 2.0]),
        window in prop::sample::select(vec![0.0f32, 1.0, 3.0, 100.0]),
        ahead in prop::sample::select(vec![0.0f32, 0.5, 1.0, 4.0]),
    ) {
        let waypoints = waypoints(&lengths, &places);
        let paths = Paths::new(Path::of_mentor(&waypoints, 2, &goal(), radius), 1, radius);
        let pace = Pace { window, lookahead: ahead, ..PACE };
        let mut tracker = Tracker::default();
        tracker.begin(&pace, 0.0);
        let mut naive: Option<usize> = None;
        let trajectory_of: Vec<usize> =
            lengths.iter().enumerate().flat_map(|(i, &n)| std::iter::repeat_n(i, n)).collect();
        let place_of = |m: usize| waypoints.states[2 * m] / 2.0;
        let length = |m: usize| {
            let first = (0..m).rev().take_while(|&k| trajectory_of[k] == trajectory_of[m]).last().unwrap_or(m);
            (first..m).fold(0.0, |sum, k| sum + distance(&[place_of(k)], &[place_of(k + 1)]))
        };
        for &x in &walk {
            let place = f32::from(x) / 2.0;
            tracker.follow(&paths, &pace, &[place], &mut Vec::new(), &mut Vec::new());
            let near: Vec<usize> = (0..trajectory_of.len())
                .filter(|&m| (place_of(m) - place) * (place_of(m) - place) <= radius * radius)
                .collect();
            let on = naive.and_then(|at| {
                near.iter().copied().rfind(|&m| {
                    trajectory_of[m] == trajectory_of[at] && (length(m) - length(at)).abs() <= window
                })
            });
            let nearest = near.iter().copied().min_by(|&a, &b| {
                (place_of(a) - place).abs().total_cmp(&(place_of(b) - place).abs())
            });
            naive = on.or(nearest).or(naive);
            prop_assert_eq!(tracker.at(), naive.map(|at| Place { own: false, number: at as u32 }));
            let aim = naive.map(|at| {
                let same = (at..trajectory_of.len()).filter(|&m| trajectory_of[m] == trajectory_of[at]);
                let last = same.clone().next_back().unwrap();
                same.clone().find(|&m| length(m) >= length(at) + ahead).unwrap_or(last)
            });
            let goal = aim.map(place_of);
            prop_assert_eq!(tracker.next(&paths, &pace).map(|place| place[0]), goal);
            let led = goal.filter(|_| tracker.furthest() < 1.0);
            prop_assert_eq!(tracker.goal(&paths, &pace).map(|place| place[0]), led);
        }
    }

    #[test]
    fn probabilities_add_up_and_draws_follow_them(row in prop::collection::vec(-60.0f32..60.0, 1..9), u in 0.0f64..1.0) {
        let mut p = row.clone();
        softmax(&mut p);
        let exact: f64 = row.iter().map(|&x| f64::from(x).exp()).sum();
        for (&p, &x) in p.iter().zip(&row) {
            prop_assert!((f64::from(p) - f64::from(x).exp() / exact).abs() < 1e-5);
        }
        let drawn = draw(&p, u);
        let below: f64 = p[..drawn].iter().map(|&p| f64::from(p)).sum();
        prop_assert!(below <= u && (u < below + f64::from(p[drawn]) || drawn + 1 == p.len()));
    }
}

/// Trajectories of so many states, at these positions.
fn waypoints(lengths: &[usize], places: &[i8]) -> Waypoints {
    let mut waypoints = Waypoints::default();
    let mut transitions = 0;
    for &n in lengths {
        for step in 0..n {
            let m = waypoints.transition_of.len();
            waypoints.states.extend([f32::from(places[m]), 0.0]);
            waypoints.transition_of.push(if step + 1 == n { NONE } else { transitions });
            transitions += u32::from(step + 1 < n);
            waypoints.progress.push(0.0);
        }
    }
    waypoints
}

/// The path over five states, a unit apart.
fn five() -> Paths {
    Paths::new(Path::of_mentor(&waypoints(&[5], &[0, 2, 4, 6, 8]), 2, &goal(), 0.4), 1, 0.4)
}

/// Lets `tracker` go through an episode over `places`, up to its end; returns where the guide aims at each of them.
fn walk(tracker: &mut Tracker, paths: &Paths, pace: &Pace, places: &[f32]) -> Vec<Option<f32>> {
    let (mut stack, mut hits) = (Vec::new(), Vec::new());
    let mut goals = Vec::new();
    for (at, place) in places.iter().enumerate() {
        match at {
            0 => tracker.observe(paths, pace, &[*place], &mut stack, &mut hits),
            _ => tracker.follow(paths, pace, &[*place], &mut stack, &mut hits),
        }
        goals.push(tracker.goal(paths, pace).map(|place| place[0]));
    }
    goals
}

#[test]
fn a_guide_that_gets_stuck_is_used_less() {
    let (paths, pace) = (five(), PACE);
    let mut tracker = Tracker::default();
    let mut episode = |places: &[f32], success: bool, u: f64| {
        tracker.begin(&pace, u);
        walk(&mut tracker, &paths, &pace, places);
        let seen = (tracker.guided(), tracker.furthest(), tracker.finish(success));
        (seen, tracker.stuck())
    };
    assert_eq!(episode(&[0.0, 1.0, 1.0], false, 0.9), ((true, 0.25, false), 0));
    // No further than before.
    assert_eq!(episode(&[0.0, 1.0, 0.0], false, 0.9), ((true, 0.25, true), 1));
    assert_eq!(episode(&[0.0, 0.0, 0.0], false, 0.49), ((true, 0.0, true), 2));
    // Not guided: neither a failure nor a success counts.
    assert_eq!(episode(&[0.0, 0.0, 0.0], false, 0.34), ((false, 0.0, true), 2));
    assert_eq!(episode(&[0.0, 1.0, 2.0], true, 0.34), ((false, 0.5, false), 2));
    // What an episode that was not guided has reached is no news.
    assert_eq!(episode(&[0.0, 1.0, 2.0], false, 0.33), ((true, 0.5, true), 3));
    assert_eq!(episode(&[-3.0, -3.0], true, 0.0), ((true, 0.0, false), 0));
    assert_eq!(episode(&[3.0, 4.0, 3.0], false, 0.99), ((true, 1.0, false), 0));
    assert_eq!(episode(&[3.0, 4.0], false, 0.99), ((true, 1.0, true), 1));
    // With other own paths all counts again.
    tracker.renew();
    assert_eq!((tracker.stuck(), tracker.chance(&pace)), (0, 1.0));
    tracker.begin(&pace, 0.99);
    walk(&mut tracker, &paths, &pace, &[0.0, 1.0]);
    assert!(!tracker.finish(false));
}

#[test]
fn a_guide_lets_go_for_a_while_where_it_does_not_get_on() {
    let (paths, pace) = (five(), Pace { idle: 3, roam: 2, ..PACE });
    let mut tracker = Tracker::default();
    tracker.begin(&pace, 0.0);
    let places = [0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 2.0, 1.0, 1.0, 1.0];
    let goals = walk(&mut tracker, &paths, &pace, &places);
    let (led, free) = (Some(2.0), None);
    // Three steps after it came to the second state it lets go for two, and so on, whether or not it gets on meanwhile.
    assert_eq!(goals[..10], [Some(1.0), led, led, led, free, free, led, led, led, free]);
    assert_eq!(goals[10..], [free, led, led, led]);
    let never = Pace { idle: 0, ..pace };
    tracker.begin(&never, 0.0);
    assert_eq!(walk(&mut tracker, &paths, &never, &[1.0; 99])[98], led);
    // There is nothing to lead to at the end.
    tracker.begin(&never, 0.0);
    assert_eq!(walk(&mut tracker, &paths, &never, &[3.0, 4.0, 3.0]), [Some(4.0), free, free]);
}

#[test]
fn it_lets_go_for_longer_and_longer_before_the_first_success() {
    let (paths, pace) = (five(), Pace { idle: 3, roam: 2, back_off: 2.0, ..PACE });
    let mut tracker = Tracker::default();
    let led = |tracker: &mut Tracker, places: &[f32]| -> String {
        tracker.begin(&pace, 0.0);
        let goals = walk(tracker, &paths, &pace, places);
        goals.iter().map(|goal| if goal.is_some() { '+' } else { '-' }).collect()
    };
    let pinned = [&[0.0][..], &[1.0; 17]].concat();
    assert_eq!(led(&mut tracker, &pinned), "++++--+++----+++--");
    // It has come further meanwhile, so that the next time is as short as the first.
    let passing = [&[0.0][..], &[1.0; 10], &[2.0; 8]].concat();
    assert_eq!(led(&mut tracker, &passing), "++++--+++----+++--+");
    tracker.renew();
    assert_eq!(led(&mut tracker, &pinned), "++++--+++--+++--++");
}

#[test]
fn a_guide_is_not_given_up_before_the_first_success_and_shares_the_steps_after_it() {
    let (paths, pace) = (five(), Pace { search: 0.5, ..PACE });
    let mut tracker = Tracker::default();
    let episode = |tracker: &mut Tracker, steps: usize, success: bool| {
        tracker.begin(&pace, 0.0);
        walk(tracker, &paths, &pace, &vec![1.0; steps + 1]);
        let seen = (tracker.guided(), tracker.searches(&pace));
        tracker.finish(success);
        (seen, tracker.chance(&pace))
    };
    assert_eq!(episode(&mut tracker, 1, false), ((true, true), 1.0));
    for _ in 0..9 {
        assert_eq!(episode(&mut tracker, 1, false), ((true, true), 0.5));
    }
    // Ten steps until the first success: as many may be guided at once, and then three of four.
    tracker.renew();
    assert_eq!(episode(&mut tracker, 10, true), ((true, false), 1.0));
    assert_eq!(episode(&mut tracker, 5, true), ((true, false), 0.0));
    assert_eq!(episode(&mut tracker, 1, true), ((false, false), 0.0));
    assert_eq!(episode(&mut tracker, 1, true), ((false, false), 1.0));
    assert_eq!(episode(&mut tracker, 2, true), ((true, false), 0.0));
}

#[test]
fn own_paths_go_before_the_mentors() {
    let (mut paths, pace) = (five(), PACE);
    let own = OwnPlaces { lengths: vec![3, 2], places: vec![1.0, 0.5, 0.0, 3.0, 3.25] };
    paths.set_own(&own);
    let mut tracker = Tracker::default();
    tracker.begin(&pace, 0.0);
    // Along the mentor's path, then backwards along the first own one, and on the second.
    let goals = walk(&mut tracker, &paths, &pace, &[2.0, 1.1, 0.6, 2.9]);
    assert_eq!(goals, [Some(3.0), Some(0.0), Some(0.0), Some(3.25)]);
    assert_eq!(tracker.at(), Some(Place { own: true, number: 3 }));
    assert!(tracker.fits(5, 5) && !tracker.fits(5, 3));
    paths.set_own(&OwnPlaces::default());
    tracker.renew();
    assert_eq!((tracker.at(), tracker.fits(5, 0)), (None, true));
}

/// The policy finds out which way an action leads, and a restored one goes on alike.
#[test]
fn it_learns_to_go_where_it_is_told() {
    let (replay, _) = walks(2000, 2000, 4);
    let mut hindsight = hindsight(64, 3, 7, Kernels::detect());
    let before = hindsight.update(&replay).unwrap();
    let losses: Vec<f64> = (0..400).map(|_| hindsight.update(&replay).unwrap()).collect();
    assert!(losses[399] < before - 0.2, "{before} {}", losses[399]);
    let layout = hindsight.layout().clone();
    let mut ws = Workspace::new(&layout, 1);
    for (from, to, likeliest) in [(-3.0, -1.0, 2), (-3.0, -5.0, 0), (4.0, 6.0, 2), (4.0, 2.0, 0)] {
        let (mut x, mut out) = ([0.0; 3], [0.0; 3]);
        goal().encode(&[from, 0.0], &[to / 2.0], &mut x);
        forward(&layout, hindsight.params(), &x, 1, &mut ws, &mut out);
        softmax(&mut out);
        assert!(out[likeliest] > 0.5, "{from} {to}: {out:?}");
    }
    let mut again = self::hindsight(64, 3, 99, Kernels::detect());
    assert!(again.restore(hindsight.state()));
    let next = hindsight.update(&replay);
    assert_eq!(again.update(&replay), next);
    assert_eq!(again.state(), hindsight.state());
    let mut other = hindsight.state().clone();
    other.params.pop();
    assert!(!again.restore(&other));
    assert_eq!(again.update(&Replay::new(5, 2).unwrap()), None);
}
