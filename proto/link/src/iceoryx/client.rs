//! A client of `mentor/query`.

use super::bell::{Bells, Consumer, Ear};
use super::services::Services;
use super::{Ipc, Wire, failed, give_up_in_time};
use crate::{ClientLink, LinkError};
use iceoryx2::port::client::Client;
use std::time::Duration;
use trestle_proto::query::{QueryAnswer, QueryRequest, status_text};

pub(super) type Port = Client<Ipc, [f32], Wire<QueryRequest>, [u32], Wire<QueryAnswer>>;

pub(super) fn port(services: &Services) -> Result<Port, LinkError> {
    services
        .query
        .client_builder()
        .initial_max_slice_len(services.sizes.obs_dim)
        .set_backpressure_handler(give_up_in_time)
        .create()
        .map_err(failed("creating a client of mentor/query"))
}

/// Any process that wants to ask a running mentor-server.
#[derive(Debug)]
pub struct IceoryxClient {
    port: Port,
    ear: Ear,
    services: Services,
}

impl IceoryxClient {
    /// Creates the client's port.
    pub(super) fn new(services: Services) -> Result<Self, LinkError> {
        Ok(Self { port: port(&services)?, ear: services.bells.ear(Consumer::Clients), services })
    }
}

impl ClientLink for IceoryxClient {
    fn ask(
        &self,
        request: &QueryRequest,
        payload: &[f32],
        into: &mut Vec<u32>,
        deadline: Duration,
    ) -> Result<QueryAnswer, LinkError> {
        let request = QueryRequest { run: self.services.run, ..*request };
        ask(&self.port, &self.services.bells, &self.ear, &request, payload, into, deadline)
    }
}

pub(super) fn ask(
    port: &Port,
    bells: &Bells,
    ear: &Ear,
    request: &QueryRequest,
    payload: &[f32],
    into: &mut Vec<u32>,
    deadline: Duration,
) -> Result<QueryAnswer, LinkError> {
    const WHAT: &str = "a query";
    let mut sending = port
        .loan_slice_uninit(payload.len())
        .map_err(failed("loaning memory for a query"))?
        .write_from_slice(payload);
    sending.user_header_mut().0 = *request;
    let pending = sending.send().map_err(failed("sending a query"))?;
    if pending.number_of_server_connections() == 0 {
        return Err(LinkError::Receivers { what: WHAT, found: 0, expected: 1 });
    }
    bells.ring(Consumer::Mentor)?;
    let answer = ear.wait(deadline, || {
        // Asked first: an answer may come, and end the connection, in between.
        let connected = pending.is_connected();
        let answer = pending.receive().map_err(failed("receiving from mentor/query"))?;
        if answer.is_none() && !connected {
            return Err(LinkError::Receivers { what: WHAT, found: 0, expected: 1 });
        }
        Ok(answer)
    })?;
    let answer = answer.ok_or_else(|| LinkError::Deadline {
        peer: "mentor-server".into(),
        what: WHAT,
        waited_ms: deadline.as_millis(),
    })?;
    let header = answer.user_header().0;
    if header.status != trestle_proto::query::OK {
        return Err(LinkError::Refused { what: WHAT, reason: status_text(header.status) });
    }
    into.clear();
    into.extend_from_slice(answer.payload());
    Ok(header)
}
