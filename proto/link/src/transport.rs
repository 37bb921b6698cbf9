//! A way for the processes of a run to exchange messages, with the side of the process that holds the run.

use crate::{ActorLink, ClientLink, LearnerLink, LinkError, MentorLink};
use trestle_proto::experiment::Experiment;
use trestle_proto::plan::RunPlan;

/// A way for the processes of a run to exchange messages.
///
/// One process, the host, makes all that the run shares and holds it to the end of the run. Every other process opens its end with the
/// plan of the run. A value of this type says where runs are found; it holds none of them.
pub trait Transport {
    /// The host's hold on all that the run shares.
    type Host: Host;
    /// The learner's end.
    type Learner: LearnerLink;
    /// An actor's end.
    type Actor: ActorLink;
    /// The mentor-server's end.
    type Mentor: MentorLink;
    /// The end of a process that only asks the mentor-server.
    type Client: ClientLink;

    /// Makes all that `plan`'s run shares. The run is alive from now on, until the host is dropped.
    ///
    /// # Errors
    /// A run of this identity is there, or the system lacks something that the run needs.
    fn host(&self, plan: &RunPlan) -> Result<Self::Host, LinkError>;

    /// Opens the learner's end of `plan`'s run.
    ///
    /// # Errors
    /// No living run of this identity is within this process's reach. This holds for the other ends, too.
    fn learner(&self, plan: &RunPlan) -> Result<Self::Learner, LinkError>;

    /// Opens the end of actor `index` of `plan`'s run. For a moment there may be two of an index, when one replaces the other.
    ///
    /// # Errors
    /// As for [`learner`](Self::learner).
    fn actor(&self, plan: &RunPlan, index: u32) -> Result<Self::Actor, LinkError>;

    /// Opens the mentor-server's end of `plan`'s run.
    ///
    /// # Errors
    /// As for [`learner`](Self::learner).
    fn mentor(&self, plan: &RunPlan) -> Result<Self::Mentor, LinkError>;

    /// Opens a client's end of `plan`'s run.
    ///
    /// # Errors
    /// As for [`learner`](Self::learner), and when the run has as many clients as it can have.
    fn client(&self, plan: &RunPlan) -> Result<Self::Client, LinkError>;

    /// Whether the run `run` has a host.
    fn liveness(&self, run: u64) -> Liveness;

    /// Removes all that the run `run` shares. No process may need it any more. A run that is not there is no error: several processes
    /// may be removing the same run.
    ///
    /// # Errors
    /// The system refuses to remove a part of it.
    fn remove(&self, run: u64) -> Result<(), LinkError>;

    /// All runs of this user of which there is anything, living or dead, in ascending order.
    ///
    /// # Errors
    /// They cannot be listed.
    fn runs(&self) -> Result<Vec<u64>, LinkError>;

    /// The remains of the run `run`.
    ///
    /// # Errors
    /// It cannot be looked at.
    fn remains(&self, run: u64) -> Result<Remains, LinkError>;

    /// The most that a run of `experiment` takes of the machine.
    fn footprint(&self, experiment: &Experiment) -> Footprint;
}

/// The host's hold on a run. When it is dropped, all that the run shares is removed.
pub trait Host {
    /// Removes what dead processes of the run have left, so that others can take their places. False: something is left.
    fn reap(&self) -> bool;

    /// Removes all that the run shares at once: for a host that is about to kill the other processes, and may be killed itself.
    ///
    /// # Errors
    /// The system refuses to remove a part of it.
    fn remove(&self) -> Result<(), LinkError>;
}

/// Whether a run has a host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Liveness {
    /// Its host lives, here or in another container.
    Alive,
    /// Its host is gone. That stays so.
    Dead,
    /// There is nothing of it, or nothing yet.
    Absent,
    /// There is something of it, but nothing that tells whether its host lives.
    Unknown,
}

/// The remains of a run outside its directory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Remains {
    /// Files.
    pub files: usize,
    /// Their bytes.
    pub bytes: u64,
    /// A pattern of a shell's that names them all; empty where there are no files to name.
    pub names: String,
}

/// The most that a run takes of the machine for its messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Footprint {
    /// Bytes of shared memory.
    pub memory: u64,
    /// Bytes of the largest file in shared memory.
    pub largest: u64,
    /// Files in shared memory.
    pub files: u64,
}
