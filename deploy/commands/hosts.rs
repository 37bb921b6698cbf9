//! `trestle hosts`

use super::join::own_name;
use crate::carrier;
use crate::cli::HostsCommand;
use crate::status::ExitCode;
use anyhow::{Context, Result, ensure};
use std::net::{IpAddr, Ipv4Addr, UdpSocket};

pub(super) fn run(command: &HostsCommand) -> Result<ExitCode> {
    let HostsCommand::Credentials { out, names } = command;
    let names = if names.is_empty() { own_names() } else { names.clone() };
    let mut program = carrier::command()?;
    program.arg("credentials").arg(out).args(&names);
    let status = program.status().context("cannot start trestle-relay")?;
    ensure!(status.success(), "no credentials were made, for the reason above");
    outln!(
        "head.pem is for a host that others reach as one of: {}; --name makes it for other names",
        names.join(", ")
    );
    Ok(ExitCode::SUCCESS)
}

/// Names by which other hosts probably reach this one, and by which it reaches itself.
fn own_names() -> Vec<String> {
    let mut names: Vec<String> = own_name().into_iter().collect();
    let others = own_address().map(|address| address.to_string()).into_iter();
    for name in others.chain(["localhost", "127.0.0.1"].map(String::from)) {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    names
}

/// The address from which this host speaks to other networks, if it has a route there.
fn own_address() -> Option<IpAddr> {
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).ok()?;
    // This looks up the route and sends nothing. The address is reserved for documentation.
    socket.connect((Ipv4Addr::new(192, 0, 2, 1), 9)).ok()?;
    let address = socket.local_addr().ok()?.ip();
    (!address.is_loopback() && !address.is_unspecified()).then_some(address)
}
