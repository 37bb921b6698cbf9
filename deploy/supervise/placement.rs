//! On which processors the processes of a run work.
//!
//! In lockstep with one actor that waits for the newest weights, they take turns: one works while the others wait for it. The
//! scheduler spreads them over idle processors all the same, and each turn then begins by waking one up, which takes far
//! longer than going over to the next process on the same one. So they are kept together for as long as no other
//! program wants their processor. What a run comes to does not depend on it.

use super::children::Child;
use crate::machine::{listed, one_processor, own_processors, words_of_stat};
use anyhow::{Context, Result};
use nix::unistd::{SysconfVar, sysconf};
use std::fs;
use std::time::{Duration, Instant};
use trestle_proto::config::{Config, Mode};

/// How often it is looked whether the processes are well placed.
pub(super) const LOOK: Duration = Duration::from_millis(500);
/// How many processors must have been idle or the run's own for the processes to be put together: theirs, and most of another
/// for everybody else.
const ROOM: f64 = 1.75;
/// For which share of the time the processor that they are put on must have been idle. The run itself may have used the rest.
const IDLE: f64 = 0.4;
/// For which share of the time others may use it. A program that computes there gets a half.
const OTHERS: f64 = 0.2;
/// How long the scheduler has a free hand after others have come: twice as long each time, up to a limit, and again from the
/// beginning once nobody has come for [`QUIET`].
const PAUSE: Duration = Duration::from_secs(10);
const LONGEST_PAUSE: Duration = Duration::from_secs(640);
const QUIET: Duration = Duration::from_secs(60);

/// Keeps the processes of a run together while that is of use.
#[derive(Debug)]
pub(super) struct Placement {
    /// The processors that the run may use.
    allowed: Vec<usize>,
    /// What had been used at the last look.
    last: Option<Usage>,
    /// The processor that they are on together, as a position in `allowed`, and since when.
    together: Option<(usize, Instant)>,
    /// Until when the processes are left to the scheduler.
    left_until: Option<Instant>,
    pause: Duration,
}

/// What is to be done with the processes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Move {
    /// Onto the processor at this position in [`Placement::allowed`].
    Together(usize),
    /// To wherever the scheduler likes.
    Apart,
}

impl Placement {
    /// None where the processes do not take turns, where the user does not want it, and where there is one processor.
    pub(super) fn of(config: &Config) -> Option<Self> {
        let run = &config.run;
        let turns = run.mode == Mode::Lockstep && run.actors == 1 && run.lag == 0;
        if !turns || !config.supervise.one_cpu {
            return None;
        }
        let allowed = listed(&own_processors().ok()?);
        (allowed.len() > 1).then(|| Self::new(allowed))
    }

    fn new(allowed: Vec<usize>) -> Self {
        Self { allowed, last: None, together: None, left_until: None, pause: PAUSE }
    }

    /// Looks at what was used since the last call and moves the processes if that calls for it. To be called every
    /// [`LOOK`] once they all work.
    pub(super) fn look(&mut self, children: &[Child]) {
        if self.left_until.is_some_and(|until| Instant::now() < until) {
            return;
        }
        let moved = match Usage::of(&self.allowed, children) {
            // Runs that begin at the same time do not all look for a place from the same processor on.
            Ok(now) => self.decide(now, children.first().map_or(0, |learner| learner.id as usize)),
            Err(error) => {
                tracing::debug!("what the run's processes use is not known: {error:#}");
                self.unknown()
            }
        };
        let outcome = match moved {
            None => Ok(()),
            Some(Move::Together(at)) => one_processor(self.allowed[at])
                .map(|cpu| children.iter().for_each(|child| child.place_together(cpu))),
            // Not those of the beginning: they may have been changed since.
            Some(Move::Apart) => {
                own_processors().map(|cpus| children.iter().for_each(|child| child.place_apart(cpus)))
            }
        };
        if let Err(error) = outcome {
            tracing::debug!("the run's processes stay where they are: {error:#}");
        }
    }

    /// What is to be done with the processes now that so much has been used. A place for them is looked for from position
    /// `from` on.
    fn decide(&mut self, now: Usage, from: usize) -> Option<Move> {
        let at = now.at;
        let since = self.last.as_ref().map(|before| now.since(before));
        self.last = Some(now);
        let since = since?;
        match self.together {
            Some((on, begin)) => {
                if at - begin >= QUIET {
                    self.pause = PAUSE;
                }
                let others = 1.0 - since.idle[on] - since.ran;
                (others > OTHERS).then(|| self.part(at))
            }
            None => {
                let most = since.idle.iter().copied().fold(0.0, f64::max);
                if most < IDLE || since.idle.iter().sum::<f64>() + since.ran < ROOM {
                    return None;
                }
                let n = self.allowed.len();
                let on = (0..n).map(|i| (from + i) % n).find(|&on| since.idle[on] >= 0.9 * most)?;
                self.together = Some((on, at));
                Some(Move::Together(on))
            }
        }
    }

    /// What is to be done where it is not known what is used: nobody would see others come.
    fn unknown(&mut self) -> Option<Move> {
        self.last = None;
        self.together.is_some().then(|| self.part(Instant::now()))
    }

    fn part(&mut self, at: Instant) -> Move {
        (self.together, self.last) = (None, None);
        self.left_until = Some(at + self.pause);
        self.pause = (2 * self.pause).min(LONGEST_PAUSE);
        Move::Apart
    }
}

/// What has been used up to some moment.
#[derive(Clone, Debug)]
struct Usage {
    at: Instant,
    /// Time for which each of the run's processors had nothing to do.
    idle: Vec<Duration>,
    /// Time for which the run's processes ran, with all their threads.
    ran: Duration,
}

/// The same for a stretch of time, as shares of it.
#[derive(Clone, Debug)]
struct Shares {
    idle: Vec<f64>,
    ran: f64,
}

impl Usage {
    /// Up to now, on processors `allowed`.
    fn of(allowed: &[usize], children: &[Child]) -> Result<Self> {
        let second = sysconf(SysconfVar::CLK_TCK)?.filter(|&second| second > 0);
        let second = second.context("the kernel does not say how it counts time")?;
        let time = |ticks: u64| Duration::from_secs_f64(ticks as f64 / second as f64);
        let idle = idle_ticks(&fs::read_to_string("/proc/stat")?, allowed)?;
        let mut ran = 0;
        for child in children.iter().filter(|child| child.running) {
            ran += ticks_of_process(&fs::read_to_string(format!("/proc/{}/stat", child.id))?)?;
        }
        Ok(Self { at: Instant::now(), idle: idle.into_iter().map(time).collect(), ran: time(ran) })
    }

    fn since(&self, before: &Self) -> Shares {
        let time = (self.at - before.at).as_secs_f64();
        let share = |now: &Duration, before: &Duration| now.saturating_sub(*before).as_secs_f64() / time;
        let idle = self.idle.iter().zip(&before.idle).map(|(now, before)| share(now, before)).collect();
        Shares { idle, ran: share(&self.ran, &before.ran) }
    }
}

/// The ticks for which each of processors `allowed`, in ascending order, had nothing to do, or was itself not there, from the
/// text of /proc/stat: of each there is a line `cpuN user nice system idle iowait irq softirq steal ...`, in the same order.
fn idle_ticks(stat: &str, allowed: &[usize]) -> Result<Vec<u64>> {
    let line = |line: &str| -> Option<(usize, u64)> {
        let (name, counts) = line.strip_prefix("cpu")?.split_once(' ')?;
        let counts: Vec<u64> = counts.split(' ').map_while(|count| count.parse().ok()).collect();
        Some((name.parse().ok()?, counts.get(3)? + counts.get(4)? + counts.get(7).unwrap_or(&0)))
    };
    let mut lines = stat.lines().filter_map(line);
    let find = |&cpu| {
        lines
            .find(|line| line.0 == cpu)
            .map(|line| line.1)
            .with_context(|| format!("no processor {cpu} in /proc/stat"))
    };
    allowed.iter().map(find).collect()
}

/// The ticks for which a process ran, from the text of its /proc/PID/stat: the 14th word (user) and the 15th (system).
fn ticks_of_process(stat: &str) -> Result<u64> {
    let times = || -> Option<[u64; 2]> {
        let mut words = words_of_stat(stat)?.skip(11).map_while(|word| word.parse().ok());
        Some([words.next()?, words.next()?])
    };
    Ok(times().with_context(|| format!("no times in `{stat}`"))?.iter().sum())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// A run that is looked at every half second of a clock of its own.
    struct Watched {
        placement: Placement,
        used: Usage,
        start: Instant,
    }

    impl Watched {
        /// On `n` processors.
        fn new(n: usize) -> Self {
            let (start, mut placement) = (Instant::now(), Placement::new((0..n).collect()));
            let used = Usage { at: start, idle: vec![Duration::ZERO; n], ran: Duration::ZERO };
            assert_eq!(placement.decide(used.clone(), 0), None);
            Self { placement, used, start }
        }

        /// Half a second in which the processors were idle for shares `idle` and the processes kept `ran` of them busy.
        fn look_from(&mut self, from: usize, idle: &[f64], ran: f64) -> Option<Move> {
            let time = |share: f64| LOOK.mul_f64(share);
            self.used.at += LOOK;
            self.used.ran += time(ran);
            self.used.idle.iter_mut().zip(idle).for_each(|(sum, &idle)| *sum += time(idle));
            let left = self.placement.left_until.is_some_and(|until| self.used.at < until);
            if left { None } else { self.placement.decide(self.used.clone(), from) }
        }

        fn look(&mut self, idle: &[f64], ran: f64) -> Option<Move> {
            self.look_from(0, idle, ran)
        }

        fn seconds(&self) -> f64 {
            (self.used.at - self.start).as_secs_f64()
        }
    }

    #[test]
    fn processes_are_put_together_where_there_is_room() {
        let begins = |idle: &[f64], ran| Watched::new(idle.len()).look(idle, ran);
        // They use a whole processor in all, or hardly any.
        assert_eq!(begins(&[0.5, 0.5], 0.95), Some(Move::Together(0)));
        assert_eq!(begins(&[0.1, 0.9], 0.95), Some(Move::Together(1)));
        assert_eq!(begins(&[0.95, 0.95], 0.1), Some(Move::Together(0)));
        // Another program uses a whole processor, or a third of one.
        assert_eq!(begins(&[0.05, 0.05], 0.9), None);
        assert_eq!(begins(&[0.35, 0.35], 0.95), None);
        // Many are busy, and what is left of each is together more than one; or one of many is idle.
        assert_eq!(begins(&[0.1; 64], 0.9), None);
        assert_eq!(begins(&[&[0.1; 32], &[1.0][..], &[0.1; 31]].concat(), 0.9), Some(Move::Together(32)));
    }

    #[test]
    fn runs_that_begin_at_once_go_apart() {
        let place = |from| Watched::new(4).look_from(from, &[1.0, 0.2, 0.95, 1.0], 0.9);
        let places: Vec<_> = (6..10).map(place).collect();
        assert_eq!(places, [2, 3, 0, 2].map(|at| Some(Move::Together(at))));
    }

    #[test]
    fn they_stay_together_until_others_come() {
        let mut run = Watched::new(2);
        assert_eq!(run.look(&[0.5, 0.5], 0.95), Some(Move::Together(0)));
        // However much they have to do, and whatever becomes of the other processor.
        for (here, there) in [(0.0, 1.0), (0.0, 0.0), (0.9, 1.0)] {
            assert_eq!(run.look(&[here, there], 1.0 - here), None);
        }
        // What the kernel does for them is not others'.
        assert_eq!(run.look(&[0.0, 1.0], 0.85), None);
        assert_eq!(run.look(&[0.0, 1.0], 0.5), Some(Move::Apart));
    }

    #[test]
    fn each_time_others_come_the_scheduler_has_a_free_hand_for_longer() {
        let mut run = Watched::new(2);
        let mut parted = Vec::new();
        // They come as soon as the processes are together, and leave as soon as they are apart.
        let mut moved = None;
        while parted.len() < 9 {
            moved = match moved {
                Some(Move::Together(_)) => run.look(&[0.0, 1.0], 0.5),
                _ => run.look(&[0.5, 0.5], 0.95),
            };
            if moved == Some(Move::Apart) {
                parted.push(run.seconds());
            }
        }
        // After the pause it takes two looks to see what is used, and one to see the others come.
        let between: Vec<f64> = parted.windows(2).map(|pair| pair[1] - pair[0] - 1.0).collect();
        assert_eq!(between, [10.0, 20.0, 40.0, 80.0, 160.0, 320.0, 640.0, 640.0]);
        // After a minute in which nobody came it begins anew.
        while run.look(&[0.5, 0.5], 0.95).is_none() {}
        assert!((0..120).all(|_| run.look(&[0.0, 1.0], 1.0).is_none()));
        assert_eq!(run.look(&[0.0, 1.0], 0.5), Some(Move::Apart));
        let parted = run.seconds();
        while run.look(&[0.5, 0.5], 0.95).is_none() {}
        assert_eq!(run.seconds() - parted, 10.5);
    }

    #[test]
    fn nobody_is_kept_together_unwatched() {
        let mut run = Watched::new(2);
        assert_eq!(run.placement.unknown(), None);
        assert_eq!(run.look(&[0.5, 0.5], 0.95), None);
        assert_eq!(run.look(&[0.5, 0.5], 0.95), Some(Move::Together(0)));
        assert_eq!(run.placement.unknown(), Some(Move::Apart));
        assert_eq!(run.placement.unknown(), None);
    }

    #[test]
    fn the_kernels_tables_are_read() {
        let stat = "cpu  9 9 9 300 30 0 0 5 0\ncpu0 9 9 9 100 10 0 0 5 0\ncpu2 9 9 9 1 1 0 0 0 0\n\
                    cpu12 9 9 9 200 20 0\nintr 5\n";
        assert_eq!(idle_ticks(stat, &[0, 12]).unwrap(), [115, 220]);
        assert!(idle_ticks(stat, &[0, 1]).is_err());
        let words: Vec<String> = (3..=52).map(|word: u64| (word * word).to_string()).collect();
        let process = format!("17 (a) b) {}\n", words.join(" "));
        assert_eq!(ticks_of_process(&process).unwrap(), 14 * 14 + 15 * 15);
        assert!(ticks_of_process("17 (a) S 1").is_err());
    }

    #[test]
    fn what_this_machine_says_is_understood() {
        let cpus = listed(&own_processors().unwrap());
        assert_eq!(Usage::of(&cpus, &[]).unwrap().idle.len(), cpus.len());
        let ran = || ticks_of_process(&fs::read_to_string("/proc/self/stat").unwrap()).unwrap();
        let start = ran();
        let mut sum = 0u64;
        // Until the kernel has counted what this takes.
        while ran() == start {
            sum = std::hint::black_box(sum + 1);
        }
    }
}
