//! What every transport must do, run over each of them: handshake, weights before orders, batches,
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
use trestle_proto::acting::Acting;
use trestle_proto::annotation::{AnnotationTable, Estimate};
use trestle_proto::batch::{Batch, BatchHeader, Checked, FIRST, Spaces, Transition};
use trestle_proto::config::{self, Config};
use trestle_proto::experiment::{Experiment, MentorPart};
use trestle_proto::limits::WAIT_SLICE;
use trestle_proto::observe::{Answers, OBSERVE, ObserveAnswer, ObserveRequest, Observed, Part};
use trestle_proto::orders::{Orders, Share};
use trestle_proto::plan::{Life, RunPlan};
use trestle_proto::query::{OK, OUT_OF_RANGE, QueryAnswer, QueryRequest, SIMILAR, STATS};
use trestle_proto::reply::{ACTOR_STATE, Reply, ReplyHeader};
use trestle_proto::space::EnvSpec;

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
        categories: Vec::new(),
        velocities: Vec::new(),
        actions: ["a", "b", "c"].map(String::from).to_vec(),
        best_return: None,
        threshold: None,
        goal_bonus: 0.0,
        defines_success: true,
    };
    let mentors = vec![MentorPart { name: "mentor".into(), transitions: MENTOR }];
    RunPlan {
        life: Life { run, ..Life::default() },
        experiment: Experiment { config, spec, mentors, waypoints: None },
    }
}

fn acting(version: u64) -> Acting {
    Acting::of_weights((0..2 * 8 + 8 + 8 * 3 + 3).map(|i| i as f32 + version as f32 / 100.0).collect())
}

/// An actor that answers orders with what tells it apart, until it is stopped: with a snapshot that is asked for, or else
/// with a batch.
fn act(mut link: impl ActorLink, index: u32) {
    link.hello(&|| false).unwrap();
    let mut batch = Batch::with_capacity(4, 2);
    loop {
        let Some(orders) = link.recv_orders(LONG).unwrap() else { continue };
        if orders.stop == 1 {
            return;
        }
        let (run, round) = (orders.run, orders.round);
        if orders.snapshot > 0 {
            let header = ReplyHeader { run, number: orders.snapshot, actor: index, kind: ACTOR_STATE };
            link.send_reply(&Reply { header, payload: vec![index as u8; 70_000] }).unwrap();
            continue;
        }
        assert!(link.acting(0, orders.weights_version + 1).unwrap().is_none());
        assert!(link.acting(1, orders.weights_version).unwrap().is_none());
        let (version, newest) = link.acting(0, orders.weights_version).unwrap().unwrap();
        assert_eq!((version, newest), (orders.weights_version, &acting(version)));
        let first = newest.weights[0];
        batch.prepare(BatchHeader { run, round, actor: index, count: 4, obs_dim: 2, ..Default::default() });
        for i in 0..4 {
            let obs = [index as f32, round as f32];
            let next = [i as f32, first];
            let flags = if i == 0 { FIRST } else { 0 };
            batch.set(i, &Transition { obs: &obs, next_obs: &next, action: index, reward: 0.5, flags });
        }
        link.send_batch(&batch).unwrap();
    }
}

/// A mentor that names transition 1 for every observation of actor 0 and knows one annotation for each part; refuses what is far
/// ahead.
struct Canned;

impl MentorHandler for Canned {
    fn forget(&mut self) {}

    fn observe(
        &mut self,
        request: &ObserveRequest,
        mut payload: &[u32],
        out: &mut Vec<u32>,
    ) -> ObserveAnswer {
        if request.first_index > 1000 {
            return ObserveAnswer { status: OUT_OF_RANGE, ..Default::default() };
        }
        while let Some(part) = Part::take(&mut payload, request.obs_dim as usize) {
            let batch = part.check(&Spaces { actors: ACTORS, obs_dim: 2, n_actions: 3 }).unwrap();
            let mut table = AnnotationTable::new(MENTOR, 2, 3);
            table.set_estimate(
                part.actor as usize,
                &Estimate { action: 1, e_kl: 0.5, start_kl: 0.0, reward: -1.0 },
            );
            let mut answer = Observed::default();
            answer.mentor.extend((0..batch.len()).map(|at| if batch.get(at).action == 0 { 1 } else { NONE }));
            table.encode(part.actor as usize, &mut answer.changed);
            answer.encode(2, out);
        }
        ObserveAnswer { first_index: request.first_index, ..Default::default() }
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
    let mut batches = vec![Checked::with_capacity(4, 2); ACTORS as usize];
    let (mut spare, mut answers) = (Checked::<Batch>::default(), Answers::default());
    let mut orders = Orders { run: plan.life.run, ..Orders::default() };
    for round in 1..=200u64 {
        (orders.round, orders.weights_version) = (round, round - 1);
        link.send_acting(round - 1, &acting(round - 1)).unwrap();
        orders.shares[..ACTORS as usize].fill(Share { granted: round, ..Share::default() });
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
            assert_eq!((batch.header.round, batch.header.actor, batch.len()), (round, actor as u32, 4));
            assert_eq!(batch.transition(3).next_obs, [3.0, acting(round - 1).weights[0]]);
        }
        let request = ObserveRequest {
            run: plan.life.run,
            round,
            first_index: round,
            op: OBSERVE,
            count: ACTORS,
            obs_dim: 2,
            reserved: 0,
        };
        let parts: Vec<Part<'_>> = batches.iter().map(|batch| Part::of(batch)).collect();
        link.observe(&request, &parts, &mut answers).unwrap();
        for (actor, answer) in answers.parts().iter().enumerate() {
            assert_eq!(answer.mentor, [if actor == 0 { 1 } else { NONE }; 4]);
            let mut table = AnnotationTable::new(MENTOR, 2, 3);
            table.apply(&answer.changed).unwrap();
            assert_eq!(table.estimate(actor).unwrap().e_kl, 0.5);
            assert_eq!(table.estimate(1 - actor), None);
        }
        // Refused by the mentor-server, not by the transport.
        let far = ObserveRequest { first_index: 5000, ..request };
        let refusal = link.observe(&far, &parts, &mut answers);
        assert!(matches!(refusal, Err(LinkError::Refused { .. })), "{refusal:?}");
    }
    let mut words = Vec::new();
    let similar =
        QueryRequest { run: plan.life.run, op: SIMILAR, count: 2, obs_dim: 2, ..Default::default() };
    link.query(&similar, &[1.5, 2.5], &mut words).unwrap();
    assert_eq!(words, [1.5f32.to_bits(), 2.5f32.to_bits()]);
    let refusal = link.query(&QueryRequest { op: STATS, ..similar }, &[], &mut words);
    assert!(matches!(refusal, Err(LinkError::Refused { .. })), "{refusal:?}");

    orders.snapshot = 1;
    link.send_orders(&orders).unwrap();
    let mut replies = Vec::new();
    while replies.len() < ACTORS as usize {
        match link.recv(&mut spare, 1, LONG).unwrap().expect("a reply in time") {
            FromActor::Reply(reply) => replies.push((reply.header.actor, reply.payload)),
            FromActor::Batch => panic!("a batch of {}", spare.header.actor),
        }
    }
    replies.sort();
    assert_eq!(replies, [(0, vec![0; 70_000]), (1, vec![1; 70_000])]);
    assert!(link.recv(&mut spare, 1, Duration::from_millis(1)).unwrap().is_none());
    orders.stop = 1;
    link.send_orders(&orders).unwrap();
}

/// Requests that `learn` makes of the mentor-server.
const REQUESTS: usize = 200 * 2 + 2;

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
