//! The transport as a whole.

use super::services::Services;
use super::sizes::Sizes;
use super::{
    Domain, DomainError, HeldDomain, IceoryxActor, IceoryxClient, IceoryxLearner, IceoryxMentor, failed,
};
use crate::{Footprint, Host, LinkError, Liveness, Remains, Transport};
use std::fs;
use trestle_proto::experiment::Experiment;
use trestle_proto::plan::RunPlan;

/// The shared memory of this machine, between processes that see the same `/dev/shm`.
#[derive(Clone, Copy, Debug, Default)]
pub struct SharedMemory;

/// The services of a run, and its place among the files in shared memory.
#[derive(Debug)]
pub struct IceoryxHost {
    services: Services,
    /// Goes after everything that lives in it.
    domain: HeldDomain,
}

impl Host for IceoryxHost {
    fn reap(&self) -> bool {
        self.services.reap()
    }

    fn remove(&self) -> Result<(), LinkError> {
        self.domain.remove().map_err(not_removed)
    }
}

fn not_removed(error: DomainError) -> LinkError {
    failed("removing what the run shared")(error)
}

impl Transport for SharedMemory {
    type Host = IceoryxHost;
    type Learner = IceoryxLearner;
    type Actor = IceoryxActor;
    type Mentor = IceoryxMentor;
    type Client = IceoryxClient;

    fn host(&self, plan: &RunPlan) -> Result<IceoryxHost, LinkError> {
        let domain = Domain::create(plan.life.run).map_err(failed("making the run's place"))?;
        let services = Services::create(&domain, plan)?;
        Ok(IceoryxHost { services, domain })
    }

    fn learner(&self, plan: &RunPlan) -> Result<IceoryxLearner, LinkError> {
        IceoryxLearner::new(Services::open(plan)?, plan.life.generation)
    }

    fn actor(&self, plan: &RunPlan, index: u32) -> Result<IceoryxActor, LinkError> {
        IceoryxActor::new(Services::open(plan)?, index)
    }

    fn mentor(&self, plan: &RunPlan) -> Result<IceoryxMentor, LinkError> {
        IceoryxMentor::new(Services::open(plan)?)
    }

    fn client(&self, plan: &RunPlan) -> Result<IceoryxClient, LinkError> {
        IceoryxClient::new(Services::open(plan)?)
    }

    fn liveness(&self, run: u64) -> Liveness {
        Domain::of(run).liveness()
    }

    fn remove(&self, run: u64) -> Result<(), LinkError> {
        Domain::of(run).remove().map_err(not_removed)
    }

    fn runs(&self) -> Result<Vec<u64>, LinkError> {
        let all = Domain::all().map_err(failed("listing runs"))?;
        Ok(all.iter().map(Domain::run).collect())
    }

    fn remains(&self, run: u64) -> Result<Remains, LinkError> {
        let domain = Domain::of(run);
        let files = domain.shared_memory().map_err(failed("listing what a run shares"))?;
        let bytes = files.iter().filter_map(|file| fs::metadata(file).ok()).map(|meta| meta.len()).sum();
        Ok(Remains { files: files.len(), bytes, names: domain.names() })
    }

    fn footprint(&self, experiment: &Experiment) -> Footprint {
        let sizes = Sizes::of(experiment);
        Footprint {
            memory: sizes.shared_memory_bytes(),
            largest: sizes.largest_segment_bytes(),
            // Measured with 1 to 24 actors in both modes, and rounded up generously.
            files: 160 + 40 * sizes.actors as u64,
        }
    }
}
