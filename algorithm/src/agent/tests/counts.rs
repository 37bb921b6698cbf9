//! Limits, episodes, refusals, schedules.

use super::{SPACES, agent, live};
use crate::agent::{Agent, AgentError, TrainStats};
use crate::testing::{MENTOR_LEN, demonstration, experiment};
use proptest::prelude::*;
use trestle_proto::NONE;
use trestle_proto::batch::{Batch, BatchHeader, Checked, SUCCEEDED, TERMINATED, TRUNCATED, Transition};
use trestle_proto::mentor::MentorTransitions;

const DQN: &str = "run.algo=dqn";

/// A batch of actor `actor` with these rewards and flags.
fn batch(actor: u32, steps: &[(f32, u32)]) -> Checked<Batch> {
    let mut batch = Batch::default();
    batch.prepare(BatchHeader { actor, count: steps.len() as u32, obs_dim: 2, ..BatchHeader::default() });
    for (index, &(reward, flags)) in steps.iter().enumerate() {
        let obs = [index as f32, 0.0];
        batch.set(index, &Transition { obs: &obs, next_obs: &obs, action: 1, reward, flags });
    }
    batch.check(&SPACES).unwrap()
}

#[test]
fn episodes_of_several_actors_are_kept_apart() {
    let (mut agent, _) = agent(&[DQN, "run.actors=2"], 0);
    agent.ingest(&batch(0, &[(1.0, 0), (2.0, TERMINATED), (4.0, 0)]), None).unwrap();
    agent.ingest(&batch(1, &[(8.0, 0), (16.0, 0)]), None).unwrap();
    agent.ingest(&batch(0, &[(32.0, TRUNCATED)]), None).unwrap();
    let ingested = agent.ingest(&batch(1, &[(64.0, TERMINATED | SUCCEEDED)]), None).unwrap();
    assert_eq!(ingested.consumed, 1);
    let last = ingested.finished[0];
    assert_eq!((last.actor, last.episode.total_reward, last.episode.length), (1, 88.0, 3));
    assert_eq!(last.episode.success, Some(true));
    assert_eq!((last.counters.episodes, last.counters.env_steps, last.counters.grad_steps), (3, 7, 0));
    assert_eq!(agent.counters(), last.counters);
}

#[test]
fn a_run_ends_exactly_at_its_limits() {
    // The end by termination is a failure: the environment does not call it a success.
    let steps = [(1.0, 0), (1.0, TERMINATED), (1.0, TERMINATED | SUCCEEDED), (1.0, 0)];
    let (mut by_episodes, _) = agent(&[DQN, "run.episodes=3"], 0);
    assert_eq!(by_episodes.ingest(&batch(0, &steps), None).unwrap().consumed, 4);
    assert!(!by_episodes.done());
    let last = by_episodes.ingest(&batch(0, &steps), None).unwrap();
    assert_eq!((last.consumed, last.finished.len()), (2, 1));
    assert!(by_episodes.done() && last.finished[0].episode.success == Some(false));
    assert_eq!(by_episodes.replay().len(), 6);
    assert_eq!(by_episodes.ingest(&batch(0, &steps), None).unwrap().consumed, 0);

    let (mut by_steps, _) = agent(&[DQN, "run.env_steps=6"], 0);
    by_steps.ingest(&batch(0, &steps), None).unwrap();
    assert_eq!(by_steps.ingest(&batch(0, &steps), None).unwrap().consumed, 2);
    assert!(by_steps.done());
    assert_eq!(by_steps.counters().env_steps, 6);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]
    /// Gradient steps are those that the schedule owes, however the steps are cut into ticks.
    #[test]
    fn as_many_gradient_steps_as_are_due(cuts in prop::collection::vec(1u32..20, 1..8), algo in 0usize..2) {
        let (mut agent, mut world) = agent(&[["run.algo=dqn", "run.algo=ha-diiqn"][algo]], 5);
        let mut total = TrainStats::default();
        for cut in cuts {
            let (batch, observed) = world.batch(0, cut);
            agent.ingest(&batch, observed.as_ref()).unwrap();
            total.merge(&agent.train(|| ()).unwrap());
        }
        let due = agent.counters().env_steps.saturating_sub(16) / 2;
        prop_assert_eq!(total.grad_steps, due);
        prop_assert_eq!(agent.counters().grad_steps, due);
        prop_assert_eq!(agent.adam().step, due);
        prop_assert_eq!(total.samples, due * 8);
        prop_assert!(total.feasible + total.bridged <= total.with_mentor && total.with_mentor <= total.samples);
        prop_assert_eq!(agent.train(|| ()).unwrap(), TrainStats::default());
    }
}

#[test]
fn equal_runs_have_equal_weights_and_others_do_not() {
    let weights = |sets: &[&str], seed| {
        let (mut agent, mut world) = agent(sets, seed);
        live(&mut agent, &mut world, 40);
        agent.weights_sha256()
    };
    let base = weights(&[], 1);
    assert_eq!(base.len(), 64);
    assert_eq!(base, weights(&[], 1));
    for other in ["run.seed=1", "run.algo=diiqn", "mentor.selection=confidence", "learner.double=false"] {
        assert_ne!(base, weights(&[other], 1), "{other}");
    }
    assert_ne!(base, weights(&[], 2));
}

#[test]
fn the_target_network_follows_as_asked() {
    let (mut hard, mut world) = agent(&[DQN, "learner.target=hard", "learner.target_every=5"], 3);
    let initial = hard.weights().to_vec();
    let target = |agent: &Agent| agent.network().with_params(|_, target| target.to_vec()).unwrap();
    // 24 steps, 4 of them training; then 4 gradient steps more: the fifth copies.
    live(&mut hard, &mut world, 3);
    assert_eq!((hard.counters().grad_steps, target(&hard)), (4, initial.clone()));
    live(&mut hard, &mut world, 1);
    let copied = target(&hard);
    assert!(copied != initial && copied != hard.weights());
    live(&mut hard, &mut world, 1);
    assert_ne!(target(&hard), copied);

    let (mut soft, mut world) = agent(&[DQN, "learner.target=polyak", "learner.tau=1.0"], 3);
    live(&mut soft, &mut world, 4);
    assert_eq!(target(&soft), soft.weights());
}

#[test]
fn what_does_not_fit_the_plan_is_refused() {
    let with = experiment(&[]);
    let message = |result: Result<Agent, AgentError>| result.unwrap_err().to_string();
    assert!(message(Agent::new(&with, None)).contains("mentor transitions is 0; accepted: 6"));
    let other = MentorTransitions::new(3);
    assert!(message(Agent::new(&with, Some(other))).contains("accepted: 6"));
    let without = experiment(&[DQN]);
    assert!(message(Agent::new(&without, demonstration(&with))).contains("run.algo = dqn"));

    let (mut agent, mut world) = agent(&[], 0);
    let (good, observed) = world.batch(0, 4);
    let observed = observed.unwrap();
    let mut refused = |observed| agent.ingest(&good, observed).unwrap_err().to_string();
    assert!(refused(None).contains("answers is 0; accepted: 1"));
    let mut short = observed.clone();
    short.mentor.pop();
    assert!(refused(Some(&short)).contains("mentor indices is 3; accepted: 4"));
    let mut broken = observed.clone();
    broken.changed.pop();
    assert!(refused(Some(&broken)).contains("not a multiple"));
    assert!(agent.replay().is_empty());
    assert_eq!(agent.ingest(&good, Some(&observed)).unwrap().consumed, 4);
}

#[test]
fn divergence_is_reported() {
    let (mut agent, mut world) = agent(&[DQN, "learner.loss=squared", "learner.lr=1e30"], 0);
    let fault = (0..20).find_map(|_| {
        let (batch, _) = world.batch(0, 8);
        agent.ingest(&batch, None).unwrap();
        agent.train(|| ()).err()
    });
    assert!(matches!(fault, Some(AgentError::Diverged { .. })), "{fault:?}");
}

#[test]
fn the_summary_counts_what_training_would_use() {
    let (mut agent, mut world) = agent(&[], 4);
    assert_eq!(agent.mentor_summary(0..MENTOR_LEN).unwrap().feasible, 0);
    assert!(agent.mentor_summary(0..MENTOR_LEN).unwrap().e_kl_mean.is_nan());
    live(&mut agent, &mut world, 30);
    let summary = agent.mentor_summary(0..MENTOR_LEN).unwrap();
    let table = agent.annotations().unwrap();
    let feasible = table.errors().iter().filter(|&&e| e < 0.1).count();
    let bridged = (0..MENTOR_LEN).filter(|&j| table.errors()[j] >= 0.1 && table.bridge(j).is_some()).count();
    assert_eq!((summary.len, summary.feasible, summary.bridged), (MENTOR_LEN, feasible, bridged));
    assert!(feasible > 0 && bridged > 0, "{summary:?}");
    assert_eq!(summary.bridge_len_mean, 2.0);
}

/// Without counting nothing would ever be trusted.
#[test]
fn confidence_counts_the_samples_with_a_mentors_loss() {
    let (mut agent, mut world) = agent(&["mentor.selection=confidence", "mentor.c_max=20"], 6);
    let mut total = TrainStats::default();
    for _ in 0..20 {
        let (batch, observed) = world.batch(0, 8);
        agent.ingest(&batch, observed.as_ref()).unwrap();
        total.merge(&agent.train(|| ()).unwrap());
    }
    let trained = agent.selection().unwrap();
    let sum: u64 = trained.as_chunks::<4>().0.iter().map(|&word| u64::from(u32::from_le_bytes(word))).sum();
    assert_eq!(sum, total.feasible + total.bridged);
    assert!(total.mentor_frac() > 0.05 && total.mentor_frac() < 1.0, "{}", total.mentor_frac());
}

/// Visits by what was picked, uses by what was trained; both as they were after a restoration.
#[test]
fn visits_and_uses_are_counted() {
    for selection in ["confidence", "min-distance"] {
        let selection = format!("mentor.selection={selection}");
        let (mut agent, mut world) = agent(&[&selection], 6);
        let (mut visited, mut total) = ([0; MENTOR_LEN], TrainStats::default());
        for _ in 0..20 {
            let (batch, observed) = world.batch(0, 8);
            let observed = observed.unwrap();
            observed.mentor.iter().filter(|&&j| j != NONE).for_each(|&j| visited[j as usize] += 1);
            agent.ingest(&batch, Some(&observed)).unwrap();
            total.merge(&agent.train(|| ()).unwrap());
        }
        let rows: Vec<_> = agent.mentor_rows().unwrap().collect();
        assert_eq!(rows.iter().map(|row| row.visited).collect::<Vec<_>>(), visited);
        let used: u64 = rows.iter().map(|row| row.used).sum();
        if selection.ends_with("min-distance") {
            assert_eq!(used as f64, total.mentor_weight_sum);
        }
        assert!(used > 0 && used <= total.feasible + total.bridged, "{used} {total:?}");
        let table = agent.annotations().unwrap();
        assert!((0..MENTOR_LEN).all(|j| rows[j].feasible == (table.errors()[j] < 0.1)));
        assert!(rows.iter().enumerate().all(|(j, row)| row.first == (j == 0)));
    }
}

#[test]
fn own_paths_are_published_and_imitated() {
    let learned = ["mentor.learned.features=[0]", "mentor.learned.radius=1"];
    let sets = |algo, more| [&[algo], &learned[..], more].concat();
    let (mut agent, mut world) = agent(&sets("run.algo=trestle", &[]), 3);
    let mut stats = TrainStats::default();
    for _ in 0..20 {
        let (batch, _) = world.batch(0, 8);
        agent.ingest(&batch, None).unwrap();
        stats.merge(&agent.train(|| ()).unwrap());
    }
    assert!(agent.own_paths() > 0 && agent.own_paths() == agent.acting().own.lengths.len());
    let places: u32 = agent.acting().own.lengths.iter().sum();
    assert_eq!(agent.acting().own.places.len(), places as usize);
    assert!((1..=stats.grad_steps).contains(&stats.imitation_steps) && stats.imitation_loss_mean() > 0.0);
    assert_eq!(stats.policy_steps, stats.grad_steps);
    // Without imitation the same paths are kept, and the weights are others.
    let (mut other, mut world) = super::agent(&sets("run.algo=trestle", &["mentor.learned.imitate=0"]), 3);
    live(&mut other, &mut world, 20);
    assert_eq!(other.acting().own, agent.acting().own);
    assert_ne!(other.weights(), agent.weights());
}
