//! Whatever reads bytes that others wrote, each as a function of arbitrary bytes that must neither panic nor let anything
//! unsound through. Driven by `hostile.rs`, and by libFuzzer in `fuzz/`, the library of which this is.

#![allow(clippy::unwrap_used)]

use bytemuck::{Pod, Zeroable, pod_read_unaligned};
use std::fs;
use std::time::Duration;
use trestle_actor::env::grid::Map;
use trestle_actor::env::grid::foreign::{Choices, of_numbers, of_text};
use trestle_actor::env::registry;
use trestle_actor::worker::{STATE_KIND, Worker};
use trestle_algorithm::replay::{Bounds, Replay, Span};
use trestle_hosts::frame::{self, Frame, MAX_FRAME};
use trestle_hosts::message::{self, FromHead, FromHost, Grant, HELLO_KIND, Hello};
use trestle_hosts::stream::Stream;
use trestle_learner::checkpoint;
use trestle_mentor_server::demo_file;
use trestle_mentor_server::import::{self, Options};
use trestle_proto::NONE;
use trestle_proto::acting::{self, Acting, ActingHeader, OptionRoom, OwnPlaces, Room, Rooms};
use trestle_proto::annotation::{AnnotationTable, Bridge};
use trestle_proto::batch::{self, Batch, BatchHeader, Checked, KNOWN_FLAGS, Spaces};
use trestle_proto::codec::{self, Kind};
use trestle_proto::config::{self, Config};
use trestle_proto::experiment::Experiment;
use trestle_proto::mentor::MentorTransitions;
use trestle_proto::observe::{Answers, ObserveAnswer, Part};
use trestle_proto::orders::Orders;
use trestle_proto::plan::{PLAN_KIND, RunPlan};
use trestle_proto::reply::{EVALUATION_KIND, Evaluation};

/// A decoder, and its name.
pub type Decoder = (&'static str, fn(&[u8]));

/// All of them.
pub const ALL: [Decoder; 10] = [
    ("messages", messages),
    ("frames", frames),
    ("map", map),
    ("foreign_map", foreign_map),
    ("config", config),
    ("demonstration", demonstration),
    ("import", import),
    ("replay", replay),
    ("manifest", manifest),
    ("hosts", hosts),
];

const DIM: usize = 2;
const ACTIONS: usize = 4;
const MENTOR: usize = 5;

/// The first bytes as a header, the rest as words.
fn message<H: Pod>(bytes: &[u8]) -> (H, Vec<u32>) {
    let mut head = vec![0; size_of::<H>()];
    let split = head.len().min(bytes.len());
    head[..split].copy_from_slice(&bytes[..split]);
    (pod_read_unaligned(&head), words(&bytes[split..]))
}

/// What actors act with, of a network of one input and two outputs.
fn acting() -> Acting {
    let own = OwnPlaces { lengths: vec![2], places: vec![1.0, 0.5, 2.0, 0.5] };
    let options =
        acting::Options { of: vec![0], ends: vec![2], actions: vec![3, 1], states: vec![1.0, 0.5, 2.0, 0.5] };
    Acting { weights: vec![0.5, -1.0, 2.0, 3.0], known: vec![1, NONE], policy: vec![0.25], options, own }
}

fn words(bytes: &[u8]) -> Vec<u32> {
    bytes.chunks_exact(4).map(pod_read_unaligned).collect()
}

/// What arrives in shared memory.
fn messages(bytes: &[u8]) {
    let (header, payload) = message::<BatchHeader>(bytes);
    let (mut batch, spaces) =
        (Checked::<Batch>::default(), Spaces { actors: 3, row: DIM.into(), n_actions: ACTIONS });
    if batch.receive(header, &payload, &spaces).is_ok() {
        for index in 0..batch.len() {
            let t = batch.transition(index);
            assert!(t.obs.iter().chain(t.next_obs).chain([&t.reward]).all(|x| x.is_finite()));
            assert!((t.action as usize) < ACTIONS && t.flags & !KNOWN_FLAGS == 0);
        }
    }
    let (orders, _) = message::<Orders>(bytes);
    if orders.validate(7).is_ok() {
        assert!(orders.run == 7 && orders.stop < 2);
    }
    let (header, payload) = message::<ActingHeader>(bytes);
    let mut into = Acting::zeros(acting().lengths());
    let options = OptionRoom { mentor: 2, steps: 3, obs_dim: DIM, n_actions: ACTIONS };
    let rooms = Rooms { options, own: Room { dim: 2, paths: 3, places: 4 } };
    if header.receive(7, &[1, 2], &payload, &rooms, &mut into).is_ok() {
        for steps in (0..2).filter_map(|j| into.options.get(j)) {
            assert!(
                (1..=3).contains(&steps.actions.len()) && steps.states.len() == DIM * steps.actions.len()
            );
            assert!(steps.actions.iter().all(|&action| (action as usize) < ACTIONS));
            assert!(steps.states.iter().all(|x| x.is_finite()));
        }
        let places: u32 = into.own.lengths.iter().sum();
        assert!(into.own.lengths.len() <= 3 && into.own.places.len() == 2 * places as usize);
        assert!(into.own.places.iter().all(|x| x.is_finite()));
    }
    let (answer, payload) = message::<ObserveAnswer>(bytes);
    let mut answers = Answers::default();
    let tables = [0, 3].map(|further| AnnotationTable::new(MENTOR, DIM, ACTIONS).keeping(further));
    for mut table in tables {
        let record = table.record_words();
        let _ = answers.receive(&answer, &payload, [2, 1].into_iter(), record, MENTOR);
        for answer in answers.parts() {
            assert!(answer.mentor.iter().all(|&j| j == NONE || (j as usize) < MENTOR));
            let _ = table.apply(&answer.changed);
        }
        let _ = table.apply(&words(bytes));
        for j in 0..MENTOR {
            assert!(table.estimate(j).is_none_or(|estimate| (estimate.action as usize) < ACTIONS));
            assert!(table.bridge(j).is_none_or(|bridge| (bridge.action as usize) < ACTIONS));
            let length = table.bridge(j).map_or(0, |bridge| bridge.length as usize);
            assert!(table.further(j).is_none_or(|further| {
                further.actions.len() + 1 == length
                    && further.actions.iter().all(|&action| (action as usize) < ACTIONS)
                    && further.states.len() == DIM * further.actions.len()
            }));
        }
    }
    let mut parts = &payload[..];
    while let Some(part) = Part::take(&mut parts, DIM) {
        assert_eq!(part.payload.len(), batch::words(part.count as usize, DIM));
        let _ = part.check(&spaces, &mut Vec::new());
    }
    let mut transitions = MentorTransitions::new(DIM);
    let _ = transitions.decode(&words(bytes));
    assert!((0..transitions.len()).all(|j| transitions.state(j).iter().all(|x| x.is_finite())));
}

/// Frames: as they are, and with the header that makes their bytes the body.
fn frames(bytes: &[u8]) {
    let _ = RunPlan::decode(bytes);
    let _ = RunPlan::decode(&framed(PLAN_KIND, bytes));
    let _ = codec::decode::<Evaluation>(EVALUATION_KIND, bytes);
    let _ = codec::decode::<Evaluation>(EVALUATION_KIND, &framed(EVALUATION_KIND, bytes));
    let mut worker = worker();
    let before = worker.snapshot().unwrap();
    for snapshot in [bytes.to_vec(), framed(STATE_KIND, bytes)] {
        if worker.restore(&snapshot).is_err() {
            assert_eq!(worker.snapshot().unwrap(), before, "a refused snapshot changes nothing");
        }
    }
}

/// A frame of `kind` around `body`, whatever that is.
fn framed(kind: Kind, body: &[u8]) -> Vec<u8> {
    let length = (body.len() as u64).to_le_bytes();
    let checksum = crc32c::crc32c(body).to_le_bytes();
    [&kind.magic[..], &kind.version.to_le_bytes(), &length, &checksum, body].concat()
}

/// A configuration with every setting.
fn complete() -> Config {
    config::from_table(registry(), config::Table::new(), &["run.episodes=1".into()]).unwrap()
}

/// An actor on the smallest of mazes.
fn worker() -> Worker {
    let mut config = complete();
    config.env.own.insert("map_text".into(), "S.\n.G\n".into());
    let env = registry().build(&config.env).unwrap();
    let spec = env.spec().clone();
    Worker::new(&Experiment { config, spec, mentors: Vec::new(), waypoints: None }, 0).unwrap()
}

/// A map's text.
fn map(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    if let Ok(map) = Map::parse("map", &text) {
        assert!(map.is_free(map.start()) && map.is_free(map.goal()));
    }
}

/// A map's text in another form.
fn foreign_map(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    let ends = Choices { start: Some([0, 0]), goal: Some([1, 0]), zero_is_wall: false };
    for choices in [Choices::default(), ends] {
        if let Ok(imported) = of_text("map", &text, &choices) {
            assert_eq!(Map::parse("map", &imported.map.to_string()).unwrap(), imported.map);
        }
    }
    let numbers: Vec<f64> = bytes.iter().map(|&byte| f64::from(byte)).collect();
    for width in 1..4 {
        let rows: Vec<Vec<f64>> = numbers.chunks_exact(width).map(<[f64]>::to_vec).collect();
        let _ = of_numbers("map", &rows, &ends);
    }
}

/// A configuration's text.
fn config(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    if let Ok(config) = config::parse_toml("config", &text)
        && config.validate().is_ok()
    {
        let again = config::parse_toml("again", &config::to_toml(&config)).unwrap();
        assert_eq!(again, config);
    }
}

/// A demonstration's file.
fn demonstration(bytes: &[u8]) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("demo.csv");
    fs::write(&path, bytes).unwrap();
    if let Ok(demo) = demo_file::read(&path) {
        assert!(demo.n_transitions() > 0 && demo.states().iter().all(|x| x.is_finite()));
    }
}

/// A file to be imported, whatever its format.
fn import(bytes: &[u8]) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("data");
    fs::write(&path, bytes).unwrap();
    let columns = |text: &str| Options { columns: Some(text.parse().unwrap()), ..Options::default() };
    let key = |key: &str| Options { key: Some(key.into()), ..Options::default() };
    for options in [Options::default(), columns("x,y"), columns("0..2"), key("joints"), key("*/*/obs/*")] {
        if let Ok(imported) = import::import(&path, &options) {
            let demo = imported.demonstration;
            assert!(demo.n_transitions() > 0 && demo.states().iter().all(|x| x.is_finite()));
        }
    }
    let _ = import::grid(&path, 100);
}

/// The files of a replay: the head, then a segment that begins where bytes 8 to 15 of the head say.
fn replay(bytes: &[u8]) {
    let mut replay = Replay::new(8, DIM).unwrap();
    let split = bytes.len().min(64 + 8 * 8);
    let (head, segment) = bytes.split_at(split);
    if replay.read_head(&mut &head[..]).is_err() {
        return;
    }
    let bounds = Bounds { n_actions: ACTIONS, mentor_len: MENTOR, actors: 3 };
    let spans: Vec<Span> = replay.segments(&[]).into_iter().map(|(span, _)| span).collect();
    for &span in &spans {
        if replay.read_segment(span, &mut &segment[..]).is_ok() && replay.check(&bounds).is_ok() {
            let entry = replay.get(replay.slot(span.first));
            assert!((entry.action as usize) < ACTIONS);
        }
    }
}

/// A MANIFEST that its COMPLETE vouches for.
fn manifest(bytes: &[u8]) {
    let dir = tempfile::tempdir().unwrap();
    let own = checkpoint::directory(dir.path(), 3.into());
    fs::create_dir_all(&own).unwrap();
    fs::write(own.join("MANIFEST"), bytes).unwrap();
    fs::write(own.join("COMPLETE"), format!("{:08x}\n", crc32c::crc32c(bytes))).unwrap();
    // Its files are not there, so that it can never be whole.
    assert_eq!(checkpoint::newest_complete(dir.path()).unwrap(), None);
    let _ = checkpoint::load_actors(&own);
}

/// What comes from other hosts: frames as they are, frames that are sound but say anything, and the messages in them.
fn hosts(bytes: &[u8]) {
    if let Some(frame) = Frame::decode(bytes) {
        assert!(frame.bytes.len() < MAX_FRAME && frame.encode() == bytes);
        let _ = codec::decode::<Hello>(HELLO_KIND, frame.bytes);
        assert!(!frame.text().contains(char::is_control));
    }
    let mut stream = Stream::new(7, 4096);
    for (at, piece) in bytes.chunks(33).enumerate() {
        let (head, rest) = piece.split_at(piece.len().min(25));
        let mut numbers = [0; 24];
        numbers[..head.len().saturating_sub(1)].copy_from_slice(head.get(1..).unwrap_or_default());
        let number = |at: usize| u64::from_le_bytes(numbers[8 * at..][..8].try_into().unwrap());
        let kind = if piece[0] % 2 == 0 { frame::Kind::Chunk } else { frame::Kind::Last };
        let frame = Frame {
            kind,
            session: 7,
            number: number(0),
            acknowledged: number(1),
            room: number(2),
            bytes: rest,
        };
        let now = Duration::from_millis(at as u64);
        let encoded = frame.encode();
        stream.receive(&Frame::decode(&encoded).unwrap(), now);
        while let Ok(Some(message)) = stream.take() {
            assert!(message.len() <= 4096);
        }
        let _ = stream.poll(now);
    }
    if let Ok(FromHost::Batch(header, payload)) = FromHost::decode(bytes) {
        let spaces = Spaces { actors: 3, row: DIM.into(), n_actions: ACTIONS };
        let _ = Checked::<Batch>::default().receive(*header, &payload, &spaces);
    }
    let _ = FromHead::decode(bytes, &[0, 2]);
}

/// Sound inputs, from which damaged ones are made: a decoder's name and its bytes.
pub fn seeds() -> Vec<(&'static str, Vec<u8>)> {
    fn bytes<H: Pod + Zeroable>(header: H, payload: &[u32]) -> Vec<u8> {
        [bytemuck::bytes_of(&header), bytemuck::cast_slice(payload)].concat()
    }
    let mut batch = Batch::default();
    batch.prepare(BatchHeader { run: 7, count: 3, obs_dim: DIM as u32, ..BatchHeader::default() });
    let orders = Orders { run: 7, round: 1.into(), ..Orders::default() };
    let acting = acting();
    let mut payload = vec![0; acting.words()];
    acting.write(&mut payload);
    let answer = ObserveAnswer::default();
    let mut table = Vec::new();
    AnnotationTable::new(MENTOR, DIM, ACTIONS).encode(2, &mut table);
    let mut whole = AnnotationTable::new(MENTOR, DIM, ACTIONS).keeping(3);
    let next_obs = &[1.0, 2.0];
    let bridge =
        Bridge { action: 1, length: 3, reward: 0.5, end_kl: 0.0, next_obs, terminated: false, ahead: 1 };
    whole.set_bridge(2, &bridge);
    whole.set_further(2, [(0, &next_obs[..]), (3, &[2.0, 2.0])].into_iter());
    let mut whole_bridge = Vec::new();
    whole.encode(2, &mut whole_bridge);
    let config = complete();
    let evaluation = Evaluation { evaluation: 3, episodes: Vec::new(), guide_return: Some(-1.0) };
    let snapshot = worker().snapshot().unwrap();
    let mut replay = Replay::new(8, DIM).unwrap();
    for _ in 0..8 {
        replay.push(&batch.transition(0), 1, 2);
    }
    let (span, _) = replay.segments(&[])[0];
    let header = b"{'descr': '<f4', 'fortran_order': False, 'shape': (3, 2), }             \n";
    let npy = [&b"\x93NUMPY\x01\x00"[..], &(header.len() as u16).to_le_bytes(), header, &[0; 24]].concat();
    let entries = "{\"name\": \"model.safetensors\", \"bytes\": 4, \"crc32c\": 5}";
    let manifest = format!(
        "{{\"format\": {}, \"version\": \"0.1.0\", \"tick\": 3, \"configuration\": \"ab\", \"counters\": \
         {{\"episodes\": 1, \"env_steps\": 2, \"grad_steps\": 3}}, \"ended\": false, \"files\": [{entries}]}}",
        checkpoint::FORMAT
    );
    let hello = Hello { build: "0123456789abcdef".into(), name: "b".into(), actors: 2 };
    let grant = Grant { plan: vec![1, 2, 3], seats: Vec::new(), files: vec![("MANIFEST".into(), vec![4])] };
    let header_of_acting = ActingHeader::new(7, 0, 4.into(), &[1, 2], &acting);
    vec![
        ("messages", bytes(batch.header, batch.payload())),
        ("messages", bytes(orders, &[])),
        ("messages", bytes(ActingHeader::new(7, 0, 4.into(), &[1, 2], &acting), &payload)),
        ("messages", bytes(answer, &[1, NONE, 0, 2, 0])),
        ("messages", bytemuck::cast_slice(&table).to_vec()),
        ("messages", bytemuck::cast_slice(&whole_bridge).to_vec()),
        ("frames", codec::encode(EVALUATION_KIND, &evaluation).unwrap()),
        ("frames", snapshot.clone()),
        ("frames", snapshot[24..].to_vec()),
        ("map", b"S..\n.#.\n..G\n".to_vec()),
        ("config", config::to_toml(&config).into_bytes()),
        ("config", b"base = \"maze-small\"\n[learner]\nhidden = [8, 8]\n".to_vec()),
        ("demonstration", b"trajectory,terminal,x,y\n0,0,1,2\n0,0,2,2\n0,1,3,2\n".to_vec()),
        ("import", b"x,y\n1,2\n2,2\n3,2\n".to_vec()),
        ("import", npy),
        ("import", b"# x;y\n0,5;1\n\"2,5\";3\n".to_vec()),
        ("import", "\u{feff}x y done\n1 2 0\n".encode_utf16().flat_map(u16::to_le_bytes).collect()),
        ("import", include_bytes!("golden/foreign/records.npy").to_vec()),
        ("import", include_bytes!("golden/foreign/flat.npz").to_vec()),
        ("import", include_bytes!("golden/foreign/successors.npz").to_vec()),
        ("import", include_bytes!("golden/foreign/soft-link-to-group.hdf5").to_vec()),
        ("import", include_bytes!("golden/foreign/soft-link-needed-earliest.hdf5").to_vec()),
        ("import", include_bytes!("golden/foreign/user-block-latest.hdf5").to_vec()),
        ("import", include_bytes!("golden/foreign/float16.hdf5").to_vec()),
        ("foreign_map", b"[[1, 1, 1], [\"r\", 0, \"g\"], [1, 1, 1]]".to_vec()),
        ("foreign_map", b"+---+---+\n|S    G |\n+---+---+\n".to_vec()),
        ("foreign_map", b"#####\\#OOG#\\#####".to_vec()),
        ("foreign_map", b"1 1 1\n1 0 0\n".to_vec()),
        ("replay", [replay.head(), replay.segment(span)].concat()),
        ("manifest", manifest.into_bytes()),
        ("hosts", Frame::bare(frame::Kind::Last, 7, b"a message").encode()),
        ("hosts", Frame::bare(frame::Kind::Hello, 0, &codec::encode(HELLO_KIND, &hello).unwrap()).encode()),
        ("hosts", message::batch(&batch.header, batch.payload())),
        ("hosts", message::orders(&orders, &[0, 2], Some((&header_of_acting, &acting)))),
        ("hosts", message::grant(&grant).unwrap()),
        ("hosts", [&[1; 9][..], &[0; 24], &[2; 9], &[0; 24]].concat()),
    ]
}
