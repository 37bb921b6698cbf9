//! The Zenoh session of a host.
//!
//! A joining host publishes under `trestle/up/ID` and hears `trestle/down/ID`, with an identity that it has drawn. The host
//! that listens hears them all. Nothing is looked for in the network: there is one endpoint, and it is named.

use crate::credentials::Credentials;
use crate::url::Url;
use crate::{Failure, pipe};
use std::io::{stderr, stdin};
use std::os::unix::process::parent_id;
use std::process;
use std::sync::mpsc::{RecvTimeoutError, SyncSender, TryRecvError, sync_channel};
use std::thread;
use std::time::Duration;
use tracing_subscriber::EnvFilter;
use zenoh::bytes::ZBytes;
use zenoh::key_expr::KeyExpr;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::Sample;
use zenoh::{Config, Session, Wait};

/// Hosts at once: as many as a run has actors, and some that are on their way out.
const MAX_HOSTS: usize = 80;
/// Links whose other end has not proved who it is yet.
const MAX_PENDING: usize = 16;
/// Largest message that is put together for a peer, bytes. Zenoh's own limit is a gigabyte.
const MAX_MESSAGE: usize = 131_072;
/// How long a message may wait for the network before Zenoh gives the link up, microseconds.
const PATIENCE_US: u64 = 20_000_000;
/// Records that may wait to be published. More wait in the pipe.
const WAITING: usize = 16;
/// How long another program may still have the port: the one before this one, whose starter was killed, needs a moment to notice.
const BIND_MS: u32 = 5000;
/// How often this program looks whether its starter is still there.
const LOOK: Duration = Duration::from_millis(100);

/// Lets Zenoh say on standard error what goes wrong: standard output is for records.
fn log() {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("warn"));
    let subscriber = tracing_subscriber::fmt().with_env_filter(filter).with_writer(stderr).with_ansi(false);
    let _ = subscriber.try_init();
}

/// Listens at `url` for other hosts, until standard input ends.
pub(crate) fn listen(url: &Url, credentials: Option<&str>) -> Result<(), Failure> {
    log();
    leave_with(parent_id());
    let mut config = config(url, credentials)?;
    set(&mut config, "mode", "\"router\"")?;
    set(&mut config, "listen/endpoints", &format!("[{:?}]", url.locator))?;
    set(&mut config, "listen/exit_on_failure", "true")?;
    set(&mut config, "listen/timeout_ms", &BIND_MS.to_string())?;
    set(
        &mut config,
        "listen/retry",
        r#"{"period_init_ms":100,"period_max_ms":400,"period_increase_factor":2.0}"#,
    )?;
    let output = pipe::output();
    let session = zenoh::open(config).wait().map_err(|error| {
        format!(
            "{}: cannot listen there for {BIND_MS} ms ({error}); is it this host's, and free?",
            url.locator
        )
    })?;
    let heard = output.clone();
    let subscriber = session.declare_subscriber("trestle/up/*").callback(move |sample| {
        let peer =
            sample.key_expr().as_str().rsplit('/').next().and_then(|id| u64::from_str_radix(id, 16).ok());
        if let Some(peer) = peer.filter(|&peer| peer != pipe::NEWS) {
            hand_on(&heard, peer, &sample);
        }
    });
    let _subscriber = subscriber.wait()?;
    carry(&session, &output, |peer| format!("trestle/down/{peer:016x}"))
}

/// Connects to the host that listens at `url`, as `id`, and again whenever the connection is lost, until standard input ends.
pub(crate) fn connect(url: &Url, id: u64, credentials: Option<&str>) -> Result<(), Failure> {
    log();
    leave_with(parent_id());
    let mut config = config(url, credentials)?;
    set(&mut config, "mode", "\"client\"")?;
    set(&mut config, "connect/endpoints", &format!("[{:?}]", url.locator))?;
    set(&mut config, "connect/timeout_ms", "-1")?;
    set(&mut config, "connect/exit_on_failure", "false")?;
    set(
        &mut config,
        "connect/retry",
        r#"{"period_init_ms":200,"period_max_ms":1000,"period_increase_factor":2.0}"#,
    )?;
    let output = pipe::output();
    // Opening waits until there is a connection; the process that started this one may be gone before.
    let (sender, opened) = sync_channel(1);
    thread::spawn(move || sender.send(zenoh::open(config).wait()));
    greet(&output)?;
    let (records, waiting) = sync_channel(WAITING);
    thread::spawn(move || read_on(records));
    let session = loop {
        match opened.recv_timeout(Duration::from_millis(100)) {
            Ok(session) => break session?,
            Err(RecvTimeoutError::Disconnected) => return Err("Zenoh did not start".into()),
            Err(RecvTimeoutError::Timeout) => loop {
                match waiting.try_recv() {
                    // Nobody hears these.
                    Ok(_) => {}
                    Err(TryRecvError::Empty) => break,
                    Err(TryRecvError::Disconnected) => return Ok(()),
                }
            },
        }
    };
    let subscriber = session
        .declare_subscriber(format!("trestle/down/{id:016x}"))
        .callback(move |sample| hand_on(&output, 0, &sample));
    let _subscriber = subscriber.wait()?;
    let key = KeyExpr::try_from(format!("trestle/up/{id:016x}"))?;
    for (_, bytes) in waiting {
        put(&session, &key, bytes);
    }
    Ok(())
}

/// What both sides have in common.
pub(crate) fn config(url: &Url, credentials: Option<&str>) -> Result<Config, Failure> {
    let mut config = Config::default();
    set(&mut config, "scouting/multicast/enabled", "false")?;
    set(&mut config, "scouting/gossip/enabled", "false")?;
    set(&mut config, "transport/unicast/max_sessions", &MAX_HOSTS.to_string())?;
    set(&mut config, "transport/unicast/accept_pending", &MAX_PENDING.to_string())?;
    set(&mut config, "transport/link/rx/max_message_size", &MAX_MESSAGE.to_string())?;
    let wait = "transport/link/tx/queue/congestion_control/block/wait_before_close";
    set(&mut config, wait, &PATIENCE_US.to_string())?;
    let protocol = if url.tls { r#"["tls"]"# } else { r#"["tcp"]"# };
    set(&mut config, "transport/link/protocols", protocol)?;
    match (url.tls, credentials) {
        (true, Some(file)) => Credentials::read(file)?.apply(&mut config)?,
        (true, None) => {
            return Err(format!(
                "{} needs --credentials; `trestle hosts credentials` makes them",
                url.locator
            )
            .into());
        }
        (false, Some(_)) => {
            return Err(format!("--credentials are for tls/HOST:PORT, not for {}", url.locator).into());
        }
        (false, None) => {}
    }
    Ok(config)
}

/// Sets `key` and makes sure that it has this value: Zenoh takes keys that it does not know.
pub(crate) fn set(config: &mut Config, key: &str, value: &str) -> Result<(), Failure> {
    config.insert_json5(key, value)?;
    let found = config.get_json(key)?;
    let bare = |text: &str| text.replace([' ', '\n'], "");
    if bare(&found) != bare(value) {
        return Err(format!("Zenoh has {key} = {found}; {value} was asked for").into());
    }
    Ok(())
}

/// Ends this program as soon as its starter, `parent`, is gone. The end of standard input says so as well, but a record may wait for
/// the network meanwhile, and the next relay needs the port.
fn leave_with(parent: u32) {
    thread::spawn(move || {
        while parent_id() == parent {
            thread::sleep(LOOK);
        }
        process::exit(0);
    });
}

fn greet(output: &SyncSender<pipe::Record>) -> Result<(), Failure> {
    Ok(output.send((pipe::NEWS, pipe::GREETING.into()))?)
}

/// Hands a message on. A message that finds no room is dropped, as Zenoh's thread must not wait.
fn hand_on(output: &SyncSender<pipe::Record>, peer: u64, sample: &Sample) {
    let bytes = sample.payload();
    if bytes.len() <= pipe::MAX_BYTES {
        let _ = output.try_send((peer, bytes.to_bytes().into_owned()));
    }
}

/// Publishes what comes from standard input, until its end.
fn carry(
    session: &Session,
    output: &SyncSender<pipe::Record>,
    key: impl Fn(u64) -> String,
) -> Result<(), Failure> {
    greet(output)?;
    while let Some((peer, bytes)) = pipe::read(&mut stdin().lock())? {
        put(session, &KeyExpr::try_from(key(peer))?, bytes);
    }
    Ok(())
}

/// Hands what comes from standard input to another thread, until its end.
fn read_on(records: SyncSender<pipe::Record>) {
    loop {
        match pipe::read(&mut stdin().lock()) {
            Ok(Some(record)) => _ = records.send(record),
            Ok(None) => return,
            Err(failure) => {
                eprintln!("error: {failure}");
                process::exit(1);
            }
        }
    }
}

/// Publishes one message. It may wait for the network; where there is no connection it is lost.
fn put(session: &Session, key: &KeyExpr<'_>, bytes: Vec<u8>) {
    let put = session
        .put(key, ZBytes::from(bytes))
        .congestion_control(CongestionControl::Block)
        .priority(Priority::Data)
        .express(true);
    if let Err(error) = put.wait() {
        eprintln!("warning: {error}");
    }
}
