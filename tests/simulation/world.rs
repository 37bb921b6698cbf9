//! Processes and threads that take turns: a scheduler, a clock, and the ends of processes.
//!
//! Every simulated thread is a real one, but only one of them runs at a time. It gives way in each call that `calls` takes over and in
//! each wait, and the seed decides who goes on. Time stands still while somebody runs, but for a few microseconds a call; when
//! all wait, it leaps to the next deadline.
//!
//! *The end of a process* is at once: nothing that its threads do from then on has an effect, and each of their calls fails. They
//! run to their ends, in the order of their numbers, before anybody else runs. What the system would close for a killed
//! process is closed by their destructors, the locks of its files among it.

use super::disk::Disk;
use super::schedule::{Fault, Flaw, Schedule, What};
use std::any::Any;
use std::cell::Cell;
use std::collections::{BTreeMap, VecDeque};
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use trestle_link::local::{Want, Wire};
use trestle_proto::rng::mix;

/// Calls and waits after which a schedule counts as one without an end.
const MOST_STEPS: u64 = 400_000;
const US: u64 = 1_000;
pub(super) const MS: u64 = 1_000 * US;

/// What a process does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    /// Who types commands. Nothing ends it.
    User,
    /// `trestle train`, `resume` or `sweep`.
    Supervisor,
    Learner,
    Mentor,
    Actor(u32),
}

/// How a process ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum End {
    Exited(i32),
    Killed,
}

/// What reaches a supervisor, or the user.
#[derive(Clone, Debug)]
pub(super) enum Mail {
    /// The learner says that it gets ahead.
    Progress,
    /// A child has ended; `words`: the last line of its log.
    Ended { role: Role, end: End, words: String },
    /// Ctrl-C.
    Stop,
    /// The user is to start another one, whatever is there.
    Another,
}

/// What a thread waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum On {
    /// The clock alone.
    Time,
    /// Another thread's end.
    Thread(usize),
    /// The ends of all threads of this process but this one.
    Siblings,
    /// A process's end.
    Process(usize),
    /// Mail for this process.
    Mail,
    /// An event on the wire that the processes of the run share.
    Wire(u64, Want),
}

#[derive(Debug)]
enum Status {
    Ready,
    Waiting { on: On, until: Option<u64> },
    Done,
}

struct Thread {
    process: usize,
    status: Status,
    /// Its process has ended.
    dead: bool,
    turn: Arc<Turn>,
}

/// Where a thread waits for its turn.
#[derive(Default)]
pub(super) struct Turn {
    mine: Mutex<bool>,
    changed: Condvar,
}

impl Turn {
    fn give(&self) {
        *self.mine.lock().unwrap_or_else(PoisonError::into_inner) = true;
        self.changed.notify_one();
    }

    fn take(&self) {
        let mine = self.mine.lock().unwrap_or_else(PoisonError::into_inner);
        let mut mine = self.changed.wait_while(mine, |mine| !*mine).unwrap_or_else(PoisonError::into_inner);
        *mine = false;
    }
}

pub(super) struct Process {
    pub(super) role: Role,
    /// Who gets the news of its end.
    parent: Option<usize>,
    /// The command that it belongs to: a supervisor's number.
    pub(super) command: usize,
    pub(super) end: Option<End>,
    /// The last line that it would have logged.
    pub(super) words: String,
    /// The run's directory that it has written into, and may write into again.
    pub(super) writes: Option<PathBuf>,
    /// Whether it has been told to leave.
    pub(super) told: bool,
    /// It is not run before this time.
    stopped_until: u64,
    pub(super) mail: VecDeque<Mail>,
    /// What it has inherited, and closes at its end.
    held: Vec<OwnedFd>,
}

pub(super) struct State {
    threads: Vec<Thread>,
    pub(super) processes: Vec<Process>,
    pub(super) now: u64,
    word: u64,
    pub(super) steps: u64,
    /// One in so many calls gives way to another thread.
    rarely: u64,
    faults: VecDeque<Fault>,
    /// What happens at a time.
    later: Vec<(u64, What)>,
    /// Calls of a role that are to fail: how many, and with what.
    pub(super) broken: Option<(Role, u32, i32)>,
    pub(super) wires: BTreeMap<u64, Wire>,
    pub(super) disk: Disk,
    pub(super) failure: Option<String>,
    /// All that has happened, as a number.
    pub(super) trace: u64,
    /// The newest of it, in words.
    pub(super) log: VecDeque<String>,
    running: usize,
    joins: Vec<(u64, usize)>,
}

pub(super) struct World {
    state: Mutex<State>,
    pub(super) root: PathBuf,
    /// What has been put back that is mended.
    pub(super) flaw: Option<Flaw>,
    over: Turn,
}

/// What a thread knows of itself.
pub(super) struct Place {
    pub(super) world: Arc<World>,
    pub(super) thread: usize,
}

thread_local! {
    static PLACE: Cell<*const Place> = const { Cell::new(std::ptr::null()) };
    /// The process to which the thread belongs that this one starts next.
    static NEXT: Cell<Option<usize>> = const { Cell::new(None) };
}

/// What this thread is, if it is simulated.
#[allow(unsafe_code)]
pub(super) fn here() -> Option<&'static Place> {
    // SAFETY: the place is set by this thread for the time of its main function, which outlives every call within it.
    unsafe { PLACE.get().as_ref() }
}

/// Does `work` as a thread that is not simulated: for the simulation's own looks at files.
pub(super) fn aside<R>(work: impl FnOnce() -> R) -> R {
    let place = PLACE.replace(std::ptr::null());
    let done = work();
    PLACE.set(place);
    done
}

/// Whether this thread's process has ended.
pub(super) fn is_over() -> bool {
    here().is_some_and(|place| {
        let state = place.world.lock();
        state.threads[place.thread].dead
    })
}

impl State {
    pub(super) fn random(&mut self, below: u64) -> u64 {
        self.word = self.word.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mix(self.word) % below.max(1)
    }

    pub(super) fn note(&mut self, text: impl FnOnce() -> String) {
        if self.log.len() >= 400 {
            self.log.pop_front();
        }
        let (now, text) = (self.now, text());
        self.log.push_back(format!("{:>10.3} ms  {text}", now as f64 / MS as f64));
    }

    pub(super) fn fail(&mut self, text: String) {
        self.note(|| format!("FAILED: {text}"));
        self.failure.get_or_insert(text);
        // Everybody goes home.
        for at in 0..self.threads.len() {
            self.threads[at].dead = true;
        }
    }

    pub(super) fn process_of(&self, thread: usize) -> usize {
        self.threads[thread].process
    }

    pub(super) fn is_alive(&self, process: usize) -> bool {
        self.processes[process].end.is_none()
    }

    /// The newest living process of this role.
    fn newest(&self, role: Role) -> Option<usize> {
        self.processes.iter().rposition(|process| process.role == role && process.end.is_none())
    }

    /// Whether nothing will befall anybody any more.
    pub(super) fn is_quiet(&self) -> bool {
        self.faults.is_empty() && self.later.is_empty() && self.broken.is_none()
    }

    /// Ends a process at once.
    pub(super) fn kill(&mut self, process: usize) {
        if self.processes[process].end.is_none() {
            let role = self.processes[process].role;
            self.note(|| format!("{role:?} {process} is killed"));
            self.end(process, End::Killed);
        }
    }

    fn end(&mut self, process: usize, end: End) {
        self.processes[process].end = Some(end);
        for thread in self.threads.iter_mut().filter(|thread| thread.process == process) {
            thread.dead = true;
        }
    }

    /// Ends all threads of a process but `survivor`, as when it begins another program.
    pub(super) fn begin_anew(&mut self, survivor: usize) {
        let process = self.threads[survivor].process;
        for (at, thread) in self.threads.iter_mut().enumerate() {
            thread.dead |= thread.process == process && at != survivor;
        }
        self.processes[process].writes = None;
    }

    /// `process` writes at `path` of the disk: nobody else may still be able to write into the same run.
    pub(super) fn note_writer(&mut self, process: usize, path: &Path) {
        // The directory itself may be made by anybody, and is then locked by one.
        let Some(run) = run_of(path).filter(|run| run != path) else { return };
        let (role, command) = (self.processes[process].role, self.processes[process].command);
        let other = self.processes.iter().enumerate().find(|(at, other)| {
            let learners = role == Role::Learner && other.role == Role::Learner;
            *at != process
                && other.end.is_none()
                && other.writes.as_ref() == Some(&run)
                && (other.command != command || learners)
        });
        if let Some((at, other)) = other {
            let text = format!(
                "{role:?} {process} writes {} while {:?} {at} lives, which writes there, too",
                path.display(),
                other.role
            );
            self.fail(text);
        }
        self.processes[process].writes = Some(run);
    }

    /// `process` has moved the directory `from` of the disk away. If it was the run's that it wrote into, another may be made there.
    pub(super) fn note_leaver(&mut self, process: usize, from: &Path) {
        let writes = &mut self.processes[process].writes;
        if writes.as_deref() == Some(from) {
            *writes = None;
        }
    }

    fn is_done(&self, on: On, thread: usize) -> bool {
        let process = self.threads[thread].process;
        let done = |thread: &Thread| matches!(thread.status, Status::Done);
        match on {
            On::Time => false,
            On::Thread(other) => done(&self.threads[other]),
            On::Siblings => self
                .threads
                .iter()
                .enumerate()
                .all(|(at, other)| other.process != process || at == thread || done(other)),
            On::Process(other) => !self.is_alive(other),
            On::Mail => !self.processes[process].mail.is_empty(),
            On::Wire(run, want) => {
                let alive = |process| self.is_alive(process);
                self.wires.get(&run).is_none_or(|wire| wire.has(want, &alive))
                    || (want == Want::Welcome && self.processes[process].told)
            }
        }
    }

    /// Whose turn it is; none when all threads have ended.
    fn pick(&mut self, me: Option<usize>) -> Option<usize> {
        loop {
            // The dead first: nobody sees one that is only half gone.
            let dead = |thread: &Thread| match &thread.status {
                Status::Ready => thread.dead,
                Status::Waiting { on: On::Thread(other), .. } => {
                    thread.dead && matches!(self.threads[*other].status, Status::Done)
                }
                Status::Waiting { .. } => thread.dead,
                Status::Done => false,
            };
            if let Some(at) = self.threads.iter().position(dead) {
                return Some(at);
            }
            let now = self.now;
            let ready: Vec<usize> = (0..self.threads.len())
                .filter(|&at| {
                    let thread = &self.threads[at];
                    let there = self.processes[thread.process].stopped_until <= now;
                    there
                        && match thread.status {
                            Status::Ready => true,
                            Status::Waiting { on, until } => {
                                until.is_some_and(|until| until <= now) || self.is_done(on, at)
                            }
                            Status::Done => false,
                        }
                })
                .collect();
            if !ready.is_empty() {
                let stays = me.filter(|me| ready.contains(me));
                if let Some(me) = stays
                    && self.random(self.rarely) != 0
                {
                    return Some(me);
                }
                let nth = self.random(ready.len() as u64) as usize;
                return Some(ready[nth]);
            }
            if self.threads.iter().all(|thread| matches!(thread.status, Status::Done)) {
                return None;
            }
            // All wait.
            let deadlines = self.threads.iter().filter_map(|thread| match thread.status {
                Status::Waiting { until, .. } => until,
                _ => None,
            });
            let stops =
                self.processes.iter().filter(|process| process.end.is_none()).map(|p| p.stopped_until);
            let later = self.later.iter().map(|(at, _)| *at);
            match deadlines.chain(stops).chain(later).filter(|&at| at > now).min() {
                Some(next) => {
                    self.now = next;
                    self.happen();
                }
                None => {
                    let waiting: Vec<String> = self
                        .threads
                        .iter()
                        .filter(|thread| !matches!(thread.status, Status::Done))
                        .map(|t| format!("{:?}: {:?}", self.processes[t.process].role, t.status))
                        .collect();
                    self.fail(format!("all wait for ever: {waiting:?}"));
                }
            }
        }
    }

    /// What is due.
    fn happen(&mut self) {
        while self.faults.front().is_some_and(|fault| fault.after <= self.steps) {
            let Some(fault) = self.faults.pop_front() else { break };
            self.befall(fault.what);
        }
        let now = self.now;
        for (_, what) in self.later.extract_if(.., |(at, _)| *at <= now).collect::<Vec<_>>() {
            self.befall(what);
        }
    }

    fn befall(&mut self, what: What) {
        self.note(|| format!("fault: {what:?}"));
        match what {
            What::Kill(role) => {
                if let Some(process) = self.newest(role) {
                    self.kill(process);
                }
            }
            What::Both(role, after) => {
                if let Some(process) = self.newest(role) {
                    self.kill(process);
                    self.later.push((self.now + after, What::Kill(Role::Supervisor)));
                }
            }
            What::All => {
                for process in 0..self.processes.len() {
                    if self.processes[process].role != Role::User {
                        self.kill(process);
                    }
                }
            }
            What::Hold(role, time) => {
                if let Some(process) = self.newest(role) {
                    self.processes[process].stopped_until = self.now + time;
                }
            }
            What::PowerCut => {
                self.befall(What::All);
                let word = self.random(u64::MAX);
                self.wires.clear();
                if let Err(error) = self.disk.cut(word) {
                    self.fail(format!("the disk's model: {error}"));
                }
            }
            What::Io(role, calls, errno) => self.broken = Some((role, calls, errno)),
            What::Stop => {
                if let Some(process) = self.newest(Role::Supervisor) {
                    self.processes[process].mail.push_back(Mail::Stop);
                }
            }
            What::Another => self.processes[0].mail.push_back(Mail::Another),
        }
    }
}

impl World {
    /// A world in the directory `root`, in which `schedule` is to be played.
    pub(super) fn new(root: &Path, schedule: &Schedule, disk: Disk) -> Arc<Self> {
        let state = State {
            threads: Vec::new(),
            processes: Vec::new(),
            // Some time in 2026: so that nobody meets the year 1970.
            now: 1_780_000_000_000 * MS,
            word: schedule.seed,
            steps: 0,
            rarely: schedule.rarely,
            faults: schedule.faults.clone().into(),
            later: Vec::new(),
            broken: None,
            wires: BTreeMap::new(),
            disk,
            failure: None,
            trace: 0,
            log: VecDeque::new(),
            running: 0,
            joins: Vec::new(),
        };
        let (root, flaw) = (root.into(), schedule.flaw);
        Arc::new(Self { state: Mutex::new(state), root, flaw, over: Turn::default() })
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Plays until all threads have ended. The first one is the user's and does `work`.
    pub(super) fn play(self: &Arc<Self>, work: impl FnOnce() + Send + 'static) {
        let user = self.add(Role::User, None, Vec::new());
        let thread = self.spawn(user, work);
        {
            let state = self.lock();
            state.threads[0].turn.give();
        }
        self.over.take();
        let _ = thread.join();
    }

    fn add(&self, role: Role, parent: Option<usize>, held: Vec<OwnedFd>) -> usize {
        let mut state = self.lock();
        let number = state.processes.len();
        let command = match (role, parent) {
            (Role::User | Role::Supervisor, _) | (_, None) => number,
            (_, Some(parent)) => state.processes[parent].command,
        };
        state.processes.push(Process {
            role,
            parent,
            command,
            end: None,
            words: String::new(),
            writes: None,
            told: false,
            stopped_until: 0,
            mail: VecDeque::new(),
            held,
        });
        number
    }

    /// Starts a process of `parent`'s, which does `work` and ends with its status.
    pub(super) fn start(
        self: &Arc<Self>,
        role: Role,
        parent: usize,
        held: Vec<OwnedFd>,
        work: impl FnOnce() -> (i32, String) + Send + 'static,
    ) -> usize {
        let process = self.add(role, Some(parent), held);
        let world = self.clone();
        self.spawn(process, move || {
            let (status, words) = match std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)) {
                Ok(done) => done,
                Err(panic) => {
                    world.panicked(&*panic);
                    (101, "panicked".into())
                }
            };
            world.exit(status, words);
        });
        process
    }

    /// Another thread of `process`.
    pub(super) fn spawn(
        self: &Arc<Self>,
        process: usize,
        work: impl FnOnce() + Send + 'static,
    ) -> std::thread::JoinHandle<()> {
        // A thread that no simulated one starts needs to know its world.
        let world = self.clone();
        let outside = here().is_none().then(|| self.enter(process));
        NEXT.set(Some(process));
        let thread = std::thread::spawn(move || match outside {
            None => work(),
            Some(thread) => within(Place { world, thread }, work),
        });
        NEXT.set(None);
        thread
    }

    /// A new thread of `process`.
    fn enter(&self, process: usize) -> usize {
        let mut state = self.lock();
        let dead = state.processes[process].end.is_some();
        let turn = Arc::new(Turn::default());
        state.threads.push(Thread { process, status: Status::Ready, dead, turn });
        state.threads.len() - 1
    }

    /// The process of this thread ends.
    pub(super) fn exit(&self, status: i32, words: String) {
        let Some(place) = here() else { return };
        let mut state = self.lock();
        let process = state.threads[place.thread].process;
        // A thread that has been ended does not end its process, which may go on as another program.
        if state.processes[process].end.is_none() && !state.threads[place.thread].dead {
            let role = state.processes[process].role;
            state.note(|| format!("{role:?} {process} ends with {status}: {words}"));
            state.processes[process].words = words;
            state.end(process, End::Exited(status));
        }
    }

    /// Gives way, if it is somebody else's turn. False: this thread's process has ended.
    pub(super) fn step(&self, thread: usize, what: &'static str) -> bool {
        let mut state = self.lock();
        if state.threads[thread].dead {
            return false;
        }
        state.steps += 1;
        let pause = US + state.random(20 * US);
        state.now += pause;
        state.trace =
            mix(state.trace ^ (thread as u64) << 32 ^ what.len() as u64 ^ u64::from(what.as_bytes()[0]));
        if state.steps > MOST_STEPS {
            state.fail("it does not come to an end".into());
        }
        state.happen();
        self.give_way(state, thread, Status::Ready)
    }

    /// Waits. False: this thread's process has ended.
    pub(super) fn wait(&self, thread: usize, on: On, time: Option<u64>) -> bool {
        let mut state = self.lock();
        // A dead one waits for its own threads alone.
        if state.threads[thread].dead && !matches!(on, On::Thread(_)) {
            return false;
        }
        state.steps += 1;
        state.now += US;
        state.happen();
        let until = time.map(|time| state.now + time);
        self.give_way(state, thread, Status::Waiting { on, until })
    }

    fn give_way<'a>(&'a self, mut state: MutexGuard<'a, State>, thread: usize, status: Status) -> bool {
        state.threads[thread].status = status;
        let next = state.pick(Some(thread));
        let next = next.unwrap_or(thread);
        state.running = next;
        if next != thread {
            let (theirs, mine) = (state.threads[next].turn.clone(), state.threads[thread].turn.clone());
            drop(state);
            theirs.give();
            mine.take();
            state = self.lock();
        }
        state.threads[thread].status = Status::Ready;
        !state.threads[thread].dead
    }

    /// This thread has come to its end.
    fn leave(&self, thread: usize) {
        let mut state = self.lock();
        state.threads[thread].status = Status::Done;
        let process = state.threads[thread].process;
        let last = state.threads.iter().all(|t| t.process != process || matches!(t.status, Status::Done));
        if last {
            let held = std::mem::take(&mut state.processes[process].held);
            drop(held);
            let Process { role, end, words, parent, .. } = &mut state.processes[process];
            let end = end.get_or_insert(End::Exited(0)).clone();
            let mail = Mail::Ended { role: *role, end, words: words.clone() };
            if let Some(parent) = *parent {
                state.processes[parent].mail.push_back(mail);
            }
        }
        match state.pick(None) {
            None => self.over.give(),
            Some(next) => {
                state.running = next;
                let turn = state.threads[next].turn.clone();
                drop(state);
                turn.give();
            }
        }
    }

    fn panicked(&self, panic: &(dyn Any + Send)) {
        let Some(place) = here() else { return };
        let mut state = self.lock();
        // Whoever has lost the system under its feet may fall.
        if !state.threads[place.thread].dead {
            state.fail(format!("a panic: {}", words_of(panic)));
        }
    }

    pub(super) fn joins(&self, handle: u64, thread: usize) {
        self.lock().joins.push((handle, thread));
    }

    /// The thread with this handle, if it is simulated.
    pub(super) fn joined(&self, handle: u64) -> Option<usize> {
        let state = self.lock();
        state.joins.iter().rev().find(|(known, _)| *known == handle).map(|(_, thread)| *thread)
    }
}

/// The run's directory that `path` of the disk lies in: `run`, or `sweep/<arm>/<seed>`.
fn run_of(path: &Path) -> Option<PathBuf> {
    let mut names = path.iter();
    match names.next()?.to_str()? {
        "run" => Some("run".into()),
        "sweep" => {
            let (arm, seed) = (names.next()?, names.next()?);
            seed.to_str()?.starts_with("seed-").then(|| Path::new("sweep").join(arm).join(seed))
        }
        _ => None,
    }
}

fn words_of(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().cloned();
    text.or(panic.downcast_ref::<&str>().map(ToString::to_string)).unwrap_or_default()
}

/// What a thread that the present one starts is to be, if that is simulated.
pub(super) fn next_thread() -> Option<Place> {
    let place = here()?;
    let own = place.world.lock().process_of(place.thread);
    let thread = place.world.enter(NEXT.get().unwrap_or(own));
    Some(Place { world: place.world.clone(), thread })
}

/// Does `work` as the thread that `place` names, when its turn comes.
pub(super) fn within(place: Place, work: impl FnOnce()) {
    let turn = place.world.lock().threads[place.thread].turn.clone();
    turn.take();
    PLACE.set(&raw const place);
    let done = std::panic::catch_unwind(std::panic::AssertUnwindSafe(work));
    PLACE.set(std::ptr::null());
    if let Err(panic) = done {
        let mut state = place.world.lock();
        if !state.threads[place.thread].dead {
            state.fail(format!("a panic: {}", words_of(&*panic)));
        }
    }
    place.world.leave(place.thread);
}
