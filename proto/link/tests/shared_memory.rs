//! What only the transport over shared memory promises.
#![allow(clippy::unwrap_used)]

mod canned;

use canned::{Canned, LONG, plan};
use iceoryx2::prelude::{Config as Iceoryx, FileName, NodeBuilder, Path, SemanticString, ipc};
use std::sync::mpsc::{TryRecvError, channel};
use std::thread;
use std::time::{Duration, Instant};
use trestle_link::iceoryx::{Domain, SharedMemory, Wire};
use trestle_link::{MentorLink, Transport};
use trestle_proto::limits::WAIT_SLICE;
use trestle_proto::query::{OK, QueryAnswer, QueryRequest, SIMILAR};

/// A client of iceoryx2's own kind of service, as bindings of other languages have it: it wakes nobody up and sleeps on nothing.
#[test]
fn a_client_without_events_is_answered() {
    let plan = plan("lockstep");
    let run = plan.life.run;
    let (_host, domain) = (SharedMemory.host(&plan).unwrap(), Domain::of(run));
    let mut config = Iceoryx::default();
    config.global.set_root_path(&Path::new(domain.root().as_os_str().as_encoded_bytes()).unwrap());
    config.global.prefix = FileName::new(domain.prefix().as_bytes()).unwrap();
    config.global.node.cleanup_dead_nodes_on_creation = false;
    config.global.node.cleanup_dead_nodes_on_destruction = false;
    config.global.service.cleanup_dead_nodes_on_open = false;
    thread::scope(|scope| {
        let plan = &plan;
        let (ready, is_ready) = channel();
        let (stop, stopped) = channel::<()>();
        scope.spawn(move || {
            let mut server = SharedMemory.mentor(plan).unwrap();
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
}
