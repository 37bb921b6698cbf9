//! One run over several hosts, which are one machine here. A stand-in carries messages between them: TCP that loses, repeats and
//! reorders its records, and can be cut. `deploy/relay/tests` has the same with Zenoh, between hosts that share nothing.

use crate::util::{
    LIMIT, Place, Process, TRESTLE, Trace, assert_gone, counted, free_port, newest_checkpoint, process,
    processes, result, send, start_command, wait_until,
};
use nix::sys::signal::Signal;
use std::collections::BTreeMap;
use std::env;
use std::fs::{self, File, OpenOptions, Permissions};
use std::io::{Read, Write, stdin};
use std::net::{TcpListener, TcpStream};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, Mutex};
use std::thread;
use trestle::BUILD;
use trestle_hosts::RelayError;
use trestle_hosts::joined::{self, Options};
use trestle_hosts::message::Hello;
use trestle_hosts::wire::Program;
use trestle_proto::hosts_file::{self, HostState};
use trestle_proto::rundir::RunDir;

/// The stand-in's orders, in its environment: the percentage of records that it loses, the file that cuts it while it is
/// there, and the arguments of `trestle-relay`.
const ORDERS: &str = "TRESTLE_TEST_CARRIER";

/// A place with a stand-in for `trestle-relay`.
struct Hosts {
    place: Place,
    program: String,
    cut: PathBuf,
    url: String,
    /// Seconds after which a silent host counts as lost.
    silence: u32,
}

impl Hosts {
    /// Hosts whose stand-in loses `loss` percent of its records.
    fn new(loss: u32) -> Self {
        let place = Place::new();
        fs::create_dir(place.root().join("tmp")).unwrap();
        let cut = place.root().join("cut");
        let test = env::current_exe().unwrap();
        // The test harness's output must not come between records.
        let script = format!(
            "#!/bin/sh\nexec 3>&1 >/dev/null\nexport {ORDERS}=\"{loss} {} $*\"\nexec '{}' --exact hosts::stand_in --nocapture\n",
            cut.display(),
            test.display()
        );
        let program = place.write("carrier", script);
        fs::set_permissions(&program, Permissions::from_mode(0o755)).unwrap();
        Self { place, program, cut, url: format!("tcp/127.0.0.1:{}", free_port()), silence: 4 }
    }

    /// Hosts whose `trestle-relay` is the shell's `script`.
    fn scripted(script: &str) -> Self {
        let mut hosts = Self::new(0);
        hosts.program = hosts.place.write("script", format!("#!/bin/sh\n{script}"));
        fs::set_permissions(&hosts.program, Permissions::from_mode(0o755)).unwrap();
        hosts
    }

    fn start(&self, args: &[String]) -> Process {
        let (program, tmp) =
            (format!("TRESTLE_RELAY={}", self.program), format!("TMPDIR={}", self.tmp().display()));
        start_command(&["env", &program, &tmp, TRESTLE], args)
    }

    /// A run that waits for the actors of other hosts.
    fn head(&self, args: &[&str], remote: u32) -> Process {
        let (remote, silence) = (remote.to_string(), self.silence.to_string());
        let more = ["--remote-actors", &remote, "--listen", &self.url, "--host-silence", &silence];
        self.start(&self.place.training("run", &[args, &more].concat()))
    }

    fn join(&self, name: &str, actors: u32) -> Process {
        let (actors, silence) = (actors.to_string(), self.silence.to_string());
        let args = ["join", &self.url, "--actors", &actors, "--name", name, "--host-silence", &silence];
        self.start(&args.map(String::from))
    }

    /// Where joined hosts have their directories.
    fn tmp(&self) -> PathBuf {
        self.place.root().join("tmp")
    }

    /// The directory of the joined host that runs `actor`, once its relay and that actor are there.
    fn away(&self, actor: u32) -> PathBuf {
        let mut away = None;
        let there = |dir: &PathBuf| {
            process(dir, &format!("actor-{actor}")).is_some() && process(dir, "relay").is_some()
        };
        assert!(wait_until(LIMIT, || {
            let dirs = fs::read_dir(self.tmp()).unwrap().map(|entry| entry.unwrap().path());
            away = dirs.into_iter().find(there);
            away.is_some()
        }));
        away.unwrap()
    }

    fn dir(&self) -> RunDir {
        self.place.run("run")
    }

    /// Waits for the end of a run, which must equal `expected`.
    fn ends_as(&self, head: Process, hosts: Vec<Process>, expected: &Trace) {
        head.finish().ok();
        hosts.into_iter().for_each(|host| {
            host.finish().ok();
        });
        assert_gone(&self.dir());
        assert_eq!(&Trace::of(&self.dir()), expected);
    }
}

/// More bytes than a host sends before its first batch.
const SOME_BATCHES: u64 = 20_000;

const ARGS: [&str; 5] = ["maze-small", "--env-steps", "6000", "--seed", "11"];

/// The trace of the same run of three actors on one host.
fn on_one_host(more: &[&str]) -> Trace {
    Place::new().train("one", &[&ARGS[..], &["--actors", "3"], more].concat())
}

#[test]
fn two_hosts_end_with_the_weights_of_one() {
    for lag in ["run.lag=0", "run.lag=1"] {
        let hosts = Hosts::new(0);
        let head = hosts.head(&[&ARGS[..], &["--actors", "1", "--set", lag]].concat(), 2);
        let joined = hosts.join("b", 2);
        hosts.ends_as(head, vec![joined], &on_one_host(&["--set", lag]));
    }
}

#[test]
fn three_hosts_over_a_bad_network_end_with_the_weights_of_one() {
    let hosts = Hosts::new(10);
    let args = ["maze-small", "--env-steps", "2000", "--seed", "11"];
    let head = hosts.head(&[&args[..], &["--actors", "1"]].concat(), 2);
    let joined = vec![hosts.join("b", 1), hosts.join("c", 1)];
    let expected = Place::new().train("one", &[&args[..], &["--actors", "3"]].concat());
    hosts.ends_as(head, joined, &expected);
}

#[test]
fn a_network_that_is_cut_for_a_while_changes_nothing() {
    let hosts = Hosts::new(0);
    let mut head = hosts.head(&[&ARGS[..], &["--actors", "1"]].concat(), 2);
    let joined = hosts.join("b", 2);
    let dir = hosts.dir();
    head.wait_for("training", || fs::metadata(dir.metrics()).is_ok_and(|file| file.len() > 0));
    fs::write(&hosts.cut, "").unwrap();
    head.wait_for("lost records", || fs::metadata(&hosts.cut).is_ok_and(|file| file.len() >= 5));
    fs::remove_file(&hosts.cut).unwrap();
    hosts.ends_as(head, vec![joined], &on_one_host(&[]));
    assert_eq!(result(&dir).restarts, 0);
}

/// What the head's supervisor has said of hosts.
fn said(dir: &RunDir) -> String {
    fs::read_to_string(dir.log("supervisor")).unwrap_or_default()
}

#[test]
fn a_silent_host_is_named_before_it_is_lost_and_when_it_is_back() {
    let mut hosts = Hosts::new(0);
    hosts.silence = 600;
    let mut head = hosts.head(&[&ARGS[..], &["--actors", "1"]].concat(), 2);
    let joined = hosts.join("b", 2);
    let dir = hosts.dir();
    head.wait_for("training", || fs::metadata(dir.metrics()).is_ok_and(|file| file.len() > 0));
    fs::write(&hosts.cut, "").unwrap();
    let silent = "host b with actors 1, 2 has given no sign of life for ";
    head.wait_for("the silence", || said(&dir).contains(silent));
    assert!(said(&dir).contains(" s; the run waits for it, until 600 s have passed (--host-silence)"));
    assert!(!said(&dir).contains("is back"));
    fs::remove_file(&hosts.cut).unwrap();
    head.wait_for("its end", || said(&dir).contains("host b with actors 1, 2 is back after "));
    hosts.ends_as(head, vec![joined], &on_one_host(&[]));
    assert_eq!(said(&dir).matches("no sign of life").count(), 1);
    assert_eq!(result(&dir).restarts, 0);
}

/// A `trestle-relay` that never has a connection, and says why as Zenoh does: the same thing twice, and another one.
const UNCONNECTED: &str = r"
[ $1 = check ] && exit
log() { echo 2026-11-30T20:00:0$1Z $2 zenoh::net: $3 at /home/a/zenoh.rs:1.. Retry in $1 s. >&2; }
printf '\027\000\000\000\377\377\377\377\377\377\377\377trestle-relay 1'
log 1 DEBUG 'Try to connect'
log 2 WARN 'early eof from 127.0.0.1:40001'
log 3 WARN 'early eof from 127.0.0.1:40002'
log 4 DEBUG 'Unable to connect: no such host'
exec cat > /dev/null
";

#[test]
fn the_reason_why_there_is_no_connection_is_said_while_the_host_waits() {
    let hosts = Hosts::scripted(UNCONNECTED);
    let mut head = hosts.head(&[&ARGS[..], &["--actors", "1"]].concat(), 2);
    let mut joined = hosts.join("b", 1);
    let last = "trestle-relay says: Unable to connect: no such host";
    let dir = hosts.dir();
    head.wait_for("both reasons of the joined host", || joined.stderr_so_far().contains(last));
    head.wait_for("both reasons", || said(&dir).contains(last));
    assert!(joined.is_running() && head.is_running());
    for (process, text) in [(joined, None), (head, Some(said(&dir)))] {
        process.signal(Signal::SIGINT);
        let outcome = process.finish().code(130);
        let text = text.unwrap_or(outcome.stderr);
        assert_eq!(text.matches("trestle-relay says: early eof from 127.0.0.1:40001").count(), 1, "{text}");
        assert_eq!(text.matches("trestle-relay says: ").count(), 2, "{text}");
    }
}

#[test]
fn credentials_are_for_this_host_unless_names_are_given() {
    let hosts = Hosts::scripted("echo \"$@\"");
    let out = hosts.place.path("cred");
    let made = |more: &[&str]| {
        let args = [&["hosts", "credentials", "--out", &out][..], more].concat();
        hosts.start(&args.iter().map(ToString::to_string).collect::<Vec<_>>()).finish().ok().stdout
    };
    let own = fs::read_to_string("/proc/sys/kernel/hostname").unwrap();
    let text = made(&[]);
    let (asked, said) = text.split_once('\n').unwrap();
    let names: Vec<&str> = asked.strip_prefix(&format!("credentials {out} ")).unwrap().split(' ').collect();
    assert!(["localhost", "127.0.0.1", own.trim()].iter().all(|name| names.contains(name)), "{names:?}");
    assert!(said.contains(&format!("one of: {};", names.join(", "))), "{said}");
    let text = made(&["--name", "head", "--name", "10.0.0.5"]);
    assert!(text.starts_with(&format!("credentials {out} head 10.0.0.5\n")), "{text}");
    assert!(text.contains("one of: head, 10.0.0.5;"), "{text}");
}

/// A run with checkpoints that is well under way, with one other host.
fn under_way(hosts: &Hosts, more: &[&str]) -> (Process, Process) {
    let args = [&ARGS[..], &["--actors", "1", "--set", "checkpoint.every_env_steps=500"], more].concat();
    let mut head = hosts.head(&args, 2);
    let joined = hosts.join("b", 2);
    let dir = hosts.dir();
    head.wait_for("a checkpoint", || newest_checkpoint(&dir).is_some());
    (head, joined)
}

#[test]
fn what_dies_on_either_host_changes_nothing_in_lockstep() {
    for victim in [
        "actor",
        "relay of the joined host",
        "carrier of the joined host",
        "relay of the head",
        "carrier of the head",
        "the joined host",
        "the network",
    ] {
        let hosts = Hosts::new(0);
        let (mut head, mut joined) = under_way(&hosts, &[]);
        let away = hosts.away(1);
        match victim {
            "actor" => send(process(&away, "actor-1").unwrap(), Signal::SIGKILL),
            "relay of the joined host" => send(process(&away, "relay").unwrap(), Signal::SIGKILL),
            "carrier of the joined host" => send(carrier(&away), Signal::SIGKILL),
            "carrier of the head" => send(carrier(hosts.dir().root()), Signal::SIGKILL),
            "relay of the head" => send(process(hosts.dir().root(), "relay").unwrap(), Signal::SIGKILL),
            "the joined host" => {
                let all = processes(&away);
                send(joined.pid(), Signal::SIGKILL);
                all.iter().for_each(|(pid, _)| send(*pid, Signal::SIGKILL));
                joined.finish();
                joined = hosts.join("b", 2);
            }
            _ => {
                fs::write(&hosts.cut, "").unwrap();
                head.wait_for("the loss of the host", || head_has_lost(&hosts.dir()));
                fs::remove_file(&hosts.cut).unwrap();
            }
        }
        hosts.ends_as(head, vec![joined], &on_one_host(&["--set", "checkpoint.every_env_steps=500"]));
        assert!(result(&hosts.dir()).restarts > 0, "{victim}");
    }
}

/// The stand-in that the relay of the run in `dir` has started.
fn carrier(dir: &Path) -> u32 {
    let relay = process(dir, "relay").unwrap();
    let children = fs::read_to_string(format!("/proc/{relay}/task/{relay}/children")).unwrap();
    children.split_whitespace().next().unwrap().parse().unwrap()
}

fn head_has_lost(dir: &RunDir) -> bool {
    said(dir).contains("host b with actors 1, 2 has given no sign of life for 4 s")
}

#[test]
fn free_mode_goes_on_without_a_host_and_counts_each_step_once() {
    let hosts = Hosts::new(5);
    // Without an end of its own: the head's actor could reach any before the host is back.
    let args = ["maze-small", "--mode", "free", "--actors", "1", "--env-steps", "100000000", "--seed", "3"];
    let mut head = hosts.head(&args, 2);
    let joined = hosts.join("b", 2);
    let dir = hosts.dir();
    let away = hosts.away(2);
    head.wait_for("training", || dir.metrics().exists());
    send(process(&away, "actor-2").unwrap(), Signal::SIGKILL);
    let back = || {
        let rows = hosts_file::of_csv(&fs::read_to_string(dir.hosts()).unwrap_or_default());
        rows.len() >= 2 && rows.last().is_some_and(|row| row.bytes_received > SOME_BATCHES)
    };
    head.wait_for("batches of the host that is back", back);
    let told =
        || fs::read_to_string(dir.metrics()).is_ok_and(|text| text.contains("\"hosts/b/bytes_received\":"));
    head.wait_for("its metrics", told);
    head.signal(Signal::SIGINT);
    head.finish().code(130);
    joined.finish().ok();
    assert_gone(&dir);
    let rows = counted(&dir);
    assert_eq!(rows.iter().map(|row| row.env_steps).sum::<u64>(), result(&dir).env_steps, "{rows:?}");
    assert!(rows.iter().any(|row| row.actor > 0 && row.env_steps > 0), "{rows:?}");
    assert!(rows.iter().all(|row| row.host == if row.actor == 0 { "" } else { "b" }), "{rows:?}");
    assert_eq!(result(&dir).restarts, 0, "nothing of the run itself is started again");
    // It was there twice.
    let hosts = hosts_file::of_csv(&fs::read_to_string(dir.hosts()).unwrap());
    assert!(hosts.len() >= 2 && hosts.iter().all(|row| row.host == "b"), "{hosts:?}");
    assert!(hosts.iter().all(|row| row.state == HostState::Left && row.bytes_sent > 0), "{hosts:?}");
}

#[test]
fn what_cannot_be_is_refused_before_anything_is_started() {
    let hosts = Hosts::new(0);
    let out = hosts.place.path("run");
    let run = |args: &[&str]| {
        let args = [&["train", "maze-small", "--out", &out][..], args].concat();
        let outcome = hosts.start(&args.iter().map(ToString::to_string).collect::<Vec<_>>()).finish();
        assert!(!Path::new(&out).exists());
        outcome
    };
    run(&["--remote-actors", "2"]).refused(&["--listen"]);
    run(&["--remote-actors", "2", "--listen", &hosts.url]).refused(&[
        "--remote-actors 2",
        "run.actors",
        "--actors N",
    ]);
    run(&["--actors", "1", "--remote-actors", "1", "--listen", "udp/x"]).refused(&["udp/x", "accepted"]);
    run(&["--actors", "1", "--remote-actors", "1", "--listen", &hosts.url, "--mode", "reference"])
        .refused(&["reference"]);
    let missing = ["env", "TRESTLE_RELAY=/nowhere", TRESTLE];
    start_command(&missing, &["join", &hosts.url, "--actors", "1"])
        .finish()
        .refused(&["TRESTLE_RELAY", "/nowhere"]);
    hosts
        .start(&["join", &hosts.url, "--actors", "1", "--name", "a b"].map(String::from))
        .finish()
        .refused(&["--name"]);
    let waits = ["join", &hosts.url, "--actors", "1", "--wait", "1"].map(String::from);
    hosts.start(&waits).finish().code(1).refused(&["the head has not answered for 1 s"]);
}

#[test]
fn a_host_for_which_there_is_no_place_waits_and_leaves_when_it_is_told_to() {
    let hosts = Hosts::new(0);
    let endless = ["maze-small", "--actors", "1", "--env-steps", "100000000"];
    let mut head = hosts.head(&endless, 1);
    let joined = hosts.join("b", 4);
    let dir = hosts.dir();
    head.wait_for("training", || fs::metadata(dir.metrics()).is_ok_and(|file| file.len() > 0));
    let mut late = hosts.join("c", 1);
    let mut said = String::new();
    assert!(
        wait_until(LIMIT, || {
            said = late.stderr_so_far();
            said.contains("waiting: all 1 places for actors are taken (b has 1)")
        }),
        "{said}"
    );
    assert!(late.is_running());
    late.signal(Signal::SIGINT);
    late.finish().code(130);
    head.signal(Signal::SIGINT);
    head.finish().code(130);
    assert_gone(&dir);
    // The head has told it.
    joined.finish().ok();
}

#[test]
fn a_host_that_waits_for_a_place_leaves_with_the_run() {
    let hosts = Hosts::new(0);
    let slow = ["--set", "env.hazard.kind=slow", "--set", "env.hazard.after=1"];
    let args = [&["maze-small", "--actors", "1", "--env-steps", "12000"], &slow[..]].concat();
    let mut head = hosts.head(&args, 1);
    let joined = hosts.join("b", 1);
    let dir = hosts.dir();
    head.wait_for("training", || fs::metadata(dir.metrics()).is_ok_and(|file| file.len() > 0));
    let late = hosts.join("c", 1);
    head.wait_for("the other host", || late.stderr_so_far().contains("waiting: all 1 places"));
    for host in [head, joined, late] {
        host.finish().ok();
    }
    assert_gone(&dir);
}

#[test]
fn a_host_with_another_program_is_refused_and_both_sides_say_why() {
    let hosts = Hosts::new(0);
    let mut head = hosts.head(&["maze-small", "--actors", "1", "--env-steps", "3000"], 1);
    // The code of a joined host's relay, under the name of another build.
    let mut program = Command::new(&hosts.program);
    program.args(["connect", &hosts.url, "7"]);
    let mut wire = Program::start(program).unwrap();
    let options = Options {
        hello: Hello { build: "0123456789abcdef".into(), name: "stranger".into(), actors: 1 },
        silence: LIMIT,
        patience: LIMIT,
    };
    let refused = joined::join(&mut wire, &options, &|| false, &mut |_| {}).err();
    let expected = format!(
        "its program was built from other sources (0123456789abcdef) than the run's ({BUILD}); accepted: the same program on all hosts"
    );
    assert!(matches!(&refused, Some(RelayError::Refused(reason)) if *reason == expected), "{refused:?}");
    let refusal = format!("host stranger is refused: {expected}");
    head.wait_for("the refusal", || said(&hosts.dir()).contains(&refusal));
    drop(wire);
    // The run waits for one that may join.
    let joined = hosts.join("b", 1);
    head.finish().ok();
    joined.finish().ok();
}

/// The stand-in. The test does nothing, unless it is started as one.
#[test]
fn stand_in() {
    let Ok(orders) = env::var(ORDERS) else { return };
    let mut words = orders.split(' ');
    let loss: u32 = words.next().unwrap().parse().unwrap();
    let cut = PathBuf::from(words.next().unwrap());
    let (what, url) = (words.next().unwrap(), words.next().unwrap());
    let Some(address) = url.strip_prefix("tcp/") else {
        eprintln!("error: {url}; accepted: tcp/HOST:PORT");
        std::process::exit(1);
    };
    let channel = |seed| Channel { loss, cut: cut.clone(), state: seed, held: None };
    match what {
        "check" => {}
        "listen" => listen(address, channel(1)),
        _ => connect(address, u64::from_str_radix(words.next().unwrap(), 16).unwrap(), channel(2)),
    }
    std::process::exit(0);
}

/// The fate of records.
struct Channel {
    loss: u32,
    cut: PathBuf,
    state: u64,
    /// A record that comes after the next one.
    held: Option<Vec<u8>>,
}

impl Channel {
    fn draw(&mut self, of: u64) -> u64 {
        self.state =
            self.state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.state >> 33) % of
    }

    /// The records that come out when `record` goes in.
    fn pass(&mut self, record: Vec<u8>) -> Vec<Vec<u8>> {
        // The file's length says how many records were lost. It is not made here.
        if let Ok(mut cut) = OpenOptions::new().append(true).open(&self.cut) {
            cut.write_all(b".").unwrap();
            return Vec::new();
        }
        let loss = u64::from(self.loss);
        match self.draw(100) {
            at if at < loss => Vec::new(),
            at if at < 2 * loss => vec![record.clone(), record],
            at if at < 3 * loss => self.held.replace(record).into_iter().collect(),
            _ => [Some(record), self.held.take()].into_iter().flatten().collect(),
        }
    }
}

fn read(pipe: &mut impl Read) -> Option<(u64, Vec<u8>)> {
    let mut head = [0; 12];
    pipe.read_exact(&mut head).ok()?;
    let (length, peer) = (&head[..4], &head[4..]);
    let mut bytes = vec![0; u32::from_le_bytes(length.try_into().unwrap()) as usize - 8];
    pipe.read_exact(&mut bytes).ok()?;
    Some((u64::from_le_bytes(peer.try_into().unwrap()), bytes))
}

fn write(pipe: &mut impl Write, peer: u64, bytes: &[u8]) -> Option<()> {
    let head = [&(bytes.len() as u32 + 8).to_le_bytes()[..], &peer.to_le_bytes()].concat();
    pipe.write_all(&[&head, bytes].concat()).ok()
}

/// The pipe to the relay, greeted.
fn output() -> Arc<Mutex<File>> {
    let mut pipe = OpenOptions::new().write(true).open("/proc/self/fd/3").unwrap();
    write(&mut pipe, u64::MAX, b"trestle-relay 1").unwrap();
    Arc::new(Mutex::new(pipe))
}

fn listen(address: &str, mut channel: Channel) {
    let listener = TcpListener::bind(address).unwrap();
    let (output, hosts) = (output(), Arc::new(Mutex::new(BTreeMap::<u64, TcpStream>::new())));
    let known = hosts.clone();
    thread::spawn(move || {
        for stream in listener.incoming() {
            let (mut stream, output, known) = (stream.unwrap(), output.clone(), known.clone());
            thread::spawn(move || {
                while let Some((peer, bytes)) = read(&mut stream) {
                    known.lock().unwrap().entry(peer).or_insert_with(|| stream.try_clone().unwrap());
                    write(&mut *output.lock().unwrap(), peer, &bytes);
                }
            });
        }
    });
    while let Some((peer, bytes)) = read(&mut stdin().lock()) {
        let stream = hosts.lock().unwrap().get(&peer).map(|stream| stream.try_clone().unwrap());
        if let Some(mut stream) = stream {
            channel.pass(bytes).iter().for_each(|bytes| _ = write(&mut stream, 0, bytes));
        }
    }
}

fn connect(address: &str, id: u64, channel: Channel) {
    let output = output();
    let (link, channel) = (Arc::new(Mutex::new(None::<TcpStream>)), Arc::new(Mutex::new(channel)));
    let (again, address) = (link.clone(), address.to_string());
    thread::spawn(move || {
        loop {
            let mut found = None;
            wait_until(LIMIT, || {
                found = TcpStream::connect(&address).ok();
                found.is_some()
            });
            let Some(mut stream) = found else { continue };
            *again.lock().unwrap() = Some(stream.try_clone().unwrap());
            while let Some((_, bytes)) = read(&mut stream) {
                write(&mut *output.lock().unwrap(), 0, &bytes);
            }
        }
    });
    while let Some((_, bytes)) = read(&mut stdin().lock()) {
        let records = channel.lock().unwrap().pass(bytes);
        if let Some(stream) = link.lock().unwrap().as_mut() {
            records.iter().for_each(|bytes| _ = write(stream, id, bytes));
        }
    }
}
