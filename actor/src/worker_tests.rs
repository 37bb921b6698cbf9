//! Tests of one actor without any transport.
#![allow(clippy::unwrap_used)]

use super::*;
use trestle_proto::NONE;
use trestle_proto::annotation::Further;
use trestle_proto::batch::Tally;
use trestle_proto::experiment::MentorPart;
use trestle_proto::waypoints::Waypoints;

pub(crate) fn experiment(overrides: &[&str]) -> Experiment {
    let own = ["run.algo=ha-diiqn", "env.encoding=coordinates"];
    let overrides: Vec<String> = own.iter().chain(overrides).map(ToString::to_string).collect();
    let mut config = config::load(registry(), "maze-small", &overrides).unwrap();
    registry().resolve(&mut config.env, config.run.seed).unwrap();
    let spec = registry().build(&config.env).unwrap().spec().clone();
    Experiment { config, spec, mentors: Vec::new(), waypoints: None }
}

/// An experiment on the map `layout` with actions W and E, a network without influence but its output's bias.
fn corridor(layout: &str, overrides: &[&str]) -> Experiment {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("map.txt");
    std::fs::write(&path, layout).unwrap();
    let map = format!("env.map={}", path.display());
    let mut all =
        vec![map.as_str(), "env.action_sets.line=['W', 'E']", "env.actions=line", "env.step_limit=7"];
    all.extend(overrides);
    experiment(&all)
}

/// Parameters with which `action` is the best everywhere.
fn always(experiment: &Experiment, action: usize) -> Vec<f32> {
    let (layout, _) = network_of(experiment).unwrap();
    let mut params = vec![0.0; layout.n_params()];
    let bias = layout.n_params() - layout.output();
    params[bias + action] = 1.0;
    params
}

/// Parameters with which actions depend on the state.
fn random_params(experiment: &Experiment) -> Vec<f32> {
    trestle_qnet::init(&network_of(experiment).unwrap().0, &mut stream(1, Purpose::Weights, 0))
}

fn order(round: u64, steps: u32) -> Collect {
    let env_steps = (round - 1) * u64::from(steps);
    Collect { run: 77, round: round.into(), weights_version: (round - 1).into(), env_steps, steps }
}

/// `n` batches of `amount` steps.
fn batches(worker: &mut Worker, params: &[f32], first: u64, n: u64, amount: u32) -> Vec<Batch> {
    guided_batches(worker, &Acting::of_weights(params.to_vec()), first, n, amount)
}

/// The same with a guide.
/// The actions of `batch`.
fn actions(batch: &Batch) -> Vec<u32> {
    (0..batch.len()).map(|at| batch.transition(at).action).collect()
}

fn guided_batches(worker: &mut Worker, acting: &Acting, first: u64, n: u64, amount: u32) -> Vec<Batch> {
    let mut collect = |t| {
        let mut batch = Batch::default();
        worker.collect(acting, &order(t, amount), &mut batch).unwrap();
        batch
    };
    (first..first + n).map(&mut collect).collect()
}

/// The corridor "S....G", whose mentor went from its start to its end; of every exploring step a share is guided.
fn guided_corridor(share: f64) -> Experiment {
    let share = ["start", "end"].map(|at| format!("exploration.guide_{at}={share}"));
    let mut experiment = walked_corridor(&["mentor.e_th=0.1", &share[0], &share[1]]);
    experiment.mentors = vec![MentorPart { name: "line".into(), transitions: 5 }];
    experiment
}

/// The same corridor without annotations, where every step explores.
fn walked_corridor(sets: &[&str]) -> Experiment {
    let mut experiment = corridor("S....G\n", &[&["exploration.epsilon_end=1"], sets].concat());
    let states = (0..6).flat_map(|x| [x as f32, 0.0]).collect();
    let (transition_of, progress) = (vec![0, 1, 2, 3, 4, NONE], vec![0.0; 6]);
    experiment.waypoints = Some(Waypoints { states, transition_of, progress });
    experiment
}

#[test]
fn guided_steps_take_the_known_action_of_the_state_they_are_in() {
    let experiment = guided_corridor(1.0);
    let mut worker = Worker::new(&experiment, 0).unwrap();
    // East is known everywhere but in the fourth cell, where west is, so that it never gets further.
    let acting =
        |known: [u32; 5]| Acting { known: known.to_vec(), ..Acting::of_weights(always(&experiment, 0)) };
    let east = acting([1, 1, 1, 0, NONE]);
    assert_eq!(worker.lengths(), east.lengths());
    let batch = guided_batches(&mut worker, &east, 1, 1, 7).remove(0);
    assert_eq!(actions(&batch), [1, 1, 1, 0, 1, 0, 1]);
    // Without the table nothing is done, and nothing is known of a table without entries.
    let weights = Acting::of_weights(always(&experiment, 0));
    assert!(worker.collect(&weights, &order(2, 7), &mut Batch::default()).is_err());
    let explored = guided_batches(&mut worker, &acting([NONE; 5]), 2, 30, 7);
    let actions: Vec<u32> = explored.iter().flat_map(actions).collect();
    let east = actions.iter().sum::<u32>();
    assert!((60..150).contains(&east), "random where nothing is known: {east} of 210");
    // Evaluations need the parameters alone.
    assert!(
        worker.evaluate(&always(&experiment, 1), 0, 1).unwrap().episodes[0].episode.success == Some(true)
    );
}

/// The corridor of [`guided_corridor`] with whole bridges, and what is acted with: of each option the mentor transition, and its
/// steps with the cells in which they are to be taken.
fn optional_corridor(known: [u32; 5], options: &[(u32, &[(u32, f32)])]) -> (Experiment, Acting) {
    let mut experiment = guided_corridor(1.0);
    experiment.config.exploration.guide_whole = true;
    experiment.config.mentor.k = 7;
    let mut acting = Acting { known: known.to_vec(), ..Acting::of_weights(always(&experiment, 0)) };
    for (j, steps) in options {
        let actions: Vec<u32> = steps.iter().map(|step| step.0).collect();
        let states: Vec<f32> = steps.iter().flat_map(|step| [step.1, 0.0]).collect();
        acting.options.push(*j, Further { actions: &actions, states: &states });
    }
    assert!(experiment.rooms().options.holds(&acting.options));
    (experiment, acting)
}

#[test]
fn whole_bridges_are_followed_to_their_end() {
    // From the first cell east, east, west; in the second cell nothing else is known than west.
    let steps: &[(u32, f32)] = &[(1, 1.0), (0, 2.0)];
    let (experiment, acting) = optional_corridor([1, 0, NONE, NONE, NONE], &[(0, steps)]);
    let mut worker = Worker::new(&experiment, 0).unwrap();
    let batch = guided_batches(&mut worker, &acting, 1, 1, 8).remove(0);
    // The seventh step is the last of its episode, and the next one begins in the first cell.
    assert_eq!(actions(&batch), [1, 1, 0, 0, 1, 1, 0, 1]);
}

#[test]
fn an_episode_ends_a_whole_bridge() {
    // Seven steps east, of which five lead to the goal.
    let steps: Vec<(u32, f32)> = (1..7).map(|x| (u32::from(x < 5), x as f32)).collect();
    let (experiment, acting) = optional_corridor([1, NONE, NONE, NONE, NONE], &[(0, &steps)]);
    let mut worker = Worker::new(&experiment, 0).unwrap();
    let batch = guided_batches(&mut worker, &acting, 1, 1, 10).remove(0);
    assert_eq!(actions(&batch), [1; 10]);
    // A new life of the actor begins an episode as well.
    guided_batches(&mut worker, &acting, 2, 1, 3);
    worker.begin(worker.incarnation()).unwrap();
    assert_eq!(actions(&guided_batches(&mut worker, &acting, 3, 1, 5)[0]), [1; 5]);
}

#[test]
fn a_whole_bridge_is_abandoned_where_it_has_not_been() {
    // The third step is to be taken where the second one does not lead. West is known in the third cell, and east elsewhere.
    let steps: &[(u32, f32)] = &[(1, 1.0), (1, 4.0), (1, 3.0)];
    let (experiment, acting) = optional_corridor([1, 1, 0, 1, 1], &[(0, steps)]);
    let mut worker = Worker::new(&experiment, 0).unwrap();
    let batch = guided_batches(&mut worker, &acting, 1, 1, 7).remove(0);
    assert_eq!(actions(&batch), [1, 1, 0, 1, 0, 1, 0]);
}

/// `worker` goes on as one does that its snapshot was given to: after the seven ticks from each of `firsts`, of `rollout` steps each.
fn goes_on_from_snapshots(
    worker: &mut Worker,
    experiment: &Experiment,
    acting: &Acting,
    firsts: &[u64],
    rollout: u32,
) {
    for &first in firsts {
        guided_batches(worker, acting, first, 7, rollout);
        let bytes = worker.snapshot().unwrap();
        let mut other = Worker::new(experiment, 0).unwrap();
        other.restore(&bytes).unwrap();
        assert_eq!(other.snapshot().unwrap(), bytes);
        let went_on = guided_batches(&mut other, acting, first + 7, 20, 13);
        assert_eq!(guided_batches(worker, acting, first + 7, 20, 13), went_on);
    }
}

#[test]
fn an_actor_on_a_whole_bridge_goes_on_from_its_snapshot() {
    let steps: &[(u32, f32)] = &[(1, 1.0), (0, 2.0), (1, 1.0), (0, 2.0)];
    let (mut experiment, acting) = optional_corridor([1, 0, NONE, NONE, NONE], &[(0, steps)]);
    (experiment.config.exploration.guide_start, experiment.config.exploration.guide_end) = (0.6, 0.6);
    let mut worker = Worker::new(&experiment, 0).unwrap();
    goes_on_from_snapshots(&mut worker, &experiment, &acting, &[1, 8, 15, 22], 9);
    // In the middle of a bridge, an actor with shorter ones does not take it, and neither does one without.
    let at_once = Worker::new(&optional_corridor([1; 5], &[]).0, 0);
    let mut worker = at_once.unwrap();
    guided_batches(&mut worker, &acting, 1, 1, 1);
    let bytes = worker.snapshot().unwrap();
    let mut short = experiment.clone();
    short.config.mentor.k = 2;
    for other in [&short, &guided_corridor(1.0), &walked_corridor(&[])] {
        let refused = Worker::new(other, 0).unwrap().restore(&bytes);
        assert!(matches!(refused, Err(ActorError::Guide { index: 0 })), "{refused:?}");
    }
}

#[test]
fn a_share_of_the_exploring_steps_is_guided() {
    let experiment = guided_corridor(0.5);
    let mut worker = Worker::new(&experiment, 0).unwrap();
    let acting = Acting { known: vec![1; 5], ..Acting::of_weights(always(&experiment, 0)) };
    let actions: Vec<u32> =
        guided_batches(&mut worker, &acting, 1, 100, 10).iter().flat_map(actions).collect();
    // Half guided, of the others half by chance.
    let east = actions.iter().sum::<u32>();
    assert!((690..810).contains(&east), "{east} of 1000");
}

/// The same corridor, where every exploring step follows learned bridges while these guide an episode.
fn bridged_corridor(sets: &[&str]) -> Experiment {
    let own = [
        "run.algo=trestle",
        "exploration.guide_start=1",
        "exploration.guide_end=1",
        "mentor.learned.hidden=[1]",
        "mentor.learned.features=[0,1]",
        "mentor.learned.radius=0.5",
        "mentor.learned.window=3",
        "mentor.learned.lookahead=1",
    ];
    walked_corridor(&[&own[..], sets].concat())
}

/// A network that goes west, and a guiding policy that all but surely takes `action`.
fn leading(experiment: &Experiment, action: usize) -> Acting {
    let mut policy = vec![0.0; experiment.acting().policy];
    let outputs = policy.len() - 2;
    policy[outputs + action] = 90.0;
    Acting { policy, ..Acting::of_weights(always(experiment, 0)) }
}

#[test]
fn learned_bridges_lead_to_the_end_of_the_path() {
    let experiment = bridged_corridor(&[]);
    let mut worker = Worker::new(&experiment, 0).unwrap();
    let east = leading(&experiment, 1);
    let batches = guided_batches(&mut worker, &east, 1, 4, 5);
    assert!(batches.iter().all(|batch| actions(batch) == [1; 5] && batch.transition(4).succeeded()));
    let tally = Tally { steps: 5, episodes: 1, guided: 1, stuck: 0, progress: 1.0 };
    assert!(batches.iter().all(|batch| batch.header.guide == tally));
}

#[test]
fn episodes_are_left_to_themselves_where_bridges_lead_nowhere() {
    let led = |sets: &[&str]| {
        let experiment = bridged_corridor(sets);
        let mut worker = Worker::new(&experiment, 0).unwrap();
        let mut tally = Tally::default();
        for batch in guided_batches(&mut worker, &leading(&experiment, 0), 1, 50, 14) {
            tally.merge(&batch.header.guide);
        }
        tally
    };
    // Every episode has its seven steps and stays in the first cell.
    let pinned = led(&["mentor.learned.gate=false", "mentor.learned.idle=0"]);
    assert_eq!((pinned.steps, pinned.guided, pinned.stuck, pinned.progress), (700, 100, 100, 0.0));
    // Two steps are led and three are free, unless an episode gets on by itself.
    let free = led(&["mentor.learned.gate=false", "mentor.learned.idle=2", "mentor.learned.roam=3"]);
    assert!((200..500).contains(&free.steps) && free.progress > 5.0, "{free:?}");
    let gated = led(&["mentor.learned.gate=true", "mentor.learned.idle=0", "mentor.learned.search=0"]);
    assert!((7..400).contains(&gated.steps) && gated.guided < 60 && gated.stuck == gated.guided, "{gated:?}");
}

#[test]
fn an_actor_that_is_led_goes_on_from_its_snapshot() {
    let experiment = bridged_corridor(&["exploration.guide_start=0.5", "exploration.guide_end=0.5"]);
    let acting = leading(&experiment, 1);
    let mut worker = Worker::new(&experiment, 0).unwrap();
    goes_on_from_snapshots(&mut worker, &experiment, &acting, &[1, 8, 15], 13);
    // Neither an actor without a guide nor one with another path takes it.
    let bytes = worker.snapshot().unwrap();
    let mut plain = Worker::new(&walked_corridor(&[]), 0).unwrap();
    let message = plain.restore(&bytes).unwrap_err().to_string();
    assert!(message.contains("what its guide has under way"), "{message}");
    let mut other = bridged_corridor(&[]);
    other.waypoints.as_mut().unwrap().states.truncate(4);
    other.waypoints.as_mut().unwrap().transition_of = vec![0, NONE];
    let beyond = (0..9).any(|t| {
        guided_batches(&mut worker, &acting, 100 + t, 1, 1);
        let bytes = worker.snapshot().unwrap();
        matches!(Worker::new(&other, 0).unwrap().restore(&bytes), Err(ActorError::Guide { index: 0 }))
    });
    assert!(beyond, "no state but the first two was ever come to");
}

#[test]
fn an_own_path_is_followed_and_remembered() {
    // The mentor's path ends where it begins.
    let mut experiment = bridged_corridor(&["exploration.guide_start=0.5", "exploration.guide_end=0.5"]);
    experiment.waypoints.as_mut().unwrap().states = vec![0.0; 12];
    let mut worker = Worker::new(&experiment, 0).unwrap();
    let mut acting = leading(&experiment, 1);
    assert_eq!(guided_batches(&mut worker, &acting, 1, 1, 14)[0].header.guide.steps, 0);
    acting.own = trestle_proto::acting::OwnPlaces {
        lengths: vec![6],
        places: (0..6).flat_map(|x| [x as f32, 0.0]).collect(),
    };
    assert!(guided_batches(&mut worker, &acting, 2, 1, 14)[0].header.guide.steps > 0);
    let mut other = Worker::new(&experiment, 0).unwrap();
    other.restore(&worker.snapshot().unwrap()).unwrap();
    assert_eq!(
        guided_batches(&mut other, &acting, 3, 20, 13),
        guided_batches(&mut worker, &acting, 3, 20, 13)
    );
}

#[test]
fn the_first_success_is_looked_for_as_at_the_start_however_long_it_takes() {
    let over = ["exploration.guide_end=0", "exploration.guide_decay_steps=1", "exploration.epsilon_end=0"];
    let more = ["exploration.epsilon_decay_steps=1", "mentor.learned.search=1"];
    let experiment = bridged_corridor(&[&over[..], &more].concat());
    let mut worker = Worker::new(&experiment, 0).unwrap();
    let mut acting = leading(&experiment, 1);
    let searching = guided_batches(&mut worker, &acting, 5, 4, 5);
    assert!(searching.iter().all(|batch| actions(batch) == [1; 5]));
    // The network goes west, and nothing else is left once there is an own path.
    acting.own = trestle_proto::acting::OwnPlaces {
        lengths: vec![6],
        places: (0..6).flat_map(|x| [x as f32, 0.0]).collect(),
    };
    let found = guided_batches(&mut worker, &acting, 9, 4, 5);
    assert!(found.iter().all(|batch| actions(batch) == [0; 5] && batch.header.guide == Tally::default()));
}

#[test]
fn a_guide_is_played_alone_and_has_nothing_to_do_when_its_time_is_over() {
    let over = ["exploration.guide_end=0", "exploration.guide_decay_steps=14", "mentor.learned.search=0"];
    let experiment = bridged_corridor(&over);
    let mut worker = Worker::new(&experiment, 0).unwrap();
    let before = worker.snapshot().unwrap();
    let played =
        |worker: &mut Worker, action| worker.evaluate_guide(&leading(&experiment, action).policy, 3).unwrap();
    assert!((played(&mut worker, 1).unwrap() - 0.84).abs() < 1e-6);
    assert!((played(&mut worker, 0).unwrap() + 7.0 * 0.75).abs() < 1e-6);
    assert_eq!(worker.snapshot().unwrap(), before);
    let acting = leading(&experiment, 1);
    let guided = guided_batches(&mut worker, &acting, 1, 1, 14).remove(0);
    assert!(guided.header.guide.steps > 0);
    let free = guided_batches(&mut worker, &acting, 2, 20, 14);
    assert!(free.iter().all(|batch| batch.header.guide == Tally::default()));
    assert_eq!(played(&mut worker, 1), None);
    assert_eq!(Worker::new(&walked_corridor(&[]), 0).unwrap().evaluate_guide(&[], 3).unwrap(), None);
}

#[test]
fn batches_are_complete_and_continuous() {
    let experiment = experiment(&["run.actors=2", "env.step_limit=50"]);
    let params = random_params(&experiment);
    let mut worker = Worker::new(&experiment, 1).unwrap();
    assert_eq!((worker.index(), worker.obs_dim(), worker.lengths().words()), (1, 2, params.len()));
    let (mut expected, mut obs, mut ends) = (FIRST, vec![0.0, 0.0], 0);
    for (t, batch) in (1..).zip(batches(&mut worker, &params, 1, 20, 32)) {
        let header = BatchHeader {
            run: 77,
            round: t.into(),
            first_seq: (t - 1) * 32,
            weights_version: (t - 1).into(),
            actor: 1,
            incarnation: Incarnation::default(),
            count: 32,
            obs_dim: 2,
            element: 0,
            reserved: 0,
            guide: Tally::default(),
        };
        assert_eq!(batch.header, header);
        batch.clone().check(&experiment.spaces()).unwrap();
        for i in 0..32 {
            let transition = batch.transition(i);
            assert_eq!((transition.flags & FIRST, transition.obs), (expected, obs.as_slice()));
            let end = transition.ends_episode();
            expected = if end { FIRST } else { 0 };
            obs = if end { vec![0.0, 0.0] } else { transition.next_obs.to_vec() };
            ends += u32::from(end);
        }
    }
    // 640 steps in episodes of at most 50.
    assert!(ends >= 12);
}

#[test]
fn flags_tell_how_an_episode_ended() {
    const END: u32 = TERMINATED | SUCCEEDED;
    let flags = |layout: &str, action| {
        let experiment = corridor(layout, &["exploration.epsilon_start=0", "exploration.epsilon_end=0"]);
        let params = always(&experiment, action);
        let batch = batches(&mut Worker::new(&experiment, 0).unwrap(), &params, 1, 1, 8).remove(0);
        (0..8).map(|at| batch.transition(at).flags).collect::<Vec<_>>()
    };
    assert_eq!(flags("S.G\n", 1), [FIRST, END, FIRST, END, FIRST, END, FIRST, END]);
    assert_eq!(flags("SG\n", 1), [FIRST | END; 8]);
    assert_eq!(flags("SG\n", 0), [FIRST, 0, 0, 0, 0, 0, TRUNCATED, FIRST]);
}

#[test]
fn the_cut_into_batches_changes_nothing() {
    let experiment = experiment(&["env.step_limit=50"]);
    let params = random_params(&experiment);
    let transitions = |n, amount: u32| {
        let made = batches(&mut Worker::new(&experiment, 0).unwrap(), &params, 1, n, amount);
        let all = made.iter().flat_map(|b| (0..b.len()).map(|i| format!("{:?}", b.transition(i))));
        all.collect::<Vec<_>>()
    };
    assert_eq!(transitions(64, 5), transitions(1, 320));
}

#[test]
fn actors_and_seeds_differ() {
    let taken = |seed: &str, index| {
        let experiment = experiment(&["run.actors=2", seed]);
        let params = random_params(&experiment);
        actions(&batches(&mut Worker::new(&experiment, index).unwrap(), &params, 1, 1, 64)[0])
    };
    assert_eq!(taken("run.seed=1", 0), taken("run.seed=1", 0));
    assert_ne!(taken("run.seed=1", 0), taken("run.seed=1", 1));
    assert_ne!(taken("run.seed=1", 0), taken("run.seed=2", 0));
}

#[test]
fn exploration_follows_the_schedule_over_all_actors() {
    let explores = |index, env_steps| {
        let experiment = corridor(
            "S......G\n",
            &[
                "run.actors=2",
                "exploration.epsilon_start=1",
                "exploration.epsilon_end=0",
                "exploration.epsilon_decay_steps=64",
            ],
        );
        let acting = Acting::of_weights(always(&experiment, 1));
        let mut batch = Batch::default();
        let order = Collect { env_steps, ..order(1, 64) };
        Worker::new(&experiment, index).unwrap().collect(&acting, &order, &mut batch).unwrap();
        actions(&batch).contains(&0)
    };
    assert!(explores(0, 0));
    // The second actor's first step is the 65th of the round.
    assert!(!explores(1, 0));
    assert!(!explores(0, 64));
    assert!(!explores(1, u64::MAX));
}

#[test]
fn a_restored_actor_makes_the_same_batches() {
    let experiment = experiment(&["env.step_limit=90"]);
    let params = random_params(&experiment);
    let mut worker = Worker::new(&experiment, 0).unwrap();
    for first in [1, 8, 15] {
        batches(&mut worker, &params, first, 7, 13);
        let bytes = worker.snapshot().unwrap();
        let mut other = Worker::new(&experiment, 0).unwrap();
        batches(&mut other, &params, 1, 2, 10);
        other.restore(&bytes).unwrap();
        assert_eq!(other.snapshot().unwrap(), bytes);
        let went_on = batches(&mut other, &params, first + 7, 20, 13);
        worker.restore(&bytes).unwrap();
        assert_eq!(batches(&mut worker, &params, first + 7, 20, 13), went_on);
        worker.restore(&bytes).unwrap();
    }
}

#[test]
fn an_evaluation_disturbs_nothing_and_repeats() {
    let experiment = experiment(&["env.step_limit=60"]);
    let params = random_params(&experiment);
    let mut quiet = Worker::new(&experiment, 0).unwrap();
    let mut evaluating = Worker::new(&experiment, 0).unwrap();
    let mut seen = Vec::new();
    for t in 1..10 {
        let before = evaluating.snapshot().unwrap();
        seen.push(evaluating.evaluate(&params, 0, 2).unwrap());
        assert_eq!(evaluating.snapshot().unwrap(), before);
        assert_eq!(batches(&mut evaluating, &params, t, 1, 16), batches(&mut quiet, &params, t, 1, 16));
    }
    assert!(seen.windows(2).all(|pair| pair[0] == pair[1]));
}

#[test]
fn greedy_episodes_are_reported_as_they_were_played() {
    let played = |layout: &str, action| {
        let experiment = corridor(layout, &["exploration.epsilon_end=1"]);
        let params = always(&experiment, action);
        let evaluation = Worker::new(&experiment, 0).unwrap().evaluate(&params, 3, 2).unwrap();
        assert_eq!((evaluation.evaluation, evaluation.episodes.len()), (3, 2));
        assert_eq!(evaluation.episodes[0], evaluation.episodes[1]);
        evaluation.episodes[0].clone()
    };
    let there = played("S..G\n", 1);
    assert!((there.episode.total_reward - 0.92).abs() < 1e-6);
    assert_eq!((there.episode.length, there.episode.success), (3, Some(true)));
    assert_eq!(there.path, [0.0, 0.0, 1.0, 0.0, 2.0, 0.0, 3.0, 0.0]);
    let stuck = played("S..G\n", 0);
    assert!((stuck.episode.total_reward + 7.0 * 0.75).abs() < 1e-6);
    assert_eq!((stuck.episode.length, stuck.episode.success, stuck.path), (7, Some(false), vec![0.0; 16]));
}

#[test]
fn a_path_without_room_is_left_out() {
    let experiment = corridor("S..G\n", &[]);
    let params = always(&experiment, 1);
    let mut worker = Worker::new(&experiment, 0).unwrap();
    let greedy = |policy: &mut Policy, _: Option<&mut Guide>, obs: &[f32]| policy.greedy(&params, obs);
    let mut path =
        |room| worker.play(greedy, &mut stream(0, Purpose::Evaluation, 0), room, 0).unwrap().path.len();
    assert_eq!((path(8), path(7), path(0)), (8, 0, 0));
}

#[test]
fn what_cannot_be_done_is_refused() {
    let experiment = experiment(&["run.actors=2"]);
    let params = random_params(&experiment);
    let refused = Worker::new(&experiment, 2).err().unwrap().to_string();
    assert_eq!(refused, "actor 2; accepted: 0 to 1");
    let mut foreign = experiment.clone();
    foreign.spec.best_return = None;
    assert!(matches!(Worker::new(&foreign, 0), Err(ActorError::Spec { .. })));

    let mut worker = Worker::new(&experiment, 0).unwrap();
    let before = worker.snapshot().unwrap();
    let mut batch = Batch::default();
    let acting = Acting::of_weights(params);
    let others = Acting { policy: vec![0.0], ..Acting::of_weights(acting.weights[1..].to_vec()) };
    let message = worker.collect(&others, &order(1, 8), &mut batch).unwrap_err().to_string();
    let rest = "known actions and";
    let expected = format!(
        "there are {} weights, 0 {rest} 1 parameters of a guiding policy to act with; this run has {} weights, 0 {rest} 0 \
         parameters of a guiding policy",
        others.weights.len(),
        acting.weights.len()
    );
    assert_eq!(message, expected);
    for amount in [0, MAX_ROLLOUT + 1] {
        assert!(matches!(
            worker.collect(&acting, &Collect { steps: amount, ..order(1, 8) }, &mut batch),
            Err(ActorError::Amount { what: "steps", .. })
        ));
    }
    let other = Worker::new(&experiment, 1).unwrap().snapshot().unwrap();
    let message = worker.restore(&other).unwrap_err().to_string();
    assert_eq!(message, "snapshot of actor 1, with 2 features; this is actor 0, with 2");
    assert!(matches!(worker.restore(&before[..9]), Err(ActorError::Snapshot(_))));
    assert_eq!(worker.snapshot().unwrap(), before);
}

#[derive(Clone, Copy)]
enum Doing {
    Collecting,
    Evaluating,
}

/// What `worker` refuses as it collects batches of 8 steps, or plays evaluations, and how many it got through before.
fn refusal(mut worker: Worker, params: &[f32], doing: Doing) -> (u64, String) {
    let (acting, mut batch) = (Acting::of_weights(params.to_vec()), Batch::default());
    for t in 1..100 {
        let outcome = match doing {
            Doing::Collecting => worker.collect(&acting, &order(t, 8), &mut batch),
            Doing::Evaluating => worker.evaluate(&acting.weights, t, 1).map(|_| ()),
        };
        if let Err(error) = outcome {
            return (t - 1, error.to_string());
        }
    }
    panic!("nothing is refused");
}

#[test]
fn numbers_that_are_not_finite_are_refused_by_name() {
    let hazardous = |kind: &str| {
        let kind = format!("env.hazard.kind={kind}");
        let experiment = corridor("S..G\n", &["run.actors=2", &kind, "env.hazard.after=20"]);
        (
            Worker::replacing(&experiment, 1, Incarnation::default()).unwrap(),
            random_params(&experiment),
            experiment,
        )
    };
    let (worker, params, experiment) = hazardous("nan-reward");
    let refused = "the environment of actor 1 gave a reward = NaN after 20 steps; accepted: finite numbers";
    assert_eq!(refusal(worker, &params, Doing::Collecting), (2, refused.into()));
    let (worker, _, _) = hazardous("nan-state");
    let refused = "the environment of actor 1 gave feature 1 of its state = NaN after 20 steps; accepted: finite numbers";
    assert_eq!(refusal(worker, &params, Doing::Collecting), (2, refused.into()));
    // Seven steps an evaluation, as west leads nowhere.
    let west = always(&experiment, 0);
    let refused = "the environment of actor 1 gave a reward = NaN in evaluation 3; accepted: finite numbers";
    assert_eq!(refusal(hazardous("nan-reward").0, &west, Doing::Evaluating), (2, refused.into()));
    let refused = "the environment of actor 1 gave feature 1 of its state = NaN in evaluation 3; accepted: finite numbers";
    assert_eq!(refusal(hazardous("nan-state").0, &west, Doing::Evaluating), (2, refused.into()));
    // From a snapshot on it comes later, at a step that says so.
    let (mut worker, ..) = hazardous("nan-reward");
    batches(&mut worker, &params, 1, 2, 8);
    let (mut other, ..) = hazardous("nan-reward");
    other.restore(&worker.snapshot().unwrap()).unwrap();
    let (got_through, refused) = refusal(other, &params, Doing::Collecting);
    assert!(got_through == 2 && refused.contains("after 36 steps"), "{got_through}: {refused}");
    for (value, finite) in [(f32::INFINITY, false), (f32::NEG_INFINITY, false), (f32::MAX, true)] {
        let check =
            |obs: f32, reward| check_numbers(0, Moment::Steps(0), Element::F32, &[obs], reward).is_ok();
        assert_eq!((check(0.0, value), check(value, 0.0)), (finite, finite));
    }
    let refused =
        check_numbers(1, Moment::Steps(9), Element::U8, &[255.0, 0.5], -0.5).unwrap_err().to_string();
    assert!(
        refused.contains("feature 1 of its state = 0.5 after 9 steps; accepted: whole numbers from 0"),
        "{refused}"
    );
    assert!(check_numbers(1, Moment::Steps(9), Element::U8, &[255.0, 0.0], -0.5).is_ok());
}

/// An experiment's hazard strikes in the processes of its run. A process that only looks at the run is spared.
#[test]
fn a_hazard_strikes_in_the_processes_of_its_run_alone() {
    let with = |during: &str| {
        let during = format!("env.hazard.during={during}");
        corridor("S..G\n", &["env.hazard.kind=error", "env.hazard.after=20", &during])
    };
    let params = random_params(&with("both"));
    let mut outside = Worker::new(&with("both"), 0).unwrap();
    assert_eq!(batches(&mut outside, &params, 1, 10, 8).len(), 10);
    let west = always(&with("both"), 0);
    let refused = "env.hazard: the error that was asked for, after 20 steps of the process";
    for (during, doing) in [
        ("both", Doing::Collecting),
        ("both", Doing::Evaluating),
        ("training", Doing::Collecting),
        ("evaluation", Doing::Evaluating),
    ] {
        let worker = Worker::replacing(&with(during), 0, Incarnation::default()).unwrap();
        assert_eq!(refusal(worker, &west, doing), (2, refused.into()), "{during}");
    }
    let mut training = Worker::replacing(&with("training"), 0, Incarnation::default()).unwrap();
    assert!((1..10).all(|number| training.evaluate(&west, number, 1).is_ok()));
    let mut evaluating = Worker::replacing(&with("evaluation"), 0, Incarnation::default()).unwrap();
    assert_eq!(batches(&mut evaluating, &params, 1, 10, 8).len(), 10);
}

#[test]
fn both_encodings_give_a_network_that_acts() {
    for encoding in ["coordinates", "one-hot"] {
        let experiment = experiment(&[&format!("env.encoding={encoding}"), "learner.hidden=[16]"]);
        let params = random_params(&experiment);
        let made = batches(&mut Worker::new(&experiment, 0).unwrap(), &params, 1, 2, 32);
        assert!(actions(&made[1]).iter().any(|&action| action != actions(&made[1])[0]));
    }
}
