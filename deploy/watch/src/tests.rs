#![allow(clippy::unwrap_used)]

use super::*;
use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

/// A page of a folder with one file of a secret beside it.
struct Served {
    address: SocketAddr,
    place: tempfile::TempDir,
}

fn served() -> Served {
    let place = tempfile::tempdir().unwrap();
    fs::create_dir(place.path().join("runs")).unwrap();
    fs::write(place.path().join("config.toml"), "secret").unwrap();
    let server = Server::bind(&place.path().join("runs"), "127.0.0.1".parse().unwrap(), Some(0)).unwrap();
    let address = server.address;
    server.serve_beside().unwrap();
    Served { address, place }
}

impl Served {
    fn connect(&self, request: &str) -> TcpStream {
        let mut stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        stream
    }

    /// The whole answer to a GET.
    fn get_as(&self, host: &str, path: &str) -> String {
        let request = format!("GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
        let mut answer = Vec::new();
        self.connect(&request).read_to_end(&mut answer).unwrap();
        String::from_utf8_lossy(&answer).into_owned()
    }

    fn get(&self, path: &str) -> String {
        self.get_as("localhost", path)
    }
}

#[test]
fn the_page_and_its_parts_are_served_with_a_policy() {
    let served = served();
    for path in ["/", "/run/a/b", "/asset/page.js", "/asset/page.css", "/asset/uPlot.js", "/asset/map.js"] {
        let answer = served.get(path);
        assert!(answer.starts_with("HTTP/1.1 200"), "{path}: {answer}");
        assert!(answer.contains("content-security-policy: default-src 'none'"), "{answer}");
    }
    assert!(served.get("/asset/none").starts_with("HTTP/1.1 404"));
    assert!(served.get("/state").contains("\"kind\":\"folder\""));
}

#[test]
fn another_name_for_this_server_is_refused() {
    let served = served();
    for path in ["/", "/state", "/events", "/asset/page.js", "/none"] {
        let answer = served.get_as("evil.example:8080", path);
        assert!(answer.starts_with("HTTP/1.1 403") && !answer.contains("kind"), "{answer}");
    }
}

#[test]
fn nothing_outside_the_folder_is_read() {
    let served = served();
    std::os::unix::fs::symlink(served.place.path(), served.place.path().join("runs/out")).unwrap();
    for below in ["..", "%2e%2e", "..%2f", "%2e%2e/runs", "out", "a/../..", "/etc", "%00", "a%00b", "."] {
        for route in ["settings", "state", "timeline/0", "events"] {
            let answer = served.get_head(&format!("/{route}/{below}"));
            assert!(!answer.contains("secret"), "{route} {below}: {answer}");
        }
    }
}

impl Served {
    /// The beginning of the answer, for streams have no end.
    fn get_head(&self, path: &str) -> String {
        let mut stream =
            self.connect(&format!("GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"));
        let mut bytes = vec![0; 1 << 16];
        let read = stream.read(&mut bytes).unwrap();
        String::from_utf8_lossy(&bytes[..read]).into_owned()
    }
}

/// Reads from a stream of events until `text` has come.
fn until(stream: &mut TcpStream, text: &str) -> String {
    let mut seen = String::new();
    let mut bytes = [0; 4096];
    while !seen.contains(text) {
        let read = stream.read(&mut bytes).unwrap();
        assert!(read > 0, "the stream has ended: {seen}");
        seen.push_str(&String::from_utf8_lossy(&bytes[..read]));
    }
    seen
}

#[test]
fn a_stream_tells_what_has_changed() {
    let served = served();
    let mut stream = served.connect("GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n");
    until(&mut stream, "\"kind\":\"folder\"");
    fs::create_dir(served.place.path().join("runs/sub")).unwrap();
    fs::rename(served.place.path().join("runs"), served.place.path().join("other")).unwrap();
    until(&mut stream, "\"kind\":\"missing\"");
    fs::rename(served.place.path().join("other"), served.place.path().join("runs")).unwrap();
    until(&mut stream, "\"kind\":\"folder\"");
}

#[test]
fn fifty_pages_are_open_at_once() {
    let served = served();
    let mut streams: Vec<TcpStream> =
        (0..50).map(|_| served.connect("GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")).collect();
    for stream in &mut streams {
        until(stream, "\"kind\":\"folder\"");
    }
    assert!(served.get("/").starts_with("HTTP/1.1 200"));
}

#[test]
fn a_port_that_is_taken_is_named() {
    let place = tempfile::tempdir().unwrap();
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let bind = |path: &Path| Server::bind(path, "127.0.0.1".parse().unwrap(), Some(port)).map(drop);
    let error = bind(place.path()).unwrap_err().to_string();
    assert!(error.contains(&port.to_string()) && error.contains("accepted: another --port"), "{error}");
    let file = place.path().join("file");
    fs::write(&file, "").unwrap();
    assert!(bind(&file).unwrap_err().to_string().contains("accepted: a directory"));
}
