//! The loop of the learner's process in free mode: take in what has come from any actor, learn from it, publish weights,
//! grant more. Actors and the mentor-server may be replaced meanwhile, and this process may itself have taken another's
//! place: then the actors learn of it from the first orders, and announce themselves anew.

use crate::record::RunResult;
use crate::run::{RunError, rebuild_mentor, request};
use crate::session::Session;
use std::time::{Duration, Instant};
use trestle_link::pulse;
use trestle_link::{FromActor, LearnerLink, LinkError, Stop};
use trestle_proto::batch::Batch;
use trestle_proto::codec;
use trestle_proto::limits::WAIT_SLICE;
use trestle_proto::observe::{OBSERVE, Observed};
use trestle_proto::orders::{Orders, Share};
use trestle_proto::plan::RunPlan;
use trestle_proto::query::{NOT_READY, status_text};
use trestle_proto::reply::{EVALUATION, EVALUATION_KIND, Evaluation, JOINED, Reply};

/// Trains `session` to its end over `link`, whose mentor-server is ready, or until `stop` says so.
///
/// # Errors
/// What the peers send that cannot be right, a mentor-server that does not come back, training that diverges, or a file
/// that cannot be written.
pub(crate) fn run<L: LearnerLink>(
    link: &mut L,
    plan: &RunPlan,
    session: Session<'_>,
    stop: Stop<'_>,
) -> Result<RunResult, RunError> {
    let rollout = plan.config.run.rollout as usize;
    let actors = plan.config.run.actors as usize;
    Free {
        link,
        plan,
        session,
        batches: vec![Batch::with_capacity(rollout, plan.spec.obs_dim()); actors],
        observed: Observed::default(),
        actors: vec![None; actors],
        orders: Orders { run: plan.run, generation: plan.generation.into(), ..Orders::default() },
        saved: plan.resume_tick,
        stop,
    }
    .run()
}

/// The present incarnation of an actor.
#[derive(Clone, Copy)]
struct Incarnation {
    number: u32,
    /// Batches that have been counted.
    batches: u64,
    /// The actor's own number of its next transition.
    next_seq: u64,
}

struct Free<'a, L> {
    link: &'a mut L,
    plan: &'a RunPlan,
    session: Session<'a>,
    /// A batch has the place of its actor.
    batches: Vec<Batch>,
    observed: Observed,
    /// None until it has announced itself.
    actors: Vec<Option<Incarnation>>,
    /// As published last.
    orders: Orders,
    /// The round of the last checkpoint.
    saved: Option<u64>,
    stop: Stop<'a>,
}

impl<L: LearnerLink> Free<'_, L> {
    fn run(mut self) -> Result<RunResult, RunError> {
        self.session.start()?;
        if self.plan.resume_tick.is_some() && self.plan.mentor_len() > 0 && !self.give_history(false)? {
            return self.leave(true);
        }
        self.publish_weights()?;
        self.publish_orders()?;
        while !self.session.done() {
            let before = self.session.agent().counters().env_steps;
            self.receive()?;
            let after = self.session.agent().counters().env_steps;
            if after > before {
                self.session.train(self.session.tick() + 1)?;
                self.publish_weights()?;
            }
            let leaving = (self.stop)();
            if leaving || self.session.checkpoint_due(before, after) {
                self.checkpoint()?;
            }
            if leaving {
                tracing::info!("interrupted: what has come is learnt from and saved");
                return self.leave(true);
            }
            self.order_evaluation();
            self.publish_orders()?;
        }
        self.finish()
    }

    /// Takes in what has come; waits only if there is nothing. No more than all windows hold, so that learning goes on.
    fn receive(&mut self) -> Result<(), RunError> {
        let most = self.plan.window() * self.actors.len() as u64;
        let start = Instant::now();
        let mut timeout = WAIT_SLICE;
        for _ in 0..most {
            let message = self.link.recv(&mut self.batches, timeout)?;
            if !timeout.is_zero() {
                self.session.waited(start.elapsed());
            }
            let Some(message) = message else {
                pulse::step();
                break;
            };
            timeout = Duration::ZERO;
            self.take(message)?;
            if self.session.done() {
                break;
            }
        }
        if self.link.mentor_waits() {
            self.give_history(true)?;
        }
        Ok(())
    }

    fn take(&mut self, message: FromActor) -> Result<(), RunError> {
        match message {
            FromActor::Batch(actor) => self.take_batch(actor),
            FromActor::Reply(reply) => self.take_reply(&reply),
        }
    }

    fn take_reply(&mut self, reply: &Reply) -> Result<(), RunError> {
        let (actor, tick) = (reply.header.actor, reply.header.tick);
        match reply.header.kind {
            JOINED => {
                let number = u32::try_from(tick).unwrap_or(u32::MAX);
                let (generation, present) = (number >> 16, u32::from(self.plan.generation));
                if generation > present {
                    return Err(LinkError::Unexpected(format!("incarnation {tick} of actor {actor}")).into());
                }
                if generation < present {
                    // It has not heard of this learner yet.
                    return Ok(());
                }
                let present = &mut self.actors[actor as usize];
                if present.is_none_or(|present| present.number < number) {
                    *present = Some(Incarnation { number, batches: 0, next_seq: 0 });
                    self.session.joined(actor, number);
                    tracing::info!(actor, incarnation = number, "an actor has come");
                }
                Ok(())
            }
            EVALUATION => {
                let evaluation: Evaluation = codec::decode(EVALUATION_KIND, &reply.payload)?;
                // An actor and the one that replaces it may both have played the same. One that has not announced itself to this
                // learner has played it with another one's weights.
                let announced = self.actors[actor as usize].is_some();
                if announced && self.orders.evaluation.checked_sub(1) == Some(evaluation.evaluation) {
                    self.session.evaluated(&evaluation)?;
                    self.orders.evaluation = 0;
                }
                Ok(())
            }
            kind => Err(LinkError::Unexpected(format!("a reply of kind {kind} from actor {actor}")).into()),
        }
    }

    /// Takes `actor`'s batch in, unless it is of an incarnation that has been replaced.
    fn take_batch(&mut self, actor: u32) -> Result<(), RunError> {
        let header = self.batches[actor as usize].header;
        let Some(present) =
            self.actors[actor as usize].filter(|present| present.number == header.incarnation)
        else {
            tracing::info!(actor, incarnation = header.incarnation, "a batch of a replaced actor is dropped");
            return Ok(());
        };
        if self.session.done() {
            return Ok(());
        }
        let (found, expected) = (header.first_seq, present.next_seq);
        if found != expected {
            let text = format!("a batch of actor {actor} from number {found} on; {expected} is the next");
            return Err(LinkError::Unexpected(text).into());
        }
        let (count, rollout) = (header.count, self.plan.config.run.rollout);
        if count != rollout || present.batches >= self.orders.granted(actor, present.number) {
            let text = format!(
                "a batch of actor {actor} with {count} transitions, after {} batches; it is granted {} of {rollout}",
                present.batches,
                self.orders.granted(actor, present.number)
            );
            return Err(LinkError::Unexpected(text).into());
        }
        let has_mentor = self.plan.mentor_len() > 0;
        if has_mentor && !self.observe(actor)? {
            return Ok(());
        }
        let batch = &self.batches[actor as usize];
        let counted = self.session.ingest(batch, has_mentor.then_some(&self.observed))?;
        self.session.count_batch(batch, counted);
        let (batches, next_seq) = (present.batches + 1, present.next_seq + batch.len() as u64);
        self.actors[actor as usize] = Some(Incarnation { batches, next_seq, ..present });
        Ok(())
    }

    /// Asks the mentor-server about `actor`'s batch, another one if it dies meanwhile. False: there is none, and the run is
    /// to end.
    fn observe(&mut self, actor: u32) -> Result<bool, RunError> {
        let batch = &self.batches[actor as usize];
        let (first, count) = (self.session.agent().counters().env_steps, batch.len());
        let request = request(self.plan, self.session.tick(), first, OBSERVE, actor, count);
        loop {
            let start = Instant::now();
            let payload = self.batches[actor as usize].payload();
            let answer = self.link.observe(&request, payload, &mut self.observed);
            self.session.waited(start.elapsed());
            match answer {
                Ok(()) => return Ok(true),
                Err(error) if is_lost_mentor(&error) => {
                    tracing::warn!("the mentor-server is lost: {error}");
                    if !self.give_history(true)? {
                        return Ok(false);
                    }
                }
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// Gives the mentor-server, which knows nothing, the history; where it is `lost`, or is lost meanwhile, the next one that
    /// comes. False: the run is to end first.
    fn give_history(&mut self, mut lost: bool) -> Result<bool, RunError> {
        loop {
            if lost {
                let start = Instant::now();
                let joined = self.link.rejoin_mentor(self.stop);
                self.session.waited(start.elapsed());
                match joined {
                    Err(LinkError::Interrupted(_)) => return Ok(false),
                    joined => joined?,
                }
            }
            match rebuild_mentor(self.link, self.plan, &self.session) {
                Ok(()) => break,
                Err(RunError::Link(error)) if is_lost_mentor(&error) => {
                    tracing::warn!("the mentor-server is lost: {error}");
                    lost = true;
                }
                Err(error) => return Err(error),
            }
        }
        tracing::info!("a new mentor-server has the history");
        Ok(true)
    }

    fn publish_weights(&mut self) -> Result<(), RunError> {
        Ok(self.link.send_weights(self.session.tick(), self.session.agent().acting())?)
    }

    /// Asks for the evaluation that is due, unless another one is still awaited. The weights have been published.
    fn order_evaluation(&mut self) {
        if self.session.awaits_evaluation() {
            return;
        }
        if let Some(tick) = self.session.evaluate() {
            (self.orders.evaluation, self.orders.episodes) = (tick.evaluation + 1, tick.amount);
        }
    }

    /// Publishes what each actor may send. Also where nothing has changed: whoever has found no weights waits for it.
    fn publish_orders(&mut self) -> Result<(), RunError> {
        let mut orders = self.orders;
        orders.env_steps = self.session.agent().counters().env_steps;
        for (share, actor) in orders.shares.iter_mut().zip(&self.actors) {
            let Some(present) = actor else { continue };
            let (counted, granted) = (present.batches, present.batches + self.plan.window());
            *share = Share { counted, granted, incarnation: present.number, reserved: 0 };
        }
        self.orders = orders;
        Ok(self.link.send_orders(&orders)?)
    }

    fn checkpoint(&mut self) -> Result<(), RunError> {
        // What has come since the last one need not be a batch, and checkpoints are told apart by their rounds.
        if self.saved == Some(self.session.tick()) {
            self.session.skip_round();
        }
        self.saved = Some(self.session.tick());
        // Actors begin a new episode when the run is resumed.
        let none = vec![Vec::new(); self.actors.len()];
        Ok(self.session.checkpoint(None, &none)?)
    }

    /// The run has reached its limits: a last evaluation, a last checkpoint, the result. One that is interrupted meanwhile
    /// still owes the evaluation.
    fn finish(mut self) -> Result<RunResult, RunError> {
        // Before the evaluation, too: whatever happens to the actor that plays it, the training is kept.
        self.checkpoint()?;
        if !self.await_evaluation()? {
            return self.leave(true);
        }
        self.session.request_final_evaluation();
        self.order_evaluation();
        self.publish_orders()?;
        if !self.await_evaluation()? {
            return self.leave(true);
        }
        self.checkpoint()?;
        self.leave(false)
    }

    /// False: the run is to end first.
    fn await_evaluation(&mut self) -> Result<bool, RunError> {
        while self.session.awaits_evaluation() {
            if (self.stop)() {
                return Ok(false);
            }
            match self.link.recv(&mut self.batches, WAIT_SLICE)? {
                Some(message) => self.take(message)?,
                None => pulse::step(),
            }
        }
        Ok(true)
    }

    fn leave(mut self, interrupted: bool) -> Result<RunResult, RunError> {
        self.orders.stop = 1;
        self.link.send_orders(&self.orders)?;
        Ok(self.session.finish(interrupted)?)
    }
}

/// Whether the mentor-server is gone, or one that has not been let in has taken its place.
fn is_lost_mentor(error: &LinkError) -> bool {
    match error {
        LinkError::Receivers { found, expected, .. } => found < expected,
        LinkError::Refused { reason, .. } => *reason == status_text(NOT_READY),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::testing::{World, plan};
    use std::thread;
    use trestle_link::ActorLink;
    use trestle_link::local::{self, LocalActor};
    use trestle_proto::batch::{BatchHeader, TERMINATED, Transition};
    use trestle_proto::reply::{EvaluationEpisode, ReplyHeader};
    use trestle_proto::rundir::RunDir;

    const ROLLOUT: u32 = 4;

    /// An actor that the test plays.
    struct Played<'a> {
        plan: &'a RunPlan,
        index: u32,
        link: LocalActor,
        world: World,
    }

    impl Played<'_> {
        fn joins(&mut self, incarnation: u64) {
            let header =
                ReplyHeader { run: self.plan.run, tick: incarnation, actor: self.index, kind: JOINED };
            self.link.send_reply(&Reply { header, payload: Vec::new() }).unwrap();
        }

        /// Sends a batch whose first transition has number `first_seq`.
        fn sends(&mut self, incarnation: u32, first_seq: u64, count: u32) {
            let (mut batch, _) = self.world.batch(self.index, count);
            let run = self.plan.run;
            batch.header = BatchHeader { run, incarnation, first_seq, ..batch.header };
            self.link.send_batch(&batch).unwrap();
        }

        fn evaluates(&mut self, evaluation: u64, total_reward: f64) {
            let header = ReplyHeader { run: self.plan.run, tick: 0, actor: self.index, kind: EVALUATION };
            let episode = EvaluationEpisode {
                total_reward,
                length: 1,
                terminated: false,
                success: Some(false),
                path: Vec::new(),
            };
            let evaluation = Evaluation { evaluation, episodes: vec![episode] };
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
                if share.incarnation == incarnation && share.counted == batches && share.granted > batches {
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
    fn played_with(
        sets: &[&str],
        play: impl FnOnce(&mut [Played<'_>]) + Send,
    ) -> Result<RunResult, RunError> {
        let all = ["run.algo=dqn", "run.mode=free", "run.rollout=4", "run.env_steps=20"];
        let plan = plan(&[&all[..], sets].concat());
        let dir = tempfile::tempdir().unwrap();
        let dir = RunDir::new(dir.path());
        let (mut learner, _mentor, actors) = local::connect(&plan);
        thread::scope(|scope| {
            let plan = &plan;
            let actor = |(index, link)| Played { plan, index, link, world: World::new(plan, 1) };
            let mut actors: Vec<_> = (0..).zip(actors).map(actor).collect();
            scope.spawn(move || play(&mut actors));
            let session = Session::new(plan, &dir, None, |_| {}).unwrap();
            run(&mut learner, plan, session, &|| false)
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
        let mut session = Session::new(&plan, &dir, None, |_| {}).unwrap();
        session.start().unwrap();
        let mut batch = Batch::default();
        for (round, flags) in [(1, TERMINATED), (2, 0), (3, 0)] {
            batch.prepare(BatchHeader { count: 1, obs_dim: 2, ..BatchHeader::default() });
            batch.set(0, &Transition { obs: &[0.0; 2], next_obs: &[0.0; 2], action: 0, reward: 0.0, flags });
            session.ingest(&batch, None).unwrap();
            session.train(round).unwrap();
        }
        let asked = session.evaluate().unwrap();
        assert_eq!(asked.weights_version, 3);
        let episode = EvaluationEpisode {
            total_reward: 0.0,
            length: 1,
            terminated: false,
            success: Some(false),
            path: Vec::new(),
        };
        session.evaluated(&Evaluation { evaluation: asked.evaluation, episodes: vec![episode] }).unwrap();
        let rows = std::fs::read_to_string(dir.evals()).unwrap();
        assert_eq!(rows.lines().last().unwrap().split(',').nth(1), Some("3"), "{rows}");
    }
}
