//! Every service of a run with all its limits. The supervisor creates and holds them; the other processes open them,
//! because a process that dies while it creates a service would leave it unusable.

use super::bell::Bells;
use super::sizes::Sizes;
use super::{Departure, Domain, Ipc, Wire, failed};
use crate::LinkError;
use iceoryx2::prelude::{Node, ServiceName, ZeroCopySend};
use iceoryx2::service::port_factory::{publish_subscribe, request_response};
use std::fmt::Debug;
use trestle_proto::acting::ActingHeader;
use trestle_proto::batch::BatchHeader;
use trestle_proto::limits::{MAX_ACTORS, MAX_QUERY_CLIENTS, REPLIES_BUFFER};
use trestle_proto::message::Message;
use trestle_proto::observe::{ObserveAnswer, ObserveRequest};
use trestle_proto::orders::Orders;
use trestle_proto::plan::RunPlan;
use trestle_proto::query::{QueryAnswer, QueryRequest};
use trestle_proto::reply::ReplyHeader;

/// The mentor-server's number among the peers that say hello; the actors have those below.
pub(super) const MENTOR_PEER: usize = MAX_ACTORS as usize;
/// Processes besides actors and query clients: supervisor, learner, mentor-server, and as many again while one is
/// replaced.
const OTHER_NODES: usize = 6;

type Topic<T, H> = publish_subscribe::PortFactory<Ipc, [T], Wire<H>>;
type Exchange<Q, H, A> = request_response::PortFactory<Ipc, [Q], Wire<H>, [u32], Wire<A>>;

/// All services of a run, opened. They exist for as long as a process holds this.
#[derive(Debug)]
pub(super) struct Services {
    pub(super) sizes: Sizes,
    pub(super) run: u64,
    pub(super) transitions: Topic<u32, BatchHeader>,
    pub(super) weights: Topic<u32, ActingHeader>,
    pub(super) orders: Topic<u8, Orders>,
    pub(super) replies: Topic<u8, ReplyHeader>,
    pub(super) observe: Exchange<u32, ObserveRequest, ObserveAnswer>,
    pub(super) query: Exchange<f32, QueryRequest, QueryAnswer>,
    pub(super) bells: Bells,
    /// Goes after everything that lives in it.
    pub(super) node: Node<Ipc>,
    /// Goes after everything that leaves a file.
    _departure: Departure,
}

/// What happens to a message whose receivers have no room for it.
#[derive(Clone, Copy)]
enum Full {
    /// The sender waits.
    Wait,
    /// It replaces the older one, and a receiver that comes late gets it, too.
    Replace,
}

/// How a process comes by a service.
#[derive(Clone, Copy)]
struct Way<'a> {
    node: &'a Node<Ipc>,
    /// Most processes at once.
    nodes: usize,
    /// The supervisor creates what the others open.
    create: bool,
}

/// Ends a builder the one or the other way.
macro_rules! finish {
    ($builder:expr, $create:expr, $name:expr) => {{
        let failed = |message: String| LinkError::Transport {
            what: if $create { "creating a service" } else { "opening a service" },
            message: format!("{}: {message}", $name),
        };
        let builder = $builder;
        if $create {
            builder.create().map_err(|e| failed(e.to_string()))
        } else {
            builder.open().map_err(|e| failed(e.to_string()))
        }
    }};
}

impl Way<'_> {
    fn name(&self, name: &str) -> Result<ServiceName, LinkError> {
        format!("trestle/{name}").as_str().try_into().map_err(failed("naming a service"))
    }

    /// A service that `senders` at the most send messages to, and `receivers` receive from, for each of which as many as `buffer`
    /// messages of each sender wait.
    fn topic<T, H>(
        &self,
        name: &str,
        senders: usize,
        receivers: usize,
        buffer: usize,
        full: Full,
    ) -> Result<Topic<T, H>, LinkError>
    where
        T: Debug + ZeroCopySend,
        H: Message + Debug,
    {
        let replace = matches!(full, Full::Replace);
        finish!(
            self.node
                .service_builder(&self.name(name)?)
                .publish_subscribe::<[T]>()
                .user_header::<Wire<H>>()
                .max_publishers(senders)
                .max_subscribers(receivers)
                .max_nodes(self.nodes)
                .subscriber_max_buffer_size(buffer)
                .subscriber_max_borrowed_samples(1)
                .history_size(usize::from(replace))
                .enable_safe_overflow(replace),
            self.create,
            name
        )
    }

    /// A service of the mentor-server that `clients` at the most ask, each one question at a time.
    fn exchange<Q, H, A>(&self, name: &str, clients: usize) -> Result<Exchange<Q, H, A>, LinkError>
    where
        Q: Debug + ZeroCopySend,
        H: Message + Debug,
        A: Message + Debug,
    {
        finish!(
            self.node
                .service_builder(&self.name(name)?)
                .request_response::<[Q], [u32]>()
                .request_user_header::<Wire<H>>()
                .response_user_header::<Wire<A>>()
                .max_servers(1)
                .max_clients(clients)
                .max_nodes(self.nodes)
                .max_active_requests_per_client(1)
                .max_response_buffer_size(1)
                .max_borrowed_responses_per_pending_response(1)
                .max_loaned_requests(1)
                .enable_safe_overflow_for_requests(false)
                .enable_safe_overflow_for_responses(false)
                .enable_fire_and_forget_requests(false),
            self.create,
            name
        )
    }
}

impl Services {
    /// Creates every service of `plan`'s run; the supervisor alone does this.
    pub(super) fn create(domain: &Domain, plan: &RunPlan) -> Result<Self, LinkError> {
        Self::build(domain, plan, true)
    }

    /// Opens every service of `plan`'s run.
    ///
    /// # Errors
    /// There is no supervisor that holds them; the remains of such a run are removed.
    pub(super) fn open(plan: &RunPlan) -> Result<Self, LinkError> {
        Self::build(&Domain::of(plan.life.run), plan, false)
    }

    /// Removes the remains of the run's dead processes, so that others can take their places. False: something is left.
    pub(super) fn reap(&self) -> bool {
        let cleaned = self.node.try_cleanup_dead_nodes();
        // A process that waits for a dead one learns of its death.
        if cleaned.cleanups > 0
            && let Err(error) = self.bells.ring_everybody()
        {
            tracing::warn!("{error}");
        }
        cleaned.failed_cleanups == 0
    }

    fn build(domain: &Domain, plan: &RunPlan, create: bool) -> Result<Self, LinkError> {
        let departure = Departure::of(domain);
        if !departure.joined() {
            return Err(failed("joining the run")("it is not in progress, or another user's"));
        }
        let node = domain.node().map_err(failed("joining the run"))?;
        let sizes = Sizes::of(&plan.experiment);
        // Twice, so that the places of a dead process keep no living one out.
        let actors = 2 * sizes.actors;
        let way = Way { node: &node, nodes: actors + MAX_QUERY_CLIENTS + OTHER_NODES, create };
        let buffer = sizes.transitions_buffer();
        Ok(Self {
            run: plan.life.run,
            // name, senders, receivers, messages that wait, and where there is no room for more
            transitions: way.topic("transitions", actors, 1, buffer, Full::Wait)?,
            replies: way.topic("replies", actors, 1, REPLIES_BUFFER, Full::Wait)?,
            weights: way.topic("weights", 1, actors, 1, Full::Replace)?,
            orders: way.topic("orders", 1, actors, 1, Full::Replace)?,
            // name, clients
            observe: way.exchange("mentor/observe", 1)?,
            query: way.exchange("mentor/query", MAX_QUERY_CLIENTS)?,
            bells: Bells::new(domain, create)?,
            node,
            sizes,
            _departure: departure,
        })
    }
}
