//! The loop of free mode against actors that the test plays.

#![allow(clippy::unwrap_used)]

use super::*;
use crate::plan;
use crate::testing::{World, demonstration};
use std::sync::mpsc::channel;
use std::thread;
use trestle_link::ActorLink;
use trestle_link::local::{self, LocalActor, Seat};
use trestle_link::{MentorHandler, MentorLink};
use trestle_proto::NONE;
use trestle_proto::batch::{BatchHeader, TERMINATED, Transition};
use trestle_proto::episode::Episode;
use trestle_proto::observe::{ObserveAnswer, ObserveRequest, Observed};
use trestle_proto::query::{OK, OUT_OF_ORDER, QueryAnswer};
use trestle_proto::reply::{EvaluationEpisode, ReplyHeader};
use trestle_proto::rundir::RunDir;

const ROLLOUT: u32 = 4;

/// An actor that the test plays.
struct Played<'a> {
    plan: &'a RunPlan,
    index: u32,
    link: LocalActor<Seat>,
    world: World,
}

impl Played<'_> {
    fn joins(&mut self, incarnation: u32) {
        let (run, incarnation) = (self.plan.life.run, incarnation.into());
        let header =
            ReplyHeader { run, actor: self.index, kind: JOINED, incarnation, ..ReplyHeader::default() };
        self.link.send_reply(&Reply { header, payload: Vec::new() }).unwrap();
    }

    /// Sends a batch whose first transition has number `first_seq`.
    fn sends(&mut self, incarnation: u32, first_seq: u64, count: u32) {
        let mut batch = self.world.batch(self.index, count).0.into_inner();
        let run = self.plan.life.run;
        batch.header = BatchHeader { run, incarnation: incarnation.into(), first_seq, ..batch.header };
        self.link.send_batch(&batch).unwrap();
    }

    fn evaluates(&mut self, evaluation: u64, total_reward: f64) {
        let header = ReplyHeader {
            run: self.plan.life.run,
            number: evaluation + 1,
            actor: self.index,
            kind: EVALUATION,
            ..ReplyHeader::default()
        };
        let episode = Episode { total_reward, length: 1, success: Some(false) };
        let episodes = vec![EvaluationEpisode { episode, ..EvaluationEpisode::default() }];
        let evaluation = Evaluation { evaluation, episodes, guide_return: None };
        let payload = codec::encode(EVALUATION_KIND, &evaluation).unwrap();
        self.link.send_reply(&Reply { header, payload }).unwrap();
    }

    /// Waits until the orders for `incarnation` say that so many of its batches have been counted. False: the learner
    /// has left.
    fn is_counted(&mut self, incarnation: u32, batches: u64) -> bool {
        for _ in 0..50 {
            let Some(orders) = self.link.recv_orders(WAIT_SLICE).unwrap() else { continue };
            if orders.stop == 1 {
                return false;
            }
            if orders.evaluation > 0 && self.index == 0 {
                self.evaluates(orders.evaluation - 1, 0.0);
            }
            let share = orders.shares[self.index as usize];
            if share.incarnation == incarnation.into() && share.counted == batches && share.granted > batches
            {
                return true;
            }
        }
        panic!("no orders for incarnation {incarnation} with {batches} batches");
    }
}

/// A run of one actor, which `play` plays, with two batches to be on their way at the most.
fn played(play: impl FnOnce(&mut Played<'_>) + Send) -> Result<RunResult, RunError> {
    played_with(&["eval.every=1000000"], |actors| play(&mut actors[0]))
}

/// The same of several actors, by `sets`.
fn played_with(sets: &[&str], play: impl FnOnce(&mut [Played<'_>]) + Send) -> Result<RunResult, RunError> {
    let all = ["run.algo=dqn", "run.mode=free", "run.rollout=4", "run.env_steps=20"];
    let plan = plan(&[&all[..], sets].concat());
    let dir = tempfile::tempdir().unwrap();
    let dir = RunDir::new(dir.path());
    let (mut learner, _mentor, actors) = local::connect(&plan);
    thread::scope(|scope| {
        let plan = &plan;
        let actor = |(index, link)| Played { plan, index, link, world: World::new(&plan.experiment, 1) };
        let mut actors: Vec<_> = (0..).zip(actors).map(actor).collect();
        scope.spawn(move || play(&mut actors));
        run(&mut learner, plan, &dir, &|| false, Box::new(|_| {}))
    })
}

fn refusal(play: impl FnOnce(&mut Played<'_>) + Send) -> String {
    played(play).unwrap_err().to_string()
}

#[test]
fn a_batch_is_counted_once() {
    let twice = refusal(|actor| {
        actor.joins(0);
        assert!(actor.is_counted(0, 0));
        actor.sends(0, 0, ROLLOUT);
        actor.sends(0, 0, ROLLOUT);
    });
    assert!(twice.contains("a batch of actor 0 from number 0 on; 4 is the next"), "{twice}");
    let gap = refusal(|actor| {
        actor.joins(0);
        assert!(actor.is_counted(0, 0));
        actor.sends(0, 0, ROLLOUT);
        assert!(actor.is_counted(0, 1));
        actor.sends(0, 8, ROLLOUT);
    });
    assert!(gap.contains("a batch of actor 0 from number 8 on; 4 is the next"), "{gap}");
}

#[test]
fn what_no_actor_of_this_start_sends_is_refused() {
    let short = refusal(|actor| {
        actor.joins(0);
        assert!(actor.is_counted(0, 0));
        actor.sends(0, 0, ROLLOUT - 1);
    });
    assert!(short.contains("with 3 transitions, after 0 batches; it is granted 2 of 4"), "{short}");
    let foreign = refusal(|actor| actor.joins(1 << 16));
    assert!(foreign.contains("incarnation 65536 of actor 0"), "{foreign}");
}

#[test]
fn batches_of_a_replaced_actor_are_dropped() {
    let result = played(|actor| {
        actor.sends(0, 0, ROLLOUT);
        actor.joins(0);
        assert!(actor.is_counted(0, 0), "what came before the actor had announced itself is not counted");
        actor.sends(0, 0, ROLLOUT);
        assert!(actor.is_counted(0, 1));
        actor.joins(1);
        actor.sends(0, 4, ROLLOUT);
        assert!(actor.is_counted(1, 0));
        for batch in 0..4 {
            actor.sends(1, 4 * batch, ROLLOUT);
            // An announcement that comes twice changes nothing.
            actor.joins(1);
            assert!(actor.is_counted(1, batch + 1));
        }
        assert!(!actor.is_counted(1, 5), "the run is over");
    });
    assert_eq!(result.unwrap().env_steps, 20);
}

/// Sends what is left of the run's 20 steps, `counted` batches of which have been.
fn sends_the_rest(actor: &mut Played<'_>, counted: u64) {
    for batch in counted..5 {
        actor.sends(0, 4 * batch, ROLLOUT);
        if batch < 4 {
            assert!(actor.is_counted(0, batch + 1));
        }
    }
}

/// Waits for orders that ask for an evaluation.
fn awaits_evaluation(actor: &mut Played<'_>) -> u64 {
    for _ in 0..50 {
        if let Some(orders) = actor.link.recv_orders(WAIT_SLICE).unwrap()
            && orders.evaluation > 0
        {
            return orders.evaluation - 1;
        }
    }
    panic!("nobody asks for an evaluation");
}

#[test]
fn what_was_played_for_another_learner_does_not_count() {
    let result = played_with(&["run.actors=2", "eval.every=1000000"], |actors| {
        let [player, other] = actors else { panic!("two actors") };
        other.joins(0);
        assert!(other.is_counted(0, 0));
        sends_the_rest(other, 0);
        let evaluation = awaits_evaluation(player);
        // With the weights of a learner that is gone, and then with those of this one.
        player.evaluates(evaluation, 7.0);
        player.joins(0);
        player.evaluates(evaluation, 1.0);
    });
    assert_eq!(result.unwrap().final_return, Some(1.0));
}

/// One that becomes due while the one before is awaited has to wait, and is played with the weights that there are then.
#[test]
fn an_evaluation_that_has_waited_is_of_the_moment_in_which_it_is_asked_for() {
    let plan = plan(&["run.algo=dqn", "run.mode=free", "eval.every=1"]);
    let place = tempfile::tempdir().unwrap();
    let dir = RunDir::new(place.path());
    let mut session = Session::new(&plan, &dir, None, Box::new(|_| {})).unwrap();
    session.start();
    let mut batch = Batch::default();
    for (round, flags) in [(1, TERMINATED), (2, 0), (3, 0)] {
        batch.prepare(BatchHeader { count: 1, obs_dim: 2, ..BatchHeader::default() });
        batch.set(0, &Transition { obs: &[0.0; 2], next_obs: &[0.0; 2], action: 0, reward: 0.0, flags });
        session.ingest(&batch.clone().check(&plan.experiment.spaces()).unwrap(), None).unwrap();
        session.train(round.into()).unwrap();
    }
    let (number, _) = session.evaluate().unwrap();
    let episode = Episode { total_reward: 0.0, length: 1, success: Some(false) };
    let episodes = vec![EvaluationEpisode { episode, ..EvaluationEpisode::default() }];
    session.evaluated(&Evaluation { evaluation: number, episodes, guide_return: None }).unwrap();
    let rows = std::fs::read_to_string(dir.evals()).unwrap();
    assert_eq!(rows.lines().last().unwrap().split(',').nth(1), Some("3"), "{rows}");
}

/// A mentor-server that finds nothing similar, and refuses a batch that does not continue its history.
struct Strict {
    mentor: MentorTransitions,
    next_index: u64,
}

impl MentorHandler for Strict {
    fn forget(&mut self) {}

    fn observe(&mut self, request: &ObserveRequest, mut words: &[u32], out: &mut Vec<u32>) -> ObserveAnswer {
        if request.first_index != self.next_index {
            return ObserveAnswer { status: OUT_OF_ORDER, ..ObserveAnswer::default() };
        }
        while let Some(part) = Part::take(&mut words, 2) {
            self.next_index += u64::from(part.count);
            let mentor = vec![NONE; part.count as usize];
            Observed { mentor, ..Observed::default() }.encode(2, out);
        }
        ObserveAnswer { first_index: request.first_index, ..ObserveAnswer::default() }
    }

    fn query(&mut self, request: &QueryRequest, _: &[f32], out: &mut Vec<u32>) -> QueryAnswer {
        assert_eq!((request.op, request.first), (TRANSITIONS, 0));
        (0..self.mentor.len()).for_each(|j| self.mentor.encode(j, out));
        QueryAnswer { status: OK, count: self.mentor.len() as u32 }
    }
}

/// Batches that come together with the one in which the run ends are not asked about, nor counted.
#[test]
fn a_run_with_a_mentor_ends_within_what_has_come() {
    let sets =
        ["run.algo=ha-diiqn", "run.mode=free", "run.rollout=4", "run.env_steps=6", "eval.every=1000000"];
    let plan = plan(&sets);
    let dir = tempfile::tempdir().unwrap();
    let dir = RunDir::new(dir.path());
    let (mut learner, mut mentor, mut actors) = local::connect(&plan);
    let (over, is_over) = channel::<()>();
    let result = thread::scope(|scope| {
        let plan = &plan;
        scope.spawn(move || {
            let mut strict = Strict { mentor: demonstration(&plan.experiment).unwrap(), next_index: 0 };
            while is_over.try_recv() == Err(std::sync::mpsc::TryRecvError::Empty) {
                // The learner's end is gone when the run is over.
                if mentor.serve(&mut strict, WAIT_SLICE).is_err() {
                    break;
                }
            }
        });
        let link = actors.remove(0);
        let mut actor = Played { plan, index: 0, link, world: World::new(&plan.experiment, 1) };
        scope.spawn(move || {
            actor.joins(0);
            assert!(actor.is_counted(0, 0));
            // The window; the run ends in the middle of the second.
            actor.sends(0, 0, ROLLOUT);
            actor.sends(0, 4, ROLLOUT);
            let evaluation = awaits_evaluation(&mut actor);
            actor.evaluates(evaluation, 0.0);
        });
        let result = run(&mut learner, plan, &dir, &|| false, Box::new(|_| {}));
        drop((learner, over));
        result
    });
    assert_eq!(result.unwrap().env_steps, 6);
}
