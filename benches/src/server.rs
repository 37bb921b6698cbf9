//! A mentor-server in a world that an observer walks about in.

use crate::walk::{Walk, World};
use anyhow::Result;
use trestle_algorithm::mentor::Mentor;
use trestle_proto::batch::{Batch, BatchHeader, Checked, Spaces};
use trestle_proto::config::{self, Algo};
use trestle_proto::observe::Observed;

/// Features of a state.
pub const DIM: usize = 2;
/// Transitions in a batch.
pub const BATCH: u32 = 32;
const MENTOR: usize = 10_000;

/// The mentor-server, and who hands it batches.
pub struct Server {
    mentor: Mentor,
    walk: Walk,
    batch: Checked<Batch>,
    spaces: Spaces,
    observed: Observed,
    index: u64,
}

impl Server {
    /// A mentor-server that knows nothing yet, with a history of up to `stored` transitions.
    pub fn new(stored: usize) -> Result<Self> {
        let world = World::new(DIM, MENTOR, 0.0);
        let settings = config::Mentor::default();
        let demonstration = world.demonstration(MENTOR)?;
        Ok(Self {
            mentor: Mentor::new(&demonstration, &settings, Algo::HaDiiqn, &world.spec(), stored, 1)?,
            walk: world.walk(),
            batch: Checked::default(),
            spaces: Spaces { actors: 1, row: DIM.into(), n_actions: world.spec().n_actions() },
            observed: Observed::default(),
            index: 0,
        })
    }

    /// Has the observer take [`BATCH`] steps and hands them over. Returns them with the answer.
    pub fn observe(&mut self) -> Result<(&Checked<Batch>, &Observed)> {
        let header = BatchHeader { count: BATCH, obs_dim: DIM as u32, ..BatchHeader::default() };
        let mut batch = std::mem::take(&mut self.batch).into_inner();
        self.walk.fill(header, &mut batch);
        self.batch = batch.check(&self.spaces)?;
        self.mentor.observe(self.index, self.batch.transitions(), &mut self.observed)?;
        self.index += u64::from(BATCH);
        Ok((&self.batch, &self.observed))
    }
}
