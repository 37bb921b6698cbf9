//! What a seed makes of a schedule: a scene, how rarely threads give way, and the faults.

use super::world::{MS, Role};
use trestle_proto::rng::mix;

/// What befalls somebody.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum What {
    /// SIGKILL.
    Kill(Role),
    /// SIGKILL, and this many nanoseconds later the supervisor as well.
    Both(Role, u64),
    /// All processes at once.
    All,
    /// The process is not run for this many nanoseconds.
    Hold(Role, u64),
    /// All processes end, shared memory is gone, and of the disk what [`super::disk`] leaves.
    PowerCut,
    /// So many of the role's next calls that change a file fail with this errno.
    Io(Role, u32, i32),
    /// Ctrl-C.
    Stop,
    /// The user starts another one while the first still lives.
    Another,
}

/// Something that happens once so many calls and waits have been made.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fault {
    pub(super) after: u64,
    pub(super) what: What,
}

/// What is run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scene {
    /// One run, gone on with after each end.
    Run,
    /// A sweep of two runs.
    Sweep,
}

/// What was once wrong with the program. Put back, the simulation must find it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Flaw {
    /// The lock of a run's directory is the supervisor's alone, so it ends with it while the learner lives on.
    LockOfSupervisor,
    /// A start does not look for what the dead run has left in shared memory.
    NothingCleared,
    /// A sweep takes whatever is in a run's directory for a run to go on with.
    HalfForWhole,
}

/// A schedule.
#[derive(Clone, Debug)]
pub(super) struct Schedule {
    pub(super) seed: u64,
    pub(super) scene: Scene,
    /// Which of [`super::CONFIGS`].
    pub(super) config: usize,
    /// One in so many calls gives way.
    pub(super) rarely: u64,
    /// Whether the power may fail.
    pub(super) power: bool,
    /// Whether calls may fail.
    pub(super) io: bool,
    pub(super) faults: Vec<Fault>,
    pub(super) flaw: Option<Flaw>,
}

/// Calls and waits of an undisturbed run, about.
const STEPS: u64 = 2500;
/// Faults of a schedule, at most.
const MOST: u64 = 6;

impl Schedule {
    /// That of `seed`, over one of `configs` configurations.
    pub(super) fn of(seed: u64, configs: usize) -> Self {
        let mut word = mix(seed);
        let mut random = |below: u64| {
            word = mix(word.wrapping_add(0x9e37_79b9_7f4a_7c15));
            word % below
        };
        let scene = if random(4) == 0 { Scene::Sweep } else { Scene::Run };
        let config = random(configs as u64) as usize;
        let rarely = [4, 16, 64, 256][random(4) as usize];
        let (power, io) = (random(4) == 0, random(4) == 0);
        // Of some runs the start counts, of others the first ticks, or all.
        let span = [STEPS / 25, STEPS / 5, STEPS][random(3) as usize];
        let mut faults = Vec::new();
        let mut after = 0;
        for _ in 0..1 + random(MOST) {
            // Some come right after another one.
            after += if random(3) == 0 { random(60) } else { random(span) };
            let role = match random(5) {
                0 | 1 => Role::Learner,
                2 => Role::Supervisor,
                3 => Role::Mentor,
                _ => Role::Actor(0),
            };
            let what = match random(12) {
                0..=2 => What::Kill(role),
                3 | 4 => What::Both(role, random(50 * MS)),
                5 => What::All,
                6 => What::Kill(Role::Supervisor),
                7 => What::Hold(role, random(2000 * MS)),
                8 if power => What::PowerCut,
                9 if io => {
                    What::Io(role, 1 + random(3) as u32, [libc::EIO, libc::ENOSPC][random(2) as usize])
                }
                8 | 9 => What::Kill(role),
                10 => What::Stop,
                _ => What::Another,
            };
            faults.push(Fault { after, what });
        }
        Self { seed, scene, config, rarely, power, io, faults, flaw: None }
    }

    /// The same without faults.
    pub(super) fn calm(scene: Scene, config: usize) -> Self {
        Self { seed: 0, scene, config, rarely: 64, power: false, io: false, faults: Vec::new(), flaw: None }
    }
}
