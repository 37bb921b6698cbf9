//! The live page as a command, and beside a training.

use crate::util::{
    LIMIT, Outcome, Place, Process, free_port, result, start, start_under, trestle, wait_until,
};
use nix::sys::signal::Signal;
use serde_json::Value;
use std::fs;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::fs::PermissionsExt;

/// The body of the answer to a GET, if there is one.
fn get(port: u16, path: &str) -> Option<String> {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).ok()?;
    stream.set_read_timeout(Some(LIMIT)).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").ok()?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer).ok()?;
    answer.strip_prefix("HTTP/1.1 200 OK\r\n")?.split_once("\r\n\r\n").map(|(_, body)| body.into())
}

/// The state of a page, once there is one that fits.
fn state(port: u16, path: &str, fits: impl Fn(&Value) -> bool) -> Value {
    let mut state = Value::Null;
    let found = wait_until(LIMIT, || {
        let body = get(port, path).unwrap_or_default();
        state = serde_json::from_str(&body).unwrap_or_default();
        fits(&state)
    });
    assert!(found, "{path}: {state}");
    state
}

fn watch(dir: &str, port: u16) -> Process {
    start(&["watch", dir, "--port", &port.to_string()])
}

#[test]
fn a_folder_is_shown_before_during_and_after_its_runs() {
    let (place, port) = (Place::new(), free_port());
    let page = watch(&place.path("runs"), port);
    state(port, "/state", |state| state["kind"] == "missing");
    let out = place.path("runs/live");
    let run = start(&["train", "maze-small", "--seed", "3", "--quiet", "--out", &out]);
    let live = state(port, "/state/live", |state| state["state"] == "running");
    assert_eq!((&live["facts"]["arm"], &live["facts"]["seed"]), (&"trestle".into(), &3.into()));
    run.signal(Signal::SIGINT);
    run.finish();
    let over = state(port, "/state/live", |state| state["state"] == "interrupted");
    assert_eq!(over["env_steps"], result(&place.run("runs/live")).env_steps as f64);
    let all = state(port, "/state", |state| state["rows"][0]["state"] == "interrupted");
    assert_eq!(all["rows"][0]["name"], "live");
    let moments = get(port, "/timeline/0/live").unwrap();
    let moments: Value = serde_json::from_str(&moments).unwrap();
    let last = moments["moments"].as_array().unwrap().last().unwrap();
    assert_eq!(last["env_steps"], result(&place.run("runs/live")).env_steps);
    assert!(get(port, "/").unwrap().contains("<title>Trestle</title>"));
    page.signal(Signal::SIGTERM);
    assert!(page.finish().stdout.contains(&format!("http://127.0.0.1:{port}/")));
}

/// A run with its page has the results of one without.
#[test]
fn a_run_shows_itself_and_is_none_the_other() {
    let (place, port) = (Place::new(), free_port());
    let args = ["train", "maze-small", "--env-steps", "6000", "--quiet", "--out"];
    let (plain, shown) = (place.path("plain"), place.path("shown"));
    trestle(&[&args[..], &[&plain]].concat()).ok();
    let watched = trestle(&[&args[..], &[&shown, &format!("--watch={port}")]].concat()).ok();
    assert!(watched.stderr.contains(&format!("watch: http://127.0.0.1:{port}/")), "{watched:?}");
    let [plain, shown] = ["plain", "shown"].map(|name| result(&place.run(name)).weights_sha256);
    assert_eq!(plain, shown);
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let taken = format!("--watch={}", taken.local_addr().unwrap().port());
    let other = place.path("other");
    trestle(&[&args[..], &[&other, &taken]].concat()).refused(&["cannot listen on", "accepted"]);
    assert!(!place.run("other").root().exists(), "nothing is begun");
}

#[test]
fn a_path_that_is_no_folder_is_refused() {
    let place = Place::new();
    let file = place.write("file", "");
    let said = trestle(&["watch", &file, "--port", "0"]);
    assert_eq!(said.stderr.matches("not a directory").count(), 1, "the reason is said once: {said:?}");
    said.refused(&["cannot watch", "accepted: a directory"]);
    trestle(&["watch", &place.path("x"), "--bind", "300.1.1.1"]).code(2);
}

#[test]
fn an_evaluation_becomes_a_picture_and_the_best_weights_are_kept() {
    let place = Place::new();
    place.train("run", &["maze-small", "--env-steps", "16000", "--seed", "7"]);
    let root = place.path("run");
    let best: Value = {
        let printed = trestle(&["eval", &root, "--checkpoint", "best", "--episodes", "1", "--json"]).ok();
        serde_json::from_str(&printed.stdout).unwrap()
    };
    assert_eq!(best["mean_return"].as_f64(), result(&place.run("run")).best_return);
    for (name, begins) in
        [("a.gif", &b"GIF89a"[..]), ("b.png", b"\x89PNG"), ("c.svg", b"<svg"), ("f.pdf", b"%PDF")]
    {
        let file = place.path(name);
        let printed = trestle(&["eval", &root, "--checkpoint", "best", "--picture", &file]).ok();
        assert!(printed.stdout.contains(&format!("picture: {file}")), "{printed:?}");
        assert!(fs::read(&file).unwrap().starts_with(begins), "{name}");
    }
    // Episodes of another seed are drawn over the same mentor.
    let seeded = place.path("e.svg");
    trestle(&["eval", &root, "--checkpoint", "best", "--seed", "8", "--picture", &seeded]).ok();
    let [plain, seeded] = [place.path("c.svg"), seeded].map(|file| fs::read_to_string(file).unwrap());
    assert!(plain.contains("mentor") && seeded.contains("mentor"), "{seeded}");
    let again = place.path("a.gif");
    trestle(&["eval", &root, "--picture", &again]).refused(&["a.gif exists", "--overwrite"]);
    trestle(&["eval", &root, "--picture", &again, "--overwrite"]).ok();
    let other = place.path("d.jpg");
    trestle(&["eval", &root, "--picture", &other]).refused(&["d.jpg", ".gif, .png, .svg, .pdf"]);
    fs::remove_file(place.run("run").best()).unwrap();
    trestle(&["eval", &root, "--checkpoint", "best"]).refused(&["no weights of a best evaluation", "last"]);
}

/// `trestle sync` where programs are looked for in the directory `bin` alone.
fn sync(bin: &str, args: &[&str]) -> Outcome {
    start_under(&["/usr/bin/env", &format!("PATH={bin}")], &[&["sync"], args].concat()).finish()
}

/// What sends runs to trackers is Python's.
#[test]
fn sync_says_where_it_is_to_be_had() {
    let place = Place::new();
    place.train("run", &["maze-small", "--env-steps", "600"]);
    let root = place.path("run");
    trestle(&["sync", &root, "--to", "elsewhere"]).code(2);
    trestle(&["sync", &place.path("none"), "--to", "wandb"]).refused(&["is no directory", "accepted: a run"]);
    // A Python without the package, and none at all.
    let bin = place.path("bin");
    fs::create_dir(&bin).unwrap();
    let missing = sync(&bin, &[&root, "--to", "mlflow"]);
    missing.refused(&["cannot start python3", "pip install 'trestle-rl[mlflow]'"]);
    let python = place.write("bin/python3", "#!/bin/sh\nexit 1\n");
    fs::set_permissions(&python, fs::Permissions::from_mode(0o755)).unwrap();
    let without = sync(&bin, &[&root, "--to", "wandb"]);
    without.refused(&["python3 has no package trestle", "pip install 'trestle-rl[wandb]'"]);
    // One with it gets the order.
    fs::write(&python, "#!/bin/sh\n[ \"$1\" = -c ] || echo \"$@\"\n").unwrap();
    let sent = sync(&bin, &[&root, "--to", "trackio", "--once"]).ok();
    let order = sent.stdout.trim().strip_prefix("-m trestle tracker-sync ").unwrap();
    let order: Value = serde_json::from_str(order).unwrap();
    assert_eq!(
        (&order["to"], &order["dir"], &order["once"]),
        (&"trackio".into(), &root.into(), &true.into())
    );
}
