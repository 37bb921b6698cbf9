//! No ring is lost, and none wakes a process up for nothing.
#![allow(clippy::unwrap_used)]

use super::*;
use nix::sys::pthread::{pthread_kill, pthread_self};
use nix::sys::signal::Signal::SIGUSR1;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::channel;
use std::thread;

const LONG: Duration = Duration::from_secs(600);
const SHORT: Duration = Duration::from_millis(1);

fn sleep(bell: &Bell, heard: u32, wanted: u32) -> Duration {
    let start = Instant::now();
    bell.sleep(heard, wanted, ALL, LONG).unwrap();
    start.elapsed()
}

#[test]
fn a_ring_of_before_is_not_lost_and_counts_once() {
    let bell = Bell::default();
    bell.ring().unwrap();
    bell.ring().unwrap();
    assert!(sleep(&bell, 0, 1) < LONG);
    assert!(sleep(&bell, 0, 2) < LONG);
    for (heard, wanted) in [(2, 1), (0, 3), (1, 2)] {
        let start = Instant::now();
        bell.sleep(heard, wanted, ALL, SHORT).unwrap();
        assert!(start.elapsed() >= SHORT, "{heard} {wanted}");
    }
    assert_eq!(bell.asleep.load(SeqCst), 0);
    // Counts go on beyond the largest number.
    let bell = Bell { rung: AtomicU32::new(u32::MAX), ..Bell::default() };
    bell.ring().unwrap();
    assert!(sleep(&bell, u32::MAX, 1) < LONG);
}

#[test]
fn a_call_is_heard_however_many_rings_are_wanted() {
    let bell = Bell::default();
    bell.call(HELLO + 64).unwrap();
    assert!(sleep(&bell, 0, 9) < LONG);
    bell.calls.iter().for_each(|word| word.store(0, SeqCst));
    thread::scope(|scope| {
        let sleeper = scope.spawn(|| sleep(&bell, 1, 9));
        bell.call(0).unwrap();
        assert!(sleeper.join().unwrap() < LONG);
    });
}

/// Were one wake-up lost, this would take ten minutes.
#[test]
fn every_ring_wakes_up() {
    let [there, back] = [(); 2].map(|()| Bell::default());
    let until = |bell: &Bell, number: u32| {
        while bell.rung.load(SeqCst) < number {
            bell.sleep(number - 1, 1, ALL, LONG).unwrap();
        }
    };
    let start = Instant::now();
    thread::scope(|scope| {
        scope.spawn(|| {
            for number in 1..=10_000 {
                until(&there, number);
                back.ring().unwrap();
            }
        });
        for number in 1..=10_000 {
            there.ring().unwrap();
            until(&back, number);
        }
    });
    assert!(start.elapsed() < LONG);
}

/// Several processes ring one bell, as actors do; the sleeper wants all of them. One bell wakes them all up again.
#[test]
fn the_last_of_many_rings_wakes_up() {
    const ROUNDS: u32 = 2_000;
    const ACTORS: u32 = 4;
    let [learner, actors] = [(); 2].map(|()| Bell::default());
    let start = Instant::now();
    thread::scope(|scope| {
        for index in 0..ACTORS {
            let (learner, actors) = (&learner, &actors);
            scope.spawn(move || {
                for round in 0..ROUNDS {
                    let whom = NonZeroU32::new(bit(index as usize)).unwrap();
                    while actors.rung.load(SeqCst) <= round {
                        actors.sleep(round, 1, whom, LONG).unwrap();
                    }
                    learner.ring().unwrap();
                }
            });
        }
        for round in 0..ROUNDS {
            let before = learner.rung.load(SeqCst);
            assert_eq!(before, round * ACTORS);
            actors.ring_for(ALL).unwrap();
            while learner.rung.load(SeqCst) < before + ACTORS {
                learner.sleep(before, ACTORS, ALL, LONG).unwrap();
            }
        }
    });
    assert!(start.elapsed() < LONG);
}

#[test]
fn a_ring_for_one_actor_leaves_the_others_asleep() {
    let bell = Bell::default();
    let [first, second] = [0, 1].map(|index| NonZeroU32::new(bit(index)).unwrap());
    thread::scope(|scope| {
        let other = scope.spawn(|| {
            let start = Instant::now();
            bell.sleep(0, 1, second, 20 * SHORT).unwrap();
            start.elapsed()
        });
        let one = scope.spawn(|| sleep_as(&bell, first));
        while bell.asleep.load(SeqCst) < 2 {
            thread::yield_now();
        }
        // The one that is meant may not be in the kernel yet; then it sees the count.
        bell.ring_for(first).unwrap();
        assert!(one.join().unwrap() < LONG);
        other.join().unwrap();
    });
    assert_eq!(bell.asleep.load(SeqCst), 0);
}

fn sleep_as(bell: &Bell, whom: NonZeroU32) -> Duration {
    let start = Instant::now();
    bell.sleep(0, 1, whom, LONG).unwrap();
    start.elapsed()
}

#[test]
fn a_signal_ends_the_wait() {
    signal_hook::flag::register(SIGUSR1 as i32, Arc::new(AtomicBool::new(false))).unwrap();
    let bell = Bell::default();
    let (send, id) = channel();
    thread::scope(|scope| {
        let sleeper = scope.spawn(|| {
            send.send(pthread_self()).unwrap();
            bell.sleep(0, 1, ALL, LONG)
        });
        let id = id.recv().unwrap();
        // One that comes before it has fallen asleep ends nothing.
        while !sleeper.is_finished() {
            pthread_kill(id, SIGUSR1).unwrap();
            thread::yield_now();
        }
        sleeper.join().unwrap().unwrap();
    });
    assert_eq!(bell.asleep.load(SeqCst), 0);
}

/// Two threads, each with its memory mapped at an address of its own, as in two processes.
#[test]
fn bells_are_heard_through_shared_memory_and_calls_are_taken_once() {
    let domain = Domain::create(u64::from(std::process::id()) << 32 | 3).unwrap();
    let made = Bells::new(&domain, true).unwrap();
    assert!(Bells::new(&domain, true).is_err(), "there are some already");
    let opened = Bells::new(&domain, false).unwrap();
    let start = Instant::now();
    thread::scope(|scope| {
        scope.spawn(move || {
            let ear = opened.ear_of_actors(bit(3));
            let welcome = ear.wait(LONG, || Ok(ear.take_one(WELCOME + 3).then_some(()))).unwrap();
            assert_eq!(welcome, Some(()));
            assert!(!ear.take_one(WELCOME + 3));
            opened.call(Consumer::Learner, READY + 3).unwrap();
            opened.call(Consumer::Learner, HELLO + 64).unwrap();
            opened.ring(Consumer::Learner).unwrap();
        });
        made.call(Consumer::Actors, WELCOME + 3).unwrap();
        let ear = made.ear(Consumer::Learner);
        let mut calls = Vec::new();
        while calls.len() < 2 {
            ear.listen();
            ear.take(|call| calls.push(call));
            ear.sleep(3, if calls.len() < 2 { SHORT } else { Duration::ZERO }).unwrap();
        }
        calls.sort_unstable();
        assert_eq!(calls, [HELLO + 64, READY + 3]);
    });
    assert!(start.elapsed() < LONG);
    drop(made);
    assert_eq!(domain.shared_memory().unwrap(), Vec::<std::path::PathBuf>::new());
}
