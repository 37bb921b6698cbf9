//! What every transport must do, run over each of them: handshake, weights before ticks, batches in their places,
//! replies, the mentor-server's answers and refusals.
#![allow(clippy::unwrap_used)]

use iceoryx2::prelude::{Config as Iceoryx, FileName, NodeBuilder, Path, SemanticString, ipc};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::thread;
use std::time::{Duration, Instant};
use trestle_link::iceoryx::{
    Domain, IceoryxActor, IceoryxLearner, IceoryxMentor, QueryClient, Services, Wire,
};
use trestle_link::local;
use trestle_link::{ActorLink, FromActor, LearnerLink, LinkError, MentorHandler, MentorLink};
use trestle_proto::NONE;
use trestle_proto::annotation::{AnnotationTable, Estimate};
use trestle_proto::batch::{Batch, BatchHeader, FIRST, Transition};
use trestle_proto::config::{self, Config};
use trestle_proto::limits::WAIT_SLICE;
use trestle_proto::observe::{OBSERVE, ObserveAnswer, ObserveRequest, Observed};
use trestle_proto::plan::{MentorPart, RunPlan};
use trestle_proto::query::{OK, OUT_OF_RANGE, QueryAnswer, QueryRequest, SIMILAR, STATS};
use trestle_proto::reply::{ACTOR_STATE, Reply, ReplyHeader};
use trestle_proto::space::EnvSpec;
use trestle_proto::tick::{COLLECT, SNAPSHOT, STOP, Tick};

const LONG: Duration = Duration::from_secs(20);
const ACTORS: u32 = 2;
const MENTOR: usize = 3;

fn plan(run: u64) -> RunPlan {
    let overrides =
        ["run.episodes=9", "run.actors=2", "run.rollout=4", "learner.hidden=[8]"].map(String::from);
    let config: Config = config::from_table(&(), config::Table::new(), &overrides).unwrap();
    let spec = EnvSpec {
        name: "test".into(),
        low: vec![0.0; 2],
        high: vec![9.0; 2],
        scale: vec![1.0; 2],
        integral: true,
        actions: ["a", "b", "c"].map(String::from).to_vec(),
        best_return: None,
        goal_bonus: 0.0,
        defines_success: true,
    };
    let mentors = vec![MentorPart { name: "mentor".into(), transitions: MENTOR }];
    RunPlan {
        run,
        history: 0,
        config,
        spec,
        mentors,
        waypoints: None,
        resume_tick: None,
        restarts: 0,
        generation: 0,
    }
}

fn weights(version: u64) -> Vec<f32> {
    (0..2 * 8 + 8 + 8 * 3 + 3).map(|i| i as f32 + version as f32 / 100.0).collect()
}

/// An actor that answers each tick with what tells it apart, until it is stopped.
fn act(mut link: impl ActorLink, index: u32) {
    link.hello(&|| false).unwrap();
    let mut batch = Batch::with_capacity(4, 2);
    loop {
        let Some(tick) = link.recv_tick(LONG).unwrap() else { continue };
        match tick.kind {
            COLLECT => {
                let params = link.weights(tick.weights_version).unwrap().to_vec();
                assert_eq!(params, weights(tick.weights_version));
                let (run, actor, count) = (tick.run, index, tick.amount);
                batch.prepare(BatchHeader {
                    run,
                    tick: tick.tick,
                    actor,
                    count,
                    obs_dim: 2,
                    ..Default::default()
                });
                for i in 0..count as usize {
                    let obs = [index as f32, tick.tick as f32];
                    let next = [i as f32, params[0]];
                    let flags = if i == 0 { FIRST } else { 0 };
                    batch.set(
                        i,
                        &Transition { obs: &obs, next_obs: &next, action: index, reward: 0.5, flags },
                    );
                }
                link.send_batch(&batch).unwrap();
            }
            SNAPSHOT => {
                let header = ReplyHeader { run: tick.run, tick: tick.tick, actor: index, kind: ACTOR_STATE };
                link.send_reply(&Reply { header, payload: vec![index as u8; 70_000] }).unwrap();
            }
            _ => return,
        }
    }
}

/// A mentor that names transition 1 for every observation and knows one annotation; refuses negative tick numbers.
struct Canned;

impl MentorHandler for Canned {
    fn forget(&mut self) {}

    fn observe(&mut self, request: &ObserveRequest, payload: &[u32], out: &mut Vec<u32>) -> ObserveAnswer {
        let mut batch = Batch::default();
        let header = BatchHeader { count: request.count, obs_dim: request.obs_dim, ..Default::default() };
        if request.first_index > 1000 || batch.receive(header, payload, 2, 3).is_err() {
            return ObserveAnswer { status: OUT_OF_RANGE, ..Default::default() };
        }
        out.extend(batch.actions().iter().map(|&a| if a == 0 { 1 } else { NONE }));
        let mut table = AnnotationTable::new(MENTOR, 2, 3);
        table.set_estimate(2, &Estimate { action: 1, e_kl: 0.5, reward: -1.0 });
        table.encode(2, out);
        ObserveAnswer {
            first_index: request.first_index,
            count: request.count,
            changed: 1,
            ..Default::default()
        }
    }

    fn query(&mut self, request: &QueryRequest, payload: &[f32], out: &mut Vec<u32>) -> QueryAnswer {
        if request.op != SIMILAR {
            return QueryAnswer { status: OUT_OF_RANGE, count: 0 };
        }
        out.extend(payload.iter().map(|x| x.to_bits()));
        QueryAnswer { status: OK, count: payload.len() as u32 }
    }
}

/// Answers `requests` requests, and leaves when the clients have all their answers: when the other end of `over` goes.
fn mentor(mut link: impl MentorLink, requests: usize, over: Receiver<()>) {
    link.hello(&mut Canned, &|| false).unwrap();
    let mut answered = 0;
    while answered < requests {
        answered += link.serve(&mut Canned, LONG).unwrap();
    }
    assert!(over.recv().is_err(), "nothing is ever sent");
}

fn learn(mut link: impl LearnerLink, plan: &RunPlan) {
    link.welcome(&|| false).unwrap();
    let mut batches = vec![Batch::with_capacity(4, 2); ACTORS as usize];
    let mut observed = Observed::default();
    for tick in 1..=200u64 {
        link.send_weights(tick - 1, &weights(tick - 1)).unwrap();
        let kind = COLLECT;
        link.send_tick(&Tick {
            run: plan.run,
            tick,
            weights_version: tick - 1,
            kind,
            amount: 4,
            ..Tick::default()
        })
        .unwrap();
        let mut seen = [false; ACTORS as usize];
        while !seen.iter().all(|s| *s) {
            match link.recv(&mut batches, LONG).unwrap().expect("a batch in time") {
                FromActor::Batch(actor) => seen[actor as usize] = true,
                FromActor::Reply(reply) => panic!("{reply:?}"),
            }
        }
        for (actor, batch) in batches.iter().enumerate() {
            assert_eq!((batch.header.tick, batch.header.actor, batch.len()), (tick, actor as u32, 4));
            assert_eq!(batch.transition(3).next_obs, [3.0, weights(tick - 1)[0]]);
            let request = ObserveRequest {
                run: plan.run,
                tick,
                first_index: tick,
                op: OBSERVE,
                actor: actor as u32,
                count: 4,
                obs_dim: 2,
            };
            link.observe(&request, batch.payload(), &mut observed).unwrap();
            assert_eq!(observed.mentor, [if actor == 0 { 1 } else { NONE }; 4]);
            let mut table = AnnotationTable::new(MENTOR, 2, 3);
            table.apply(&observed.changed).unwrap();
            assert_eq!(table.estimate(2).unwrap().e_kl, 0.5);
            // Refused by the mentor-server, not by the transport.
            let far = ObserveRequest { first_index: 5000, ..request };
            let refusal = link.observe(&far, batch.payload(), &mut observed);
            assert!(matches!(refusal, Err(LinkError::Refused { .. })), "{refusal:?}");
        }
    }
    let mut words = Vec::new();
    let similar = QueryRequest { run: plan.run, op: SIMILAR, count: 2, obs_dim: 2, ..Default::default() };
    link.query(&similar, &[1.5, 2.5], &mut words).unwrap();
    assert_eq!(words, [1.5f32.to_bits(), 2.5f32.to_bits()]);
    let refusal = link.query(&QueryRequest { op: STATS, ..similar }, &[], &mut words);
    assert!(matches!(refusal, Err(LinkError::Refused { .. })), "{refusal:?}");

    let snapshot = Tick { run: plan.run, tick: 200, kind: SNAPSHOT, ..Tick::default() };
    link.send_tick(&snapshot).unwrap();
    let mut replies = Vec::new();
    while replies.len() < ACTORS as usize {
        match link.recv(&mut batches, LONG).unwrap().expect("a reply in time") {
            FromActor::Reply(reply) => replies.push((reply.header.actor, reply.payload)),
            FromActor::Batch(actor) => panic!("batch of {actor}"),
        }
    }
    replies.sort();
    assert_eq!(replies, [(0, vec![0; 70_000]), (1, vec![1; 70_000])]);
    assert!(link.recv(&mut batches, Duration::from_millis(1)).unwrap().is_none());
    link.send_tick(&Tick { kind: STOP, ..snapshot }).unwrap();
}

/// Requests that `learn` makes of the mentor-server.
const REQUESTS: usize = 200 * ACTORS as usize * 2 + 2;

#[test]
fn channels() {
    let plan = plan(1);
    let (learner, server, actors) = local::connect(&plan);
    thread::scope(|scope| {
        for (index, link) in actors.into_iter().enumerate() {
            scope.spawn(move || act(link, index as u32));
        }
        let (_serving, over) = channel();
        scope.spawn(move || mentor(server, REQUESTS, over));
        learn(learner, &plan);
    });
}

#[test]
fn shared_memory() {
    let run = u64::from(std::process::id()) << 32 | 2;
    let domain = Domain::create(run).unwrap();
    let plan = plan(run);
    let services = Services::create(&domain, &plan).unwrap();
    thread::scope(|scope| {
        for index in 0..ACTORS {
            let (domain, plan) = (&domain, &plan);
            scope.spawn(move || act(IceoryxActor::new(domain, plan, index).unwrap(), index));
        }
        let (domain, plan) = (&domain, &plan);
        let (_serving, over) = channel();
        scope.spawn(move || mentor(IceoryxMentor::new(domain, plan).unwrap(), REQUESTS + 1, over));
        learn(IceoryxLearner::new(domain, plan).unwrap(), plan);
        let client = QueryClient::new(domain, plan).unwrap();
        let similar = QueryRequest { op: SIMILAR, count: 1, obs_dim: 2, ..Default::default() };
        let mut words = Vec::new();
        client.ask(&similar, &[7.0], &mut words, LONG).unwrap();
        assert_eq!(words, [7.0f32.to_bits()]);
    });
    // A mentor-server that is gone is noticed at once, not by a deadline.
    let client = QueryClient::new(&domain, &plan).unwrap();
    let similar = QueryRequest { op: SIMILAR, ..Default::default() };
    assert!(matches!(
        client.ask(&similar, &[7.0], &mut Vec::new(), LONG),
        Err(LinkError::Receivers { found: 0, .. })
    ));
    drop(client);
    drop(services);
    domain.remove().unwrap();
    assert_eq!(domain.shared_memory().unwrap(), Vec::<std::path::PathBuf>::new());
}

/// A client of iceoryx2's own kind of service, as bindings of other languages have it: it wakes nobody up and sleeps on nothing.
#[test]
fn a_client_without_events_is_answered() {
    let run = u64::from(std::process::id()) << 32 | 4;
    let domain = Domain::create(run).unwrap();
    let plan = plan(run);
    let services = Services::create(&domain, &plan).unwrap();
    let mut config = Iceoryx::default();
    config.global.set_root_path(&Path::new(domain.root().as_os_str().as_encoded_bytes()).unwrap());
    config.global.prefix = FileName::new(domain.prefix().as_bytes()).unwrap();
    config.global.node.cleanup_dead_nodes_on_creation = false;
    config.global.node.cleanup_dead_nodes_on_destruction = false;
    config.global.service.cleanup_dead_nodes_on_open = false;
    thread::scope(|scope| {
        let (domain, plan) = (&domain, &plan);
        let (ready, is_ready) = channel();
        let (stop, stopped) = channel::<()>();
        scope.spawn(move || {
            let mut server = IceoryxMentor::new(domain, plan).unwrap();
            ready.send(()).unwrap();
            while stopped.try_recv() == Err(TryRecvError::Empty) {
                server.serve(&mut Canned, WAIT_SLICE).unwrap();
            }
        });
        is_ready.recv().unwrap();
        let node = NodeBuilder::new().config(&config).create::<ipc::Service>().unwrap();
        let service = node
            .service_builder(&"trestle/mentor/query".try_into().unwrap())
            .request_response::<[f32], [u32]>()
            .request_user_header::<Wire<QueryRequest>>()
            .response_user_header::<Wire<QueryAnswer>>()
            .open()
            .unwrap();
        let client = service.client_builder().initial_max_slice_len(2).create().unwrap();
        let mut request = client.loan_slice_uninit(1).unwrap().write_from_slice(&[7.0]);
        request.user_header_mut().0 =
            QueryRequest { run, op: SIMILAR, count: 1, obs_dim: 2, ..Default::default() };
        let pending = request.send().unwrap();
        let start = Instant::now();
        let answer = loop {
            if let Some(answer) = pending.receive().unwrap() {
                break answer;
            }
            assert!(start.elapsed() < LONG, "no answer");
            node.wait(Duration::from_millis(10)).unwrap();
        };
        assert_eq!(answer.user_header().0.status, OK);
        assert_eq!(answer.payload(), [7.0f32.to_bits()]);
        drop(stop);
    });
    drop(services);
    domain.remove().unwrap();
}
