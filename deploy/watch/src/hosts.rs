//! Which names the page answers to.
//!
//! A page of another site cannot read what this server says, unless its name can be made to lead here (DNS rebinding). Then a
//! browser asks for that name, and is refused. An address in numbers is no name.

use std::net::IpAddr;

/// Whether a request for `host`, as its header has it, is for this server. `own`: the name of this machine, where others may
/// reach it.
pub(crate) fn is_own(host: &str, own: Option<&str>) -> bool {
    let name = match host.strip_prefix('[') {
        Some(rest) => match rest.split_once(']') {
            Some((address, port)) if is_port(port) => {
                return address.parse::<IpAddr>().is_ok_and(|ip| ip.is_ipv6());
            }
            _ => return false,
        },
        None => match host.split_once(':') {
            Some((name, port)) if is_port(&format!(":{port}")) => name,
            Some(_) => return false,
            None => host,
        },
    };
    let name = name.strip_suffix('.').unwrap_or(name);
    name.eq_ignore_ascii_case("localhost")
        || name.parse::<IpAddr>().is_ok()
        || own.is_some_and(|own| !own.is_empty() && name.eq_ignore_ascii_case(own))
}

/// Whether `text` is nothing, or a colon and a number.
fn is_port(text: &str) -> bool {
    text.is_empty() || text.strip_prefix(':').is_some_and(|port| port.parse::<u16>().is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_others_are_refused() {
        for host in [
            "localhost",
            "localhost:8080",
            "LOCALHOST.",
            "127.0.0.1:80",
            "[::1]:8080",
            "[::1]",
            "10.0.0.7",
            "node7:1",
        ] {
            assert!(is_own(host, Some("node7")), "{host}");
        }
        for host in [
            "",
            "evil.example",
            "evil.example:8080",
            "localhost.evil.example",
            "localhost:80@evil",
            "[evil]",
            "[::1",
            "node7",
            ":80",
        ] {
            assert!(!is_own(host, None), "{host}");
        }
    }
}
