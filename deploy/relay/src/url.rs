//! What may be listened at and connected to: `tcp/HOST:PORT` on this machine alone, `tls/HOST:PORT` anywhere.

use crate::Failure;
use std::net::{IpAddr, Ipv6Addr};

/// An endpoint.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Url {
    /// As Zenoh has it.
    pub(crate) locator: String,
    /// Whether both sides prove who they are, and nobody else can read along.
    pub(crate) tls: bool,
}

/// Checks `text`.
///
/// # Errors
/// No endpoint, or plain TCP beyond this machine without `insecure`.
pub(crate) fn checked(text: &str, insecure: bool) -> Result<Url, Failure> {
    let refused = || {
        format!("{text} is no URL of a run; accepted: tls/HOST:PORT, or tcp/127.0.0.1:PORT on one machine")
    };
    let (protocol, address) = text.split_once('/').ok_or_else(refused)?;
    let (host, port) = address.rsplit_once(':').ok_or_else(refused)?;
    let bare = host.strip_prefix('[').and_then(|host| host.strip_suffix(']'));
    let named = |host: &str| {
        !host.is_empty() && host.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_'))
    };
    let known = match bare {
        Some(host) => host.parse::<Ipv6Addr>().is_ok(),
        None => named(host),
    };
    if !known || port.parse::<u16>().is_err() {
        return Err(refused().into());
    }
    let tls = match protocol {
        "tls" => true,
        "tcp" => false,
        _ => return Err(refused().into()),
    };
    let here = host == "localhost" || bare.unwrap_or(host).parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback());
    if !tls && !here && !insecure {
        return Err(format!(
            "{text}: anybody on the way could read and change what plain TCP carries; accepted: tls/{address} with \
             --credentials (`trestle hosts credentials` makes them), or --insecure in a network that you trust"
        )
        .into());
    }
    Ok(Url { locator: text.into(), tls })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn plain_tcp_stays_on_the_machine() {
        for here in ["tcp/127.0.0.1:7447", "tcp/localhost:1", "tcp/[::1]:65535"] {
            assert!(!checked(here, false).unwrap().tls);
        }
        for away in ["tcp/0.0.0.0:7447", "tcp/head:7447", "tcp/[::]:7447"] {
            assert!(checked(away, false).unwrap_err().to_string().contains("--insecure"));
            assert!(!checked(away, true).unwrap().tls);
        }
        assert!(checked("tls/0.0.0.0:7447", false).unwrap().tls);
    }

    #[test]
    fn what_is_no_endpoint_is_refused() {
        for text in [
            "",
            "tcp",
            "tcp/",
            "tcp/head",
            "tcp/head:",
            "tcp/:7447",
            "tcp/head:70000",
            "udp/head:7447",
            "tcp/a b:1",
            "tcp/head#iface=eth0:1",
            "tcp/head?x=1:1",
            "tcp/[fe80::1:7447",
        ] {
            assert!(
                checked(text, true).unwrap_err().to_string().contains("accepted: tls/HOST:PORT"),
                "{text}"
            );
        }
    }
}
