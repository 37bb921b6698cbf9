//! The replay against a `VecDeque` of plain entries.

#![allow(clippy::unwrap_used)]

use super::*;
use proptest::prelude::*;
use rand::SeedableRng;
use std::collections::{BTreeMap, VecDeque};
use trestle_proto::batch::{FIRST, SUCCEEDED, TERMINATED, TRUNCATED};
use trestle_proto::rng::Stream;

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
    past: [f32; 2],
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

    fn of(entry: &Entry<'_>) -> Self {
        let t = &entry.transition;
        Self {
            obs: t.obs.try_into().unwrap(),
            next: t.next_obs.try_into().unwrap(),
            action: t.action,
            reward: t.reward,
            flags: t.flags,
            actor: entry.actor,
            mentor: entry.mentor.map_or(NONE, |j| j as u32),
            past: [entry.q_past_o, entry.q_past_m],
        }
    }
}

fn plain() -> impl Strategy<Value = Plain> {
    let number = -4i8..4;
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
                past: [x[0] * x[4], x[1] - x[2]],
            }
        },
    )
}

fn filled(capacity: usize, entries: &[Plain]) -> (Replay, VecDeque<Plain>) {
    let mut replay = Replay::new(capacity, DIM).unwrap();
    let mut model = VecDeque::new();
    for entry in entries {
        let slot = replay.push(&entry.transition(), entry.actor, entry.mentor);
        assert!(replay.get(slot).q_past_o.is_nan() && replay.get(slot).q_past_m.is_nan());
        replay.set_q_past_o(slot, entry.past[0]);
        replay.set_q_past_m(slot, entry.past[1]);
        if model.len() == capacity {
            model.pop_front();
        }
        model.push_back(entry.clone());
    }
    (replay, model)
}

fn contents(replay: &Replay) -> Vec<Plain> {
    (replay.first_index()..replay.next_index()).map(|i| Plain::of(&replay.get(replay.slot(i)))).collect()
}

proptest! {
    #[test]
    fn it_is_a_bounded_queue(capacity in 1usize..12, entries in prop::collection::vec(plain(), 0..40)) {
        let (replay, model) = filled(capacity, &entries);
        prop_assert_eq!(replay.len(), model.len());
        prop_assert_eq!(replay.is_empty(), model.is_empty());
        prop_assert_eq!(replay.next_index(), entries.len() as u64);
        prop_assert_eq!(replay.first_index(), (entries.len() - model.len()) as u64);
        prop_assert_eq!(contents(&replay), Vec::from(model));
    }

    /// Cut into batches and put together again it is the same sequence, and no batch mixes actors.
    #[test]
    fn batches_follow_the_queue(
        capacity in 1usize..12, most in 1usize..6, entries in prop::collection::vec(plain(), 1..40),
    ) {
        let (replay, model) = filled(capacity, &entries);
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

    /// Segments and head together are the replay, wherever the segments come from.
    #[test]
    fn files_give_it_back(
        capacity in 1usize..300, entries in prop::collection::vec(plain(), 0..700), more in plain(),
        earlier in any::<prop::sample::Index>(),
    ) {
        // Files of an earlier state, full segments of which are used again.
        let (earlier, _) = filled(capacity, &entries[..earlier.index(entries.len() + 1)]);
        let old = files(&earlier, &Files::new());
        let (mut replay, _) = filled(capacity, &entries);
        let new = files(&replay, &old);
        let mut again = Replay::new(capacity, DIM).unwrap();
        read(&mut again, &replay.head(), &new).unwrap();
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
    let entry = Plain {
        obs: [0.0; 2],
        next: [0.0; 2],
        action: 0,
        reward: 0.0,
        flags: 0,
        actor: 0,
        mentor: NONE,
        past: [0.0; 2],
    };
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

#[test]
fn memory_is_accounted_for() {
    let replay = Replay::new(1000, 4).unwrap();
    assert_eq!(bytes_per_transition(4), 54);
    let reserved = 4
        * (replay.obs.capacity()
            + replay.next.capacity()
            + replay.action.capacity()
            + replay.reward.capacity()
            + replay.mentor.capacity()
            + replay.q_past_o.capacity()
            + replay.q_past_m.capacity())
        + replay.flags.capacity()
        + replay.actor.capacity();
    assert_eq!(replay.bytes(), reserved);
    let error = Replay::new(usize::MAX / 64, 4).unwrap_err();
    assert!(error.to_string().contains("learner.replay"), "{error}");
}
