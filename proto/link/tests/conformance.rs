//! What every transport promises, as tests that run over each of them. A test is named after the property that it states.
#![allow(clippy::unwrap_used)]

mod canned;

use canned::{ACTORS, Canned, FURTHER, LONG, MENTOR, plan};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::Duration;
use trestle_link::iceoryx::SharedMemory;
use trestle_link::local::Threads;
use trestle_link::{
    ActorLink, ClientLink, FromActor, Host, LearnerLink, LinkError, Liveness, MentorLink, Transport,
};
use trestle_proto::NONE;
use trestle_proto::acting::{Acting, Options};
use trestle_proto::annotation::AnnotationTable;
use trestle_proto::batch::{Batch, BatchHeader, Checked, FIRST, Transition};
use trestle_proto::observe::{Answers, OBSERVE, ObserveRequest, Part};
use trestle_proto::orders::{Orders, Share};
use trestle_proto::plan::RunPlan;
use trestle_proto::query::{QueryRequest, SIMILAR, STATS};
use trestle_proto::reply::{ACTOR_STATE, Reply, ReplyHeader};
use trestle_proto::round::Round;

/// Makes a test of each property for each transport.
macro_rules! conformance {
    ($properties:tt $($name:ident: $transport:expr),+ $(,)?) => {
        $(conformance!(@one $name, $transport, $properties);)+
    };
    (@one $name:ident, $transport:expr, { $($property:ident),+ $(,)? }) => {
        mod $name {
            use super::*;
            $(
                #[test]
                fn $property() {
                    super::$property(&$transport);
                }
            )+
        }
    };
}

conformance! {
    {
        a_run_is_alive_until_its_host_is_gone,
        a_run_that_nobody_holds_cannot_be_joined,
        a_run_has_one_host,
        a_run_that_its_host_removes_is_gone_at_once,
        messages_arrive_whole_and_in_order,
        a_refusal_is_the_mentor_servers_own,
        a_reply_may_be_as_large_as_it_likes,
        a_client_is_answered_and_learns_of_the_mentor_servers_end,
        an_actor_learns_of_the_learners_end,
        in_lockstep_the_learner_learns_of_an_actors_end,
        in_free_mode_a_late_actor_gets_what_is_newest,
    }
    shared_memory: SharedMemory,
    threads: Threads::default(),
}

fn never() -> bool {
    false
}

fn acting(version: Round) -> Acting {
    let mark = u64::from(version) as f32 / 100.0;
    let weights = (0..2 * 8 + 8 + 8 * 3 + 3).map(|i| i as f32 + mark).collect();
    // An option of one step, and another one of up to three.
    let steps = 2 + u64::from(version) as u32 % 3;
    let states = (0..2 * steps).map(|i| i as f32 - mark).collect();
    let options = Options { of: vec![0, 2], ends: vec![1, steps], actions: vec![2; steps as usize], states };
    Acting { known: vec![1, NONE, 2], options, ..Acting::of_weights(weights) }
}

fn batch_of(run: u64, round: Round, actor: u32, mark: f32) -> Batch {
    let mut batch = Batch::with_capacity(4, 2);
    batch.prepare(BatchHeader { run, round, actor, count: 4, obs_dim: 2, ..Default::default() });
    for i in 0..4 {
        let (obs, next) = ([actor as f32, u64::from(round) as f32], [i as f32, mark]);
        let flags = if i == 0 { FIRST } else { 0 };
        batch.set(i, &Transition { obs: &obs, next_obs: &next, action: actor, reward: 0.5, flags });
    }
    batch
}

/// An actor that answers orders with what tells it apart, until it is stopped: with a snapshot that is asked for, or else
/// with a batch.
fn act(mut link: impl ActorLink, index: u32) {
    link.hello(&never).unwrap();
    loop {
        let Some(orders) = link.recv_orders(LONG).unwrap() else { continue };
        if orders.stop == 1 {
            return;
        }
        let (run, round) = (orders.run, orders.round);
        if orders.snapshot > 0 {
            let (number, kind) = (orders.snapshot, ACTOR_STATE);
            let header = ReplyHeader { run, number, actor: index, kind, ..ReplyHeader::default() };
            link.send_reply(&Reply { header, payload: vec![index as u8; 70_000] }).unwrap();
            continue;
        }
        assert!(link.acting(0, orders.weights_version + 1).unwrap().is_none());
        assert!(link.acting(1, orders.weights_version).unwrap().is_none());
        let (version, newest) = link.acting(0, orders.weights_version).unwrap().unwrap();
        assert_eq!((version, newest), (orders.weights_version, &acting(version)));
        let mark = newest.weights[0];
        link.send_batch(&batch_of(run, round, index, mark)).unwrap();
    }
}

/// Answers requests until the other end of `over` is dropped. The clients have all their answers then.
fn answer(mut link: impl MentorLink, over: &Receiver<()>) {
    link.hello(&mut Canned, &never).unwrap();
    while over.try_recv() == Err(std::sync::mpsc::TryRecvError::Empty) {
        link.serve(&mut Canned, Duration::from_millis(20)).unwrap();
    }
}

/// Plays a run of `mode` whose learner does `learn`.
fn played<T: Transport + Sync>(transport: &T, mode: &str, learn: impl FnOnce(&RunPlan, T::Learner)) {
    let plan = plan(mode);
    let _host = transport.host(&plan).unwrap();
    play(transport, &plan, |learner| learn(&plan, learner));
}

/// Plays the run of `plan`, which has a host, with a learner that does `learn`.
fn play<T: Transport + Sync>(transport: &T, plan: &RunPlan, learn: impl FnOnce(T::Learner)) {
    thread::scope(|scope| {
        for index in 0..ACTORS {
            scope.spawn(move || act(transport.actor(plan, index).unwrap(), index));
        }
        let (_serving, over) = channel();
        scope.spawn(move || answer(transport.mentor(plan).unwrap(), &over));
        let mut learner = transport.learner(plan).unwrap();
        learner.welcome(&never).unwrap();
        learn(learner);
    });
}

fn stop(plan: &RunPlan, link: &mut impl LearnerLink) {
    link.send_orders(&Orders { run: plan.life.run, stop: 1, ..Orders::default() }).unwrap();
}

fn a_run_is_alive_until_its_host_is_gone(transport: &impl Transport) {
    let plan = plan("lockstep");
    let run = plan.life.run;
    assert_eq!(transport.liveness(run), Liveness::Absent);
    transport.remove(run).unwrap();
    let host = transport.host(&plan).unwrap();
    assert_eq!(transport.liveness(run), Liveness::Alive);
    assert!(transport.runs().unwrap().contains(&run));
    assert!(host.reap(), "nobody has died");
    let learner = transport.learner(&plan).unwrap();
    let (left, most) = (transport.remains(run).unwrap(), transport.footprint(&plan.experiment));
    assert!(left.files as u64 <= most.files && left.bytes <= most.memory, "{left:?}; {most:?}");
    drop(learner);
    drop(host);
    assert_eq!(transport.liveness(run), Liveness::Absent);
    assert!(!transport.runs().unwrap().contains(&run));
    assert_eq!(transport.remains(run).unwrap().files, 0);
}

fn a_run_that_nobody_holds_cannot_be_joined(transport: &impl Transport) {
    let plan = plan("lockstep");
    let errors = [
        transport.learner(&plan).err(),
        transport.actor(&plan, 0).err(),
        transport.mentor(&plan).err(),
        transport.client(&plan).err(),
    ];
    for error in errors {
        let said = error.unwrap().to_string();
        assert!(said.contains("joining the run: it is not in progress"), "{said}");
    }
    assert_eq!(transport.liveness(plan.life.run), Liveness::Absent, "to ask for it makes nothing of it");
}

fn a_run_has_one_host(transport: &impl Transport) {
    let plan = plan("lockstep");
    let _host = transport.host(&plan).unwrap();
    assert!(transport.host(&plan).is_err());
    assert_eq!(transport.liveness(plan.life.run), Liveness::Alive, "the first one still has it");
    transport.learner(&plan).unwrap();
}

fn a_run_that_its_host_removes_is_gone_at_once(transport: &impl Transport) {
    let plan = plan("lockstep");
    let host = transport.host(&plan).unwrap();
    let learner = transport.learner(&plan).unwrap();
    host.remove().unwrap();
    assert_eq!(transport.remains(plan.life.run).unwrap().files, 0);
    assert!(transport.actor(&plan, 0).is_err());
    drop(learner);
    drop(host);
    assert_eq!(transport.liveness(plan.life.run), Liveness::Absent);
}

fn messages_arrive_whole_and_in_order<T: Transport + Sync>(transport: &T) {
    played(transport, "lockstep", |plan, mut link| {
        let run = plan.life.run;
        let mut batches = vec![Checked::with_capacity(4, 2); ACTORS as usize];
        let (mut spare, mut answers) = (Checked::<Batch>::default(), Answers::default());
        let mut orders = Orders { run, ..Orders::default() };
        for round in (1..=200).map(Round::from) {
            let before = round.before(1);
            (orders.round, orders.weights_version) = (round, before);
            link.send_acting(before, &acting(before)).unwrap();
            orders.shares[..ACTORS as usize].fill(Share { granted: round.into(), ..Share::default() });
            link.send_orders(&orders).unwrap();
            for missing in (1..=ACTORS).rev() {
                match link.recv(&mut spare, missing, LONG).unwrap().expect("a batch in time") {
                    FromActor::Batch => {
                        let actor = spare.header.actor as usize;
                        std::mem::swap(&mut spare, &mut batches[actor]);
                    }
                    FromActor::Reply(reply) => panic!("{reply:?}"),
                }
            }
            for (actor, batch) in batches.iter().enumerate() {
                let sent = batch_of(run, round, actor as u32, acting(before).weights[0]);
                assert_eq!((batch.header, batch.payload()), (sent.header, sent.payload()));
            }
            let request = ObserveRequest {
                run,
                round,
                first_index: round.into(),
                op: OBSERVE,
                count: ACTORS,
                obs_dim: 2,
                reserved: 0,
            };
            let parts: Vec<Part<'_>> = batches.iter().map(|batch| Part::of(batch)).collect();
            link.observe(&request, &parts, &mut answers).unwrap();
            for (actor, answer) in answers.parts().iter().enumerate() {
                assert_eq!(answer.mentor, [if actor == 0 { 1 } else { NONE }; 4]);
                let mut table = AnnotationTable::new(MENTOR, 2, 3).keeping(FURTHER);
                table.apply(&answer.changed).unwrap();
                assert_eq!(table.estimate(actor).unwrap().e_kl, 0.5);
                assert_eq!(table.estimate(1 - actor), None);
            }
        }
        let similar = QueryRequest { run, op: SIMILAR, count: 2, obs_dim: 2, ..Default::default() };
        let mut words = Vec::new();
        link.query(&similar, &[1.5, 2.5], &mut words).unwrap();
        assert_eq!(words, [1.5f32.to_bits(), 2.5f32.to_bits()]);
        stop(plan, &mut link);
    });
}

fn a_refusal_is_the_mentor_servers_own<T: Transport + Sync>(transport: &T) {
    played(transport, "lockstep", |plan, mut link| {
        let run = plan.life.run;
        let (sent, mut batch) = (batch_of(run, Round::from(1), 0, 0.0), Checked::<Batch>::default());
        batch.receive(sent.header, sent.payload(), &plan.experiment.spaces()).unwrap();
        let far = ObserveRequest {
            run,
            first_index: 5000,
            op: OBSERVE,
            count: 1,
            obs_dim: 2,
            ..Default::default()
        };
        let refusal = link.observe(&far, &[Part::of(&batch)], &mut Answers::default());
        assert!(matches!(refusal, Err(LinkError::Refused { .. })), "{refusal:?}");
        let stats = QueryRequest { run, op: STATS, obs_dim: 2, ..Default::default() };
        let refusal = link.query(&stats, &[], &mut Vec::new());
        assert!(matches!(refusal, Err(LinkError::Refused { .. })), "{refusal:?}");
        stop(plan, &mut link);
    });
}

fn a_reply_may_be_as_large_as_it_likes<T: Transport + Sync>(transport: &T) {
    played(transport, "lockstep", |plan, mut link| {
        link.send_orders(&Orders { run: plan.life.run, snapshot: 1, ..Orders::default() }).unwrap();
        let (mut replies, mut spare) = (Vec::new(), Checked::<Batch>::default());
        while replies.len() < ACTORS as usize {
            match link.recv(&mut spare, 1, LONG).unwrap().expect("a reply in time") {
                FromActor::Reply(reply) => replies.push((reply.header.actor, reply.payload)),
                FromActor::Batch => panic!("a batch of {}", spare.header.actor),
            }
        }
        replies.sort();
        assert_eq!(replies, [(0, vec![0; 70_000]), (1, vec![1; 70_000])]);
        assert!(link.recv(&mut spare, 1, Duration::from_millis(1)).unwrap().is_none());
        stop(plan, &mut link);
    });
}

fn a_client_is_answered_and_learns_of_the_mentor_servers_end<T: Transport + Sync>(transport: &T) {
    let plan = plan("lockstep");
    let _host = transport.host(&plan).unwrap();
    let similar = QueryRequest { op: SIMILAR, count: 1, obs_dim: 2, ..Default::default() };
    let mut words = Vec::new();
    play(transport, &plan, |mut learner| {
        transport.client(&plan).unwrap().ask(&similar, &[7.0], &mut words, LONG).unwrap();
        assert_eq!(words, [7.0f32.to_bits()]);
        stop(&plan, &mut learner);
    });
    // It is noticed at once, not by a deadline.
    let lost = transport.client(&plan).unwrap().ask(&similar, &[7.0], &mut words, LONG);
    assert!(matches!(lost, Err(LinkError::Receivers { found: 0, .. })), "{lost:?}");
}

fn an_actor_learns_of_the_learners_end<T: Transport + Sync>(transport: &T) {
    let plan = plan("lockstep");
    let _host = transport.host(&plan).unwrap();
    thread::scope(|scope| {
        let plan = &plan;
        let (_serving, over) = channel();
        scope.spawn(move || answer(transport.mentor(plan).unwrap(), &over));
        for index in 0..ACTORS {
            scope.spawn(move || {
                let mut link = transport.actor(plan, index).unwrap();
                link.hello(&never).unwrap();
                while link.recv_orders(LONG).unwrap().is_none_or(|orders| orders.stop == 0) {}
                // The learner is on its way out.
                let batch = batch_of(plan.life.run, Round::default(), index, 0.0);
                let sent = (0..1000).find_map(|_| {
                    thread::yield_now();
                    link.recv_orders(Duration::from_millis(10)).unwrap();
                    link.send_batch(&batch).err()
                });
                let lost = sent.expect("the end of the learner is noticed");
                assert!(lost.is_lost_peer(), "{lost}");
            });
        }
        let mut learner = transport.learner(plan).unwrap();
        learner.welcome(&never).unwrap();
        stop(plan, &mut learner);
    });
}

fn in_lockstep_the_learner_learns_of_an_actors_end<T: Transport + Sync>(transport: &T) {
    let plan = plan("lockstep");
    let _host = transport.host(&plan).unwrap();
    thread::scope(|scope| {
        let plan = &plan;
        let (_serving, over) = channel();
        scope.spawn(move || answer(transport.mentor(plan).unwrap(), &over));
        let leaving = scope.spawn(move || {
            transport.actor(plan, 0).unwrap().hello(&never).unwrap();
        });
        scope.spawn(move || act(transport.actor(plan, 1).unwrap(), 1));
        let mut learner = transport.learner(plan).unwrap();
        learner.welcome(&never).unwrap();
        leaving.join().unwrap();
        let orders = Orders { run: plan.life.run, stop: 1, ..Orders::default() };
        let lost = learner.send_orders(&orders).unwrap_err();
        assert!(matches!(lost, LinkError::Receivers { found: 1, expected: 2, .. }), "{lost}");
        assert!(lost.is_lost_peer());
    });
}

fn in_free_mode_a_late_actor_gets_what_is_newest<T: Transport + Sync>(transport: &T) {
    let plan = plan("free");
    let _host = transport.host(&plan).unwrap();
    thread::scope(|scope| {
        let plan = &plan;
        let (_serving, over) = channel();
        scope.spawn(move || answer(transport.mentor(plan).unwrap(), &over));
        let mut learner = transport.learner(plan).unwrap();
        learner.welcome(&never).unwrap();
        let mut orders = Orders { run: plan.life.run, ..Orders::default() };
        for round in (1..=3).map(Round::from) {
            (orders.round, orders.weights_version) = (round, round);
            learner.send_acting(round, &acting(round)).unwrap();
            learner.send_orders(&orders).unwrap();
        }
        scope.spawn(move || act(transport.actor(plan, 0).unwrap(), 0));
        let mut batch = Checked::<Batch>::default();
        assert_eq!(learner.recv(&mut batch, 1, LONG).unwrap(), Some(FromActor::Batch));
        let sent = batch_of(plan.life.run, Round::from(3), 0, acting(Round::from(3)).weights[0]);
        assert_eq!((batch.header, batch.payload()), (sent.header, sent.payload()));
        stop(plan, &mut learner);
    });
}
