//! The threads that share a gradient step.
//!
//! Work is cut where no sum crosses the cut: between rows of a batch, rows of a weight matrix, or parameters. The bits of the result
//! are therefore the same for any number of threads, and for one.
//!
//! Each thread has a part. The caller soon does a part itself that its thread has not begun, so that it waits for none that gets no
//! processor.
//!
//! A thread without work looks for it for up to a tenth of a millisecond, since a step has several stages one after the other, and then
//! sleeps until it is woken. A stage that is long enough for that wakes it. While it is awake, it is also called to shorter ones.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle, Thread};

use trestle_proto::limits::MAX_THREADS;

/// Multiply-adds that a thread must have to do for it to be woken: some thirty microseconds of work on AVX-512. Measured by
/// `trestle-bench threads`.
const LEAST: usize = 1 << 22;
/// The same for a thread that is awake: some two microseconds, twice the cost of handing work over.
const LEAST_AWAKE: usize = 1 << 18;

/// How often a waiting thread looks before it sleeps: up to a tenth of a millisecond.
const LOOKS: usize = 4000;
/// How often the caller looks whether a thread has begun its part, before it does that itself.
const PATIENCE: usize = 1000;

/// Threads that could not be started.
#[derive(Debug, thiserror::Error)]
#[error("thread {index} of {count} (learner.threads) could not be started: {source}")]
pub struct ThreadsError {
    /// Which one, from 1: the caller's own is 0.
    pub index: usize,
    /// How many there were to be.
    pub count: usize,
    /// Why.
    pub source: std::io::Error,
}

/// Work that can be cut into parts for several threads.
pub(crate) trait Work: Send + Sized {
    /// Cuts off part `part` of `parts`, with which `self` begins.
    fn split(self, part: usize, parts: usize) -> (Self, Self);
    /// Does it.
    fn run(self);
}

/// How many of `whole` things belong to part `part` of `parts`: as equal as can be, and all together `whole`.
pub(crate) fn share(whole: usize, part: usize, parts: usize) -> usize {
    whole * (part + 1) / parts - whole * part / parts
}

/// The threads among which a gradient step is shared: the caller's, and others that sleep in between. Clones share them.
#[derive(Clone, Debug)]
pub struct Threads {
    crew: Option<Arc<Crew>>,
    /// Multiply-adds that a part has at least.
    least: usize,
}

impl Default for Threads {
    /// The caller's thread alone.
    fn default() -> Threads {
        Threads { crew: None, least: LEAST }
    }
}

impl Threads {
    /// `count` threads, 1 to [`MAX_THREADS`], the caller's among them; no more than there are processors for this process.
    ///
    /// # Errors
    /// A thread cannot be started.
    ///
    /// # Panics
    /// If `count` is out of range.
    pub fn new(count: usize) -> Result<Threads, ThreadsError> {
        Threads::exactly(count, count.min(thread::available_parallelism().map_or(1, usize::from)), LEAST)
    }

    /// `count` threads although there may be fewer processors, and parts of any size.
    #[cfg(test)]
    pub(crate) fn eager(count: usize) -> Threads {
        #[allow(clippy::unwrap_used)]
        Threads::exactly(count, count, 1).unwrap()
    }

    fn exactly(asked: usize, count: usize, least: usize) -> Result<Threads, ThreadsError> {
        assert!((1..=MAX_THREADS).contains(&asked), "{asked} threads");
        let crew = if count > 1 { Some(Arc::new(Crew::new(count)?)) } else { None };
        Ok(Threads { crew, least })
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.crew.as_ref().map_or(1, |crew| crew.others.len() + 1)
    }

    /// How many threads have enough to do with so many multiply-adds, where all of them are `awake` or some sleep.
    fn parts(&self, multiply_adds: usize, awake: bool) -> usize {
        let least = if awake { self.least.min(LEAST_AWAKE) } else { self.least };
        (multiply_adds / least).min(self.count())
    }

    /// Does `work`, which has so many multiply-adds, by as many threads as have enough to do.
    pub(crate) fn run<W: Work>(&self, multiply_adds: usize, work: W) {
        let Some(crew) = &self.crew else { return work.run() };
        let parts = self.parts(multiply_adds, crew.is_awake());
        if parts < 2 {
            return work.run();
        }
        let (mut all, mut rest) = (Vec::with_capacity(parts), work);
        for part in 0..parts - 1 {
            let (first, others) = rest.split(part, parts);
            all.push(Mutex::new(Some(first)));
            rest = others;
        }
        all.push(Mutex::new(Some(rest)));
        crew.run(parts, &|part: usize| {
            let work = locked(&all[part]).take();
            if let Some(work) = work {
                work.run();
            }
        });
    }
}

/// A function that the crew is to call, without its type.
#[derive(Clone)]
struct Job {
    call: unsafe fn(*const (), usize),
    function: *const (),
    leader: Thread,
}

// SAFETY: `function` points to an `F: Sync`, which any thread may call; `Crew::run` sees to it that it outlives all calls.
#[allow(unsafe_code)]
unsafe impl Send for Job {}

/// Calls the `F` at `function` with a part's number.
///
/// # Safety
/// `function` points to a live `F`.
#[allow(unsafe_code)]
unsafe fn call<F: Fn(usize) + Sync>(function: *const (), part: usize) {
    // SAFETY: as the caller promises.
    (unsafe { &*function.cast::<F>() })(part);
}

/// The state that the threads of a crew share.
#[derive(Default)]
struct Shared {
    /// The job, as long as parts of it may be taken.
    job: Mutex<Option<Job>>,
    /// Whether somebody does each part, or it does not exist.
    taken: Vec<AtomicBool>,
    /// How often each of the other threads has been called.
    calls: Vec<AtomicUsize>,
    /// How many of the other threads work or look for work.
    awake: AtomicUsize,
    /// The other threads that have the job.
    running: AtomicUsize,
    panicked: AtomicBool,
    /// No call will come any more.
    over: AtomicBool,
}

impl Shared {
    /// Takes `part`; whether nobody else had.
    fn take(&self, part: usize) -> bool {
        !self.taken[part].swap(true, Ordering::Relaxed)
    }
}

/// Threads that sleep until they are called.
struct Crew {
    shared: Arc<Shared>,
    others: Vec<JoinHandle<()>>,
    /// One caller at a time.
    turn: Mutex<()>,
}

impl std::fmt::Debug for Crew {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Crew").field("others", &self.others.len()).finish_non_exhaustive()
    }
}

impl Crew {
    fn new(count: usize) -> Result<Crew, ThreadsError> {
        let calls = (1..count).map(|_| AtomicUsize::new(0)).collect();
        let taken = (0..count).map(|_| AtomicBool::new(true)).collect();
        let shared = Arc::new(Shared { taken, calls, ..Shared::default() });
        let mut crew = Crew { shared, others: Vec::with_capacity(count - 1), turn: Mutex::new(()) };
        for index in 1..count {
            let shared = crew.shared.clone();
            let thread = thread::Builder::new().name(format!("step {index}"));
            let started = thread.spawn(move || work_when_called(&shared, index));
            crew.others.push(started.map_err(|source| ThreadsError { index, count, source })?);
        }
        Ok(crew)
    }

    /// Whether no thread sleeps.
    fn is_awake(&self) -> bool {
        self.shared.awake.load(Ordering::Relaxed) == self.others.len()
    }

    /// Calls `function` with each number below `parts`, which are 2 to the number of threads, at the same time if it can.
    fn run<F: Fn(usize) + Sync>(&self, parts: usize, function: &F) {
        let _turn = locked(&self.turn);
        let shared = &*self.shared;
        for (part, taken) in shared.taken.iter().enumerate() {
            taken.store(part == 0 || part >= parts, Ordering::Relaxed);
        }
        let leader = thread::current();
        let job = Job { call: call::<F>, function: std::ptr::from_ref(function).cast(), leader };
        // A caller whose own part panicked has not asked about the others.
        shared.panicked.store(false, Ordering::Relaxed);
        // The lock hands on all of this.
        *locked(&shared.job) = Some(job);
        // Takes the job back even where `function` panics: the others have a pointer to it.
        let others_finish = Finish(shared);
        for (calls, other) in shared.calls.iter().zip(&self.others).take(parts - 1) {
            calls.fetch_add(1, Ordering::Release);
            other.thread().unpark();
        }
        function(0);
        for part in 1..parts {
            look(PATIENCE, || shared.taken[part].load(Ordering::Relaxed));
            if shared.take(part) {
                function(part);
            }
        }
        drop(others_finish);
        assert!(!shared.panicked.swap(false, Ordering::Relaxed), "a part of a gradient step panicked");
    }
}

impl Drop for Crew {
    fn drop(&mut self) {
        self.shared.over.store(true, Ordering::Relaxed);
        for (calls, other) in self.shared.calls.iter().zip(&self.others) {
            calls.fetch_add(1, Ordering::Release);
            other.thread().unpark();
        }
        for other in self.others.drain(..) {
            // It catches panics, so it has none to hand on.
            let _ = other.join();
        }
    }
}

/// Takes the job back on its drop, and waits until the threads that have it have finished.
struct Finish<'a>(&'a Shared);

impl Drop for Finish<'_> {
    fn drop(&mut self) {
        *locked(&self.0.job) = None;
        wait(|| self.0.running.load(Ordering::Acquire) == 0);
    }
}

/// The life of thread `index`, from 1.
#[allow(unsafe_code)]
fn work_when_called(shared: &Shared, index: usize) {
    let calls = &shared.calls[index - 1];
    let (mut seen, mut awake) = (0, false);
    loop {
        let is_called = || calls.load(Ordering::Acquire) != seen;
        if !awake || !look(LOOKS, is_called) {
            shared.awake.fetch_sub(usize::from(awake), Ordering::Relaxed);
            sleep(is_called);
            shared.awake.fetch_add(1, Ordering::Relaxed);
            awake = true;
        }
        seen = calls.load(Ordering::Acquire);
        if shared.over.load(Ordering::Relaxed) {
            return;
        }
        let job = locked(&shared.job);
        let Some(Job { call, function, leader }) = job.clone() else { continue };
        shared.running.fetch_add(1, Ordering::Relaxed);
        drop(job);
        let work = || {
            if shared.take(index) {
                // SAFETY: a thread that has found the job has raised `running` under its lock. `Crew::run` takes the job back under that lock
                // and then waits for `running` to be 0, which takes the subtraction below; until then its function lives.
                unsafe { call(function, index) };
            }
        };
        if catch_unwind(AssertUnwindSafe(work)).is_err() {
            shared.panicked.store(true, Ordering::Relaxed);
        }
        if shared.running.fetch_sub(1, Ordering::AcqRel) == 1 {
            leader.unpark();
        }
    }
}

/// Returns once `until` holds. The thread that makes it hold unparks this one.
fn wait(until: impl Fn() -> bool) {
    if !look(LOOKS, &until) {
        sleep(until);
    }
}

/// Sleeps until `until` holds.
fn sleep(until: impl Fn() -> bool) {
    while !until() {
        thread::park();
    }
}

/// Looks so often whether `until` holds, at most; whether it does.
fn look(times: usize, until: impl Fn() -> bool) -> bool {
    for _ in 0..times {
        if until() {
            return true;
        }
        std::hint::spin_loop();
    }
    false
}

/// Locks. The state that a panicking thread left behind is whole, since nothing that is done under these locks can panic.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    /// Adds 1 to each element of a slice that had so many when it was whole.
    struct Add<'a>(&'a mut [usize], usize);

    impl Work for Add<'_> {
        fn split(self, part: usize, parts: usize) -> (Self, Self) {
            let (first, rest) = self.0.split_at_mut(share(self.1, part, parts));
            (Add(first, self.1), Add(rest, self.1))
        }

        fn run(self) {
            self.0.iter_mut().for_each(|x| *x += 1);
        }
    }

    proptest! {
        #[test]
        fn shares_add_up_and_differ_by_one_at_most(whole in 0usize..1000, parts in 1usize..9) {
            let shares: Vec<usize> = (0..parts).map(|part| share(whole, part, parts)).collect();
            prop_assert_eq!(shares.iter().sum::<usize>(), whole);
            prop_assert!(shares.iter().max().unwrap() - shares.iter().min().unwrap() <= 1);
        }
    }

    #[test]
    fn everything_is_done_once_in_every_call() {
        for count in 1..=5 {
            let threads = Threads::eager(count);
            assert_eq!(threads.count(), count);
            let mut x = vec![0; 97];
            for _ in 0..2000 {
                threads.run(usize::MAX, Add(&mut x, 97));
            }
            // Long enough for them to fall asleep, and they are woken again.
            for _ in 0..20 {
                (0..100 * LOOKS).for_each(|look| _ = std::hint::black_box(look));
                threads.clone().run(usize::MAX, Add(&mut x, 97));
            }
            assert!(x.iter().all(|&x| x == 2020), "{count}: {x:?}");
        }
    }

    #[test]
    fn little_work_stays_with_the_caller() {
        struct Where(Vec<Thread>, Arc<Mutex<Vec<thread::ThreadId>>>);
        impl Work for Where {
            fn split(mut self, _: usize, _: usize) -> (Self, Self) {
                let rest = self.0.split_off(1);
                let seen = self.1.clone();
                (self, Where(rest, seen))
            }
            fn run(self) {
                locked(&self.1).push(thread::current().id());
            }
        }
        let seen = Arc::new(Mutex::new(Vec::new()));
        let work = || Where(vec![thread::current(); 4], seen.clone());
        let threads = Threads::exactly(4, 4, 1000).unwrap();
        threads.run(1999, work());
        assert_eq!(*locked(&seen), [thread::current().id()]);
        locked(&seen).clear();
        threads.run(2000, work());
        assert_eq!(locked(&seen).len(), 2, "as many parts as have enough to do");
    }

    #[test]
    fn less_work_is_enough_for_threads_that_are_awake() {
        let threads = Threads::exactly(2, 2, LEAST).unwrap();
        let parts = |work: usize| [false, true].map(|awake| threads.parts(work, awake));
        assert_eq!(parts(2 * LEAST_AWAKE - 1), [0, 1]);
        assert_eq!(parts(2 * LEAST_AWAKE), [0, 2]);
        assert_eq!(parts(2 * LEAST), [2, 2]);
        // Nobody has called them yet, however long they have been there.
        assert!(!threads.crew.as_ref().unwrap().is_awake());
    }

    #[test]
    fn a_panic_comes_to_the_caller_once_all_have_finished() {
        struct Fail(Vec<usize>, usize);
        impl Work for Fail {
            fn split(mut self, _: usize, _: usize) -> (Self, Self) {
                let rest = self.0.split_off(1);
                let bad = self.1;
                (self, Fail(rest, bad))
            }
            fn run(self) {
                assert!(!self.0.contains(&self.1), "as asked");
            }
        }
        let threads = Threads::eager(3);
        for bad in 0..3 {
            let work = Fail(vec![0, 1, 2], bad);
            assert!(catch_unwind(AssertUnwindSafe(|| threads.run(usize::MAX, work))).is_err());
            threads.run(usize::MAX, Fail(vec![0, 1, 2], 9));
        }
    }
}
