//! The replay against a `VecDeque` of plain entries.

#![allow(clippy::unwrap_used)]

use super::*;
use proptest::prelude::*;
use rand::SeedableRng;
use std::collections::{BTreeMap, VecDeque};
use trestle_proto::batch::{FIRST, SUCCEEDED, TERMINATED, TRUNCATED};
use trestle_proto::rng::Stream;
use trestle_proto::row::Element;

const DIM: usize = 2;
const BOUNDS: Bounds = Bounds { n_actions: 4, mentor_len: 9, actors: 3 };

/// An entry of the model.
#[derive(Clone, Debug, PartialEq)]
struct Plain {
    obs: [f32; DIM],
    next: [f32; DIM],
    action: u32,
    reward: f32,
    flags: u32,
    actor: u32,
    mentor: u32,
}

impl Plain {
    fn transition(&self) -> Transition<'_> {
        Transition {
            obs: &self.obs,
            next_obs: &self.next,
            action: self.action,
            reward: self.reward,
            flags: self.flags,
        }
    }

    fn of(replay: &Replay, slot: usize) -> Self {
        let entry = replay.get(slot);
        let state = |row: Row<'_>| row.wide(&mut Vec::new()).try_into().unwrap();
        Self {
            obs: state(replay.obs(slot)),
            next: state(replay.next_obs(slot)),
            action: entry.action,
            reward: entry.reward,
            flags: entry.flags,
            actor: entry.actor,
            mentor: entry.mentor.map_or(NONE, |j| j as u32),
        }
    }
}

fn plain() -> impl Strategy<Value = Plain> {
    let number = 0u8..8;
    let flags = prop::sample::select(vec![
        0,
        FIRST,
        TERMINATED,
        TERMINATED | SUCCEEDED,
        TRUNCATED,
        FIRST | TRUNCATED,
    ]);
    (prop::array::uniform5(number), 0u32..4, flags, 0u32..3, prop::option::of(0u32..9)).prop_map(
        |(x, action, flags, actor, mentor)| {
            let x = x.map(f32::from);
            Plain {
                obs: [x[0], x[1]],
                next: [x[2], x[3]],
                action,
                reward: x[4],
                flags,
                actor,
                mentor: mentor.unwrap_or(NONE),
            }
        },
    )
}

const ELEMENTS: [Element; 2] = [Element::F32, Element::U8];

fn empty(capacity: usize, element: Element) -> Replay {
    Replay::new(capacity, RowKind { dim: DIM, element }).unwrap()
}

fn filled(capacity: usize, entries: &[Plain]) -> (Replay, VecDeque<Plain>) {
    filled_with(capacity, Element::F32, entries)
}

fn filled_with(capacity: usize, element: Element, entries: &[Plain]) -> (Replay, VecDeque<Plain>) {
    let mut replay = empty(capacity, element);
    let mut model = VecDeque::new();
    for entry in entries {
        replay.push(&entry.transition(), entry.actor, entry.mentor);
        if model.len() == capacity {
            model.pop_front();
        }
        model.push_back(entry.clone());
    }
    (replay, model)
}

fn contents(replay: &Replay) -> Vec<Plain> {
    (replay.first_index()..replay.next_index()).map(|i| Plain::of(replay, replay.slot(i))).collect()
}

proptest! {
    #[test]
    fn it_is_a_bounded_queue(capacity in 1usize..12, entries in prop::collection::vec(plain(), 0..40)) {
        for element in ELEMENTS {
            let (replay, model) = filled_with(capacity, element, &entries);
            prop_assert_eq!(replay.len(), model.len());
            prop_assert_eq!(replay.is_empty(), model.is_empty());
            prop_assert_eq!(replay.next_index(), entries.len() as u64);
            prop_assert_eq!(replay.first_index(), (entries.len() - model.len()) as u64);
            prop_assert_eq!(contents(&replay), Vec::from(model));
        }
    }

    /// Cut into batches and put together again it is the same sequence, and no batch mixes actors.
    #[test]
    fn batches_follow_the_queue(
        capacity in 1usize..12, most in 1usize..6, entries in prop::collection::vec(plain(), 1..40),
        element in prop::sample::select(ELEMENTS.to_vec()),
    ) {
        let (replay, model) = filled_with(capacity, element, &entries);
        let mut batch = Batch::default();
        let mut index = replay.first_index();
        let mut seen = Vec::new();
        while index < replay.next_index() {
            let count = replay.fill_batch(index, most, &mut batch);
            prop_assert!(count > 0 && count <= most && count == batch.len());
            for at in 0..count {
                seen.push((batch.header.actor, format!("{:?}", batch.transition(at))));
            }
            index += count as u64;
            let next = model.get((index - replay.first_index()) as usize);
            prop_assert!(count == most || next.is_none_or(|e| e.actor != batch.header.actor));
        }
        let expected: Vec<_> = model.iter().map(|e| (e.actor, format!("{:?}", e.transition()))).collect();
        prop_assert_eq!(seen, expected);
        prop_assert_eq!(replay.fill_batch(replay.next_index(), most, &mut batch), 0);
        if let Some(gone) = replay.first_index().checked_sub(1) {
            prop_assert_eq!(replay.fill_batch(gone, most, &mut batch), 0);
        }
    }

    /// Paths against a walk through the plain list of all that was ever stored, before and after a checkpoint.
    #[test]
    fn paths_are_those_of_the_whole_history(
        capacity in 1usize..40, most in 1usize..7, steps in prop::collection::vec(step(), 1..120),
    ) {
        let history = histories(&steps);
        let (mut replay, _) = filled(capacity, &history);
        for again in [false, true] {
            if again {
                let (head, segments) = (replay.head(), files(&replay, &Files::new()));
                read(&mut replay, &head, &segments).unwrap();
                replay.relink();
            }
            for index in replay.first_index()..replay.next_index() {
                let path: Vec<usize> = replay.path(replay.slot(index), most).collect();
                let expected = naive_path(&history, index as usize, most);
                let expected: Vec<usize> = expected.into_iter().map(|i| replay.slot(i as u64)).collect();
                prop_assert_eq!(path, expected);
            }
        }
        // What comes after a checkpoint is linked to what came before.
        let last = history.last().unwrap();
        let more = Plain { obs: last.next, flags: 0, ..last.clone() };
        let slot = replay.push(&more.transition(), more.actor, more.mentor);
        let before = (slot + capacity - 1) % capacity;
        let follows = capacity > 1 && last.flags & (TERMINATED | TRUNCATED) == 0;
        prop_assert_eq!(replay.successor(before), follows.then_some(slot));
    }

    /// Segments and head together are the replay, wherever the segments come from.
    #[test]
    fn files_give_it_back(
        capacity in 1usize..300, entries in prop::collection::vec(plain(), 0..700), more in plain(),
        earlier in any::<prop::sample::Index>(), element in prop::sample::select(ELEMENTS.to_vec()), walks: bool,
    ) {
        let mut entries = entries;
        if walks {
            // One follows upon the other, as far as the flags let it.
            (1..entries.len()).for_each(|at| entries[at].obs = entries[at - 1].next);
        }
        // Files of an earlier state, full segments of which are used again.
        let (earlier, _) = filled_with(capacity, element, &entries[..earlier.index(entries.len() + 1)]);
        let old = files(&earlier, &Files::new());
        let (mut replay, _) = filled_with(capacity, element, &entries);
        let new = files(&replay, &old);
        let mut again = empty(capacity, element);
        read(&mut again, &replay.head(), &new).unwrap();
        again.relink();
        let books = [&replay, &again].map(|replay| replay.tails.books().0);
        prop_assert_eq!(books[0], books[1]);
        prop_assert_eq!(again.first_index(), replay.first_index());
        prop_assert_eq!(again.next_index(), replay.next_index());
        prop_assert_eq!(contents(&again), contents(&replay));
        let slots = [&mut replay, &mut again].map(|r| r.push(&more.transition(), 0, 1));
        prop_assert_eq!(slots[0], slots[1]);
    }

    #[test]
    fn a_damaged_file_is_refused_or_in_range(
        entries in prop::collection::vec(plain(), 1..10), which in any::<prop::sample::Index>(),
        at in any::<prop::sample::Index>(), bit in 0u8..8,
    ) {
        let (replay, _) = filled(6, &entries);
        let (head, segments) = (replay.head(), files(&replay, &Files::new()));
        let which = which.index(segments.len() + 1);
        let damaged = |damage: &dyn Fn(&mut Vec<u8>)| {
            let (mut head, mut segments) = (head.clone(), segments.clone());
            damage(if which == segments.len() { &mut head } else { segments.values_mut().nth(which).unwrap() });
            let mut again = Replay::new(6, DIM).unwrap();
            read(&mut again, &head, &segments).map(|()| again)
        };
        let length = if which == segments.len() { head.len() } else { segments.values().nth(which).unwrap().len() };
        let at = at.index(length);
        prop_assert!(damaged(&|bytes| bytes.truncate(at)).is_err());
        let trailing = damaged(&|bytes| bytes.push(0));
        prop_assert!(matches!(trailing, Err(ReplayFileError::Trailing(_))));
        // Without the manifest's checksum a flipped bit may give another sound replay, but never an unsound one.
        if let Ok(again) = damaged(&|bytes| bytes[at] ^= 1 << bit) {
            for entry in contents(&again) {
                prop_assert!(entry.action < 4 && (entry.mentor < 9 || entry.mentor == NONE) && entry.actor < 3);
                prop_assert!(entry.obs.iter().chain(&entry.next).all(|x| x.is_finite()));
            }
        }
    }

    #[test]
    fn segments_that_leave_something_out_are_refused(
        entries in prop::collection::vec(plain(), 2..200), which in any::<prop::sample::Index>(),
    ) {
        let (replay, _) = filled(128, &entries);
        let mut spans: Vec<Span> = replay.segments(&[]).into_iter().map(|(span, _)| span).collect();
        prop_assert!(replay.check_segments(&spans).is_ok());
        let which = which.index(spans.len());
        let removed = spans.remove(which);
        prop_assert!(replay.check_segments(&spans).is_err());
        spans.insert(which, removed);
        spans.insert(which, removed);
        prop_assert!(replay.check_segments(&spans).is_err());
    }
}

/// Who steps, whether its place jumps before, and the flags of its step.
fn step() -> impl Strategy<Value = (u32, bool, u32)> {
    let flags = prop::sample::select(vec![0, 0, 0, 0, 0, FIRST, TERMINATED, TRUNCATED]);
    (0u32..3, prop::bool::weighted(0.1), flags)
}

/// The transitions of three actors that walk along a line.
fn histories(steps: &[(u32, bool, u32)]) -> Vec<Plain> {
    let mut places = [0.0; 3];
    let mut walk = |&(actor, jumps, flags): &(u32, bool, u32)| {
        let place = &mut places[actor as usize];
        *place += if jumps { 100.0 } else { 0.0 };
        let obs = [*place, 0.0];
        *place += 1.0;
        Plain { obs, next: [*place, 0.0], action: 0, reward: 0.0, flags, actor, mentor: NONE }
    };
    steps.iter().map(&mut walk).collect()
}

/// Indices of `index` and of what follows upon it in `history`, at most `most`.
fn naive_path(history: &[Plain], index: usize, most: usize) -> Vec<usize> {
    let mut path = vec![index];
    for (at, next) in history.iter().enumerate().skip(index + 1) {
        let here = &history[path[path.len() - 1]];
        if path.len() == most || here.flags & (TERMINATED | TRUNCATED) != 0 {
            break;
        }
        if next.actor == here.actor {
            if next.flags & FIRST != 0 || next.obs != here.next {
                break;
            }
            path.push(at);
        }
    }
    path
}

/// The bytes of segments.
type Files = BTreeMap<Span, Vec<u8>>;

/// The files of the replay's segments, those that are in `there` taken from it.
fn files(replay: &Replay, there: &Files) -> Files {
    let spans: Vec<Span> = there.keys().copied().collect();
    let segments = replay.segments(&spans).into_iter();
    segments
        .map(|(span, old)| (span, if old { there[&span].clone() } else { replay.segment(span) }))
        .collect()
}

fn read(into: &mut Replay, mut head: &[u8], segments: &Files) -> Result<(), ReplayFileError> {
    into.read_head(&mut head)?;
    into.check_segments(&segments.keys().copied().collect::<Vec<_>>())?;
    for (span, bytes) in segments {
        into.read_segment(*span, &mut bytes.as_slice())?;
    }
    into.check(&BOUNDS)
}

#[test]
fn only_a_segments_own_name_is_one() {
    let span = Span { first: 512, end: 1024 };
    assert_eq!(span.name(), "replay-000000000512-000000001024.bin");
    assert_eq!(Span::of_name(&span.name()), Some(span));
    for name in [
        "replay.bin",
        "replay-512-1024.bin",
        "replay-000000001024-000000000512.bin",
        "replay-+00000000512-000000001024.bin",
        "../replay-000000000512-000000001024.bin",
    ] {
        assert_eq!(Span::of_name(name), None, "{name}");
    }
}

#[test]
fn draws_are_uniform_over_what_is_stored() {
    let entry =
        Plain { obs: [0.0; 2], next: [0.0; 2], action: 0, reward: 0.0, flags: 0, actor: 0, mentor: NONE };
    let (replay, _) = filled(8, &vec![entry; 5]);
    let mut rng = Stream::seed_from_u64(3);
    let (mut slots, mut counts) = (Vec::new(), [0u32; 5]);
    replay.sample(&mut rng, 50_000, &mut slots);
    slots.iter().for_each(|&slot| counts[slot as usize] += 1);
    // Standard deviation of a count is about 89: six of them either way.
    assert!(counts.iter().all(|&c| (9_466..=10_534).contains(&c)), "{counts:?}");
    Replay::new(8, 2).unwrap().sample(&mut rng, 4, &mut slots);
    assert!(slots.is_empty());
}

/// Episodes of ten steps of three actors in turns: one s' for each end of an episode that is stored, and each actor's newest.
#[test]
fn a_state_between_two_steps_is_stored_once() {
    let steps: Vec<(u32, bool, u32)> =
        (0..300).map(|i| (i % 3, false, if i / 3 % 10 == 9 { TERMINATED } else { 0 })).collect();
    let history = histories(&steps);
    for capacity in [1, 2, 3, 60, 299, 300, 1000] {
        let (replay, model) = filled(capacity, &history);
        let ends = model.iter().filter(|entry| entry.flags & TERMINATED != 0).count();
        // The last three steps end episodes.
        assert_eq!(replay.tails.books().0, ends, "{capacity}");
        assert_eq!(replay.bytes(), model.len() * bytes_per_transition(DIM) + replay.tails.bytes());
        assert!(replay.tails.bytes() <= (ends + 4) * 4 * DIM, "{capacity}");
    }
}

#[test]
fn memory_is_accounted_for() {
    let replay = Replay::new(1000, 4).unwrap();
    assert_eq!(bytes_per_transition(4), 34);
    let bytes = RowKind { dim: 10 * 10 * 4, element: Element::U8 };
    assert_eq!(bytes_per_transition(bytes), 418);
    // The promise for 100,000 transitions of MinAtar's games, the largest of which has ten channels.
    let most = RowKind { dim: 10 * 10 * 10, element: Element::U8 };
    assert!(100_000 * bytes_per_transition(most) < 110_000_000);
    let (_, tails) = replay.tails.books();
    let reserved = 4
        * (replay.obs.capacity()
            + replay.action.capacity()
            + replay.reward.capacity()
            + replay.mentor.capacity())
        + replay.links.reserved()
        + replay.flags.capacity()
        + replay.actor.capacity();
    assert_eq!((1000 * bytes_per_transition(4), 1000 * 16), (reserved, tails));
    let error = Replay::new(usize::MAX / 64, 4).unwrap_err();
    assert!(error.to_string().contains("learner.replay"), "{error}");
}
