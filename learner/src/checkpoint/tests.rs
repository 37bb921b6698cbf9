//! Checkpoints: going on is going on undisturbed, and whatever is wrong with one is found.

#![allow(clippy::unwrap_used)]

use super::*;
use crate::plan;
use crate::testing::{World, demonstration};
use proptest::prelude::*;
use std::fs;
use tempfile::TempDir;
use trestle_algorithm::agent::Agent;
use trestle_algorithm::replay::Span;
use trestle_proto::observe::Part;
use trestle_proto::plan::{Life, RunPlan};
use trestle_proto::round::Round;
use trestle_proto::run_files::LAST_LINK;

/// Lets `agent` live through `ticks` ticks of the experiment's actors.
fn live(agent: &mut Agent, world: &mut World, actors: u32, ticks: usize) {
    for _ in 0..ticks {
        for actor in 0..actors {
            let (batch, observed) = world.batch(actor, 5);
            agent.ingest(&batch, observed.as_ref()).unwrap();
        }
        agent.train(|| ()).unwrap();
    }
}

/// A run directory with one checkpoint per tick of `ticks`, and the agent of the last.
fn run(plan: &RunPlan, ticks: &[u64]) -> (TempDir, Agent) {
    let dir = tempfile::tempdir().unwrap();
    let mut agent = Agent::new(&plan.experiment, demonstration(&plan.experiment)).unwrap();
    let mut world = World::new(&plan.experiment, 3);
    let mut now = 0;
    let mut saver = Saver::new(dir.path());
    for &tick in ticks {
        live(&mut agent, &mut world, plan.experiment.config.run.actors, (tick - now) as usize);
        now = tick;
        save(&mut saver, plan, tick, &agent).unwrap();
    }
    (dir, agent)
}

/// Of this module's functions, with plain numbers as ticks.
fn directory(run_dir: &Path, tick: u64) -> PathBuf {
    super::directory(run_dir, tick.into())
}

fn save(saver: &mut Saver, plan: &RunPlan, tick: u64, agent: &Agent) -> Result<(), CheckpointError> {
    save_as(saver, plan, tick, agent, Taken::Amid)
}

fn save_as(
    saver: &mut Saver,
    plan: &RunPlan,
    tick: u64,
    agent: &Agent,
    taken: Taken<'_>,
) -> Result<(), CheckpointError> {
    let (tick, actors, run) = (Round::from(tick), [vec![1, 2, 250], vec![]], b"loop");
    saver.save(
        &Cut { experiment: &plan.experiment, life: &plan.life, tick, agent, actors: &actors, run, taken },
        Vec::new(),
    )?;
    saver.wait()
}

/// Everything of an agent that decides what it does next.
fn everything(
    agent: &Agent,
) -> (String, trestle_algorithm::agent::AgentState, trestle_qnet::Adam, Vec<u32>, Vec<u8>) {
    let mut replay = Vec::new();
    replay.extend(agent.replay().head());
    for (span, _) in agent.replay().segments(&[]) {
        replay.extend(agent.replay().segment(span));
    }
    let target = agent.network().with_params(|_, target| target.to_vec()).unwrap();
    replay.extend_from_slice(bytemuck::cast_slice(&target));
    replay.extend(agent.selection().unwrap_or_default());
    (agent.weights_sha256(), agent.state(), agent.adam().clone(), agent.annotation_records(), replay)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]
    #[test]
    fn going_on_from_a_checkpoint_is_going_on(
        algo in prop::sample::select(vec!["dqn", "diiqn", "ha-diiqn", "trestle"]),
        selection in prop::sample::select(vec!["min-distance", "confidence"]),
        target in prop::sample::select(vec!["hard", "polyak"]),
        before in 0usize..14,
        after in 1usize..8,
        seed: u64,
    ) {
        let sets = [
            format!("run.algo={algo}"),
            format!("mentor.selection={selection}"),
            format!("learner.target={target}"),
            "learner.target_every=7".into(),
            "mentor.learned.features=[0]".into(),
            "mentor.learned.radius=1".into(),
            "run.actors=2".into(),
        ];
        let plan = plan(&sets.each_ref().map(String::as_str));
        let mut agent = Agent::new(&plan.experiment, demonstration(&plan.experiment)).unwrap();
        let mut world = World::new(&plan.experiment, seed);
        live(&mut agent, &mut world, 2, before);
        let run_dir = tempfile::tempdir().unwrap();
        save(&mut Saver::new(run_dir.path()), &plan, before as u64, &agent).unwrap();
        let dir = directory(run_dir.path(), before as u64);
        let loaded = load(&dir, &plan.experiment, demonstration(&plan.experiment)).unwrap();
        prop_assert_eq!((loaded.tick, loaded.run.as_slice()), (Round::from(before as u64), &b"loop"[..]));
        prop_assert_eq!(loaded.actors, [vec![1, 2, 250], vec![]]);
        let mut again = loaded.agent;
        prop_assert!(everything(&again) == everything(&agent));
        for _ in 0..after {
            for actor in 0..2 {
                let (batch, observed) = world.batch(actor, 5);
                let ingested = agent.ingest(&batch, observed.as_ref()).unwrap();
                prop_assert_eq!(ingested, again.ingest(&batch, observed.as_ref()).unwrap());
            }
            prop_assert_eq!(agent.train(|| ()).unwrap(), again.train(|| ()).unwrap());
        }
        prop_assert!(everything(&again) == everything(&agent));
        let model = load_model(&dir, agent.network().layout()).unwrap();
        prop_assert!(before + after < 10 || model != agent.weights());
    }

    /// Any file of a checkpoint, cut short, made longer or with one bit flipped, is refused with its name, and an
    /// older checkpoint is found instead, if it does not have the file as well.
    #[test]
    fn every_fault_is_found(
        file in any::<prop::sample::Index>(), at in any::<prop::sample::Index>(), bit in 0u8..8, how in 0..4,
    ) {
        let plan = plan(&[]);
        let (run_dir, _) = run(&plan, &[4, 6]);
        let dir = directory(run_dir.path(), 6);
        let mut names: Vec<_> = fs::read_dir(&dir).unwrap().map(|e| e.unwrap().file_name()).collect();
        names.sort();
        let segments = names.iter().filter(|name| Span::of_name(name.to_str().unwrap()).is_some()).count();
        prop_assert!(segments > 1 && names.len() == 11 + segments);
        let path = dir.join(&names[file.index(names.len())]);
        let mut bytes = fs::read(&path).unwrap();
        let at = at.index(bytes.len());
        match how {
            0 => bytes.truncate(at),
            1 => bytes[at] ^= 1 << bit,
            2 => bytes.push(bit),
            _ => {}
        }
        if how == 3 { fs::remove_file(&path).unwrap() } else { fs::write(&path, &bytes).unwrap() }
        let fault = load(&dir, &plan.experiment, demonstration(&plan.experiment)).unwrap_err().to_string();
        // A damaged MANIFEST is noticed by COMPLETE.
        let named = names.iter().any(|name| fault.contains(&*dir.join(name).to_string_lossy()));
        prop_assert!(named, "{}", fault);
        let older = directory(run_dir.path(), 4);
        let shared = how != 3 && older.join(path.file_name().unwrap()).exists()
            && Span::of_name(path.file_name().unwrap().to_str().unwrap()).is_some();
        let found = newest_complete(run_dir.path()).unwrap();
        prop_assert_eq!(found, (!shared).then_some((4.into(), older)));
    }
}

#[test]
fn the_newest_whole_checkpoint_is_found_and_only_so_many_are_kept() {
    let plan = plan(&["checkpoint.keep=2"]);
    let (dir, agent) = run(&plan, &[3, 5, 8]);
    let there = || {
        let mut names: Vec<_> = fs::read_dir(dir.path().join(CHECKPOINTS_DIR)).unwrap().collect();
        names.sort_by_key(|e| e.as_ref().unwrap().file_name());
        names.into_iter().map(|e| e.unwrap().file_name().into_string().unwrap()).collect::<Vec<_>>()
    };
    assert_eq!(there(), ["000000000005", "000000000008"]);
    let last = dir.path().join(LAST_LINK);
    assert_eq!(fs::read_link(&last).unwrap(), Path::new("checkpoints/000000000008"));
    assert_eq!(load_model(&last, agent.network().layout()).unwrap(), agent.weights());

    // A kill before COMPLETE, a kill while writing, and strangers' files.
    fs::remove_file(directory(dir.path(), 8).join(COMPLETE)).unwrap();
    let scratch = dir.path().join(CHECKPOINTS_DIR).join(format!("{SCRATCH}{}", name_of(9.into())));
    fs::create_dir(&scratch).unwrap();
    fs::write(scratch.join(MODEL), b"half").unwrap();
    fs::create_dir(dir.path().join(CHECKPOINTS_DIR).join("notes")).unwrap();
    fs::create_dir(dir.path().join(CHECKPOINTS_DIR).join("+00000000010")).unwrap();
    assert_eq!(newest_complete(dir.path()).unwrap().unwrap().0, 5.into());
    let fault =
        load(&directory(dir.path(), 8), &plan.experiment, demonstration(&plan.experiment)).unwrap_err();
    assert!(matches!(fault, CheckpointError::Incomplete { .. }), "{fault}");

    // Written again it replaces the unfinished one and clears up.
    save(&mut Saver::new(dir.path()), &plan, 8, &agent).unwrap();
    assert_eq!(newest_complete(dir.path()).unwrap().unwrap().0, 8.into());
    assert_eq!(there(), ["+00000000010", "000000000005", "000000000008", "notes"]);
    // A sound one stays as it is.
    let before = fs::metadata(directory(dir.path(), 8).join(MODEL)).unwrap().modified().unwrap();
    save(&mut Saver::new(dir.path()), &plan, 8, &agent).unwrap();
    assert_eq!(fs::metadata(directory(dir.path(), 8).join(MODEL)).unwrap().modified().unwrap(), before);
}

#[test]
fn without_checkpoints_there_is_none() {
    let dir = tempfile::tempdir().unwrap();
    assert_eq!(newest_complete(dir.path()).unwrap(), None);
    fs::write(dir.path().join(CHECKPOINTS_DIR), b"").unwrap();
    let fault = newest_complete(dir.path()).unwrap_err().to_string();
    assert!(fault.starts_with("cannot list"), "{fault}");
}

#[test]
fn another_configuration_or_demonstration_is_refused_and_higher_limits_are_not() {
    let with = |sets: &[&str]| plan(sets);
    let (dir, _) = run(&with(&[]), &[6]);
    let dir = directory(dir.path(), 6);
    let other = with(&["learner.lr=0.5"]);
    let fault = load(&dir, &other.experiment, demonstration(&other.experiment)).unwrap_err();
    assert!(matches!(fault, CheckpointError::Configuration { .. }), "{fault}");
    let longer = with(&["run.env_steps=200000", "eval.every=1", "checkpoint.keep=9"]);
    assert!(load(&dir, &longer.experiment, demonstration(&longer.experiment)).is_ok());
    let mut moved = trestle_proto::mentor::MentorTransitions::new(2);
    (0..longer.experiment.mentor_len()).for_each(|_| moved.push(&[1.0, 1.0], &[1.0, 1.0], false));
    let fault = load(&dir, &longer.experiment, Some(moved)).unwrap_err().to_string();
    assert!(fault.contains("demonstration"), "{fault}");
}

/// Nor do these change what is learnt.
#[test]
fn what_does_not_change_the_agent_is_no_part_of_the_fingerprint() {
    let usual = plan(&[]);
    let parts: [&[&str]; 7] = [
        &["env.hazard.kind=abort", "env.hazard.after=700"],
        &["eval.every=7"],
        &["checkpoint.keep=9"],
        &["supervise.restarts=77"],
        &["run.env_steps=1234"],
        &["run.stop_when_solved=true"],
        &["learner.threads=3"],
    ];
    for part in parts {
        let other = plan(part);
        assert_ne!(other.experiment.config, usual.experiment.config, "{part:?}");
        assert_eq!(fingerprint(&other.experiment), fingerprint(&usual.experiment), "{part:?}");
    }
    assert_ne!(fingerprint(&plan(&["run.seed=77"]).experiment), fingerprint(&usual.experiment));
}

#[test]
fn a_run_goes_on_from_before_its_last_tick() {
    let short = plan(&["run.env_steps=22", "run.rollout=5", "checkpoint.keep=1"]);
    let (dir, mut agent) = run(&short, &[4]);
    let mut world = World::new(&short.experiment, 5);
    let tick: Vec<_> = (0..short.experiment.config.run.actors).map(|actor| world.batch(actor, 5)).collect();
    let came = || tick.iter().map(|(batch, _)| &**batch);
    assert!(agent.ends_within(came()) && !agent.done());
    let before = everything(&agent);
    let parts: Vec<Part<'_>> = came().map(Part::of).collect();
    let mut saver = Saver::new(dir.path());
    save_as(&mut saver, &later(&short, 1, Some(3.into())), 4, &agent, Taken::BeforeLast(&parts)).unwrap();
    tick.iter().for_each(|(batch, observed)| _ = agent.ingest(batch, observed.as_ref()).unwrap());
    assert!(agent.done() && agent.counters().env_steps == 22);
    let own = later(&short, 1, Some(3.into()));
    save_as(&mut saver, &own, 5, &agent, Taken::Last).unwrap();

    assert_eq!(newest_complete(dir.path()).unwrap().unwrap().0, 5.into(), "the policy is the last one");
    let longer = plan(&["run.env_steps=26", "run.rollout=5"]);
    let longer = later(&longer, 1, Some(3.into()));
    assert_eq!(newest_resumable(dir.path(), &longer).unwrap().unwrap().0, 4.into());
    let loaded =
        load(&directory(dir.path(), 4), &longer.experiment, demonstration(&longer.experiment)).unwrap();
    assert!(everything(&loaded.agent) == before);
    assert_eq!(loaded.pending.len(), tick.len());
    for (found, (batch, _)) in loaded.pending.iter().zip(&tick) {
        assert_eq!((found.header.actor, found.payload()), (batch.header.actor, batch.payload()));
    }
    // A tick of another length is none of this run's.
    let other = plan(&["run.rollout=6"]);
    assert!(load(&directory(dir.path(), 4), &other.experiment, demonstration(&other.experiment)).is_err());
}

/// What a user of Python's safetensors sees.
#[test]
fn tensors_are_named_by_layer() {
    let plan = plan(&[]);
    let (dir, agent) = run(&plan, &[6]);
    let bytes = fs::read(directory(dir.path(), 6).join(MODEL)).unwrap();
    let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let mut names = file.names();
    names.sort_unstable();
    let layers = ["bias", "weight"].map(|part| [0, 1, 2].map(|l| format!("layers.{l}.{part}")));
    let mut expected = layers.concat();
    expected.sort();
    assert_eq!(names, expected);
    let weight = file.tensor("layers.1.weight").unwrap();
    assert_eq!(weight.shape(), [9, 7]);
    // Row i, column o is the weight from input i to output o.
    let own = &agent.weights()[agent.network().layout().layers()[1].weights()];
    assert_eq!(weight.data()[4 * (2 * 7 + 3)..][..4], own[2 * 7 + 3].to_le_bytes());
}

/// A checkpoint writes what is new; going on from one leaves that so.
#[test]
fn full_segments_are_written_once() {
    use std::os::unix::fs::MetadataExt;
    let plan = plan(&["learner.replay=640", "checkpoint.keep=9"]);
    let dir = tempfile::tempdir().unwrap();
    let mut agent = Agent::new(&plan.experiment, demonstration(&plan.experiment)).unwrap();
    let mut world = World::new(&plan.experiment, 3);
    let mut saver = Saver::new(dir.path());
    let inodes = |tick: u64| {
        let files = fs::read_dir(directory(dir.path(), tick)).unwrap().map(|entry| entry.unwrap());
        let segments = files.filter(|file| Span::of_name(file.file_name().to_str().unwrap()).is_some());
        segments
            .map(|file| (file.file_name(), file.metadata().unwrap().ino()))
            .collect::<std::collections::BTreeMap<_, _>>()
    };
    // Over the ring's seam and back to the beginning of it.
    for tick in (20..=240).step_by(20) {
        live(&mut agent, &mut world, 1, 20);
        save(&mut saver, &plan, tick, &agent).unwrap();
        if tick == 100 {
            saver = Saver::after(dir.path(), tick.into()).unwrap();
        }
        if tick > 20 && newest_complete(dir.path()).unwrap().is_some() {
            let (before, now) = (inodes(tick - 20), inodes(tick));
            let shared = now.iter().filter(|(name, inode)| before.get(*name) == Some(inode)).count();
            // A segment is 16 transitions, a step of this test 100; what was unfinished is written anew.
            assert!(now.len() - shared <= 100 / 16 + 2, "{shared} of {} segments are shared", now.len());
            assert!(shared + 8 >= before.len().min(640 / 16 - 8), "{shared} of {}", before.len());
        }
        let loaded =
            load(&directory(dir.path(), tick), &plan.experiment, demonstration(&plan.experiment)).unwrap();
        assert!(everything(&loaded.agent) == everything(&agent), "tick {tick}");
    }
    // What somebody has removed is written again.
    let gone = newest_complete(dir.path()).unwrap().unwrap().1;
    fs::remove_dir_all(&gone).unwrap();
    live(&mut agent, &mut world, 1, 1);
    save(&mut saver, &plan, 241, &agent).unwrap();
    let loaded =
        load(&directory(dir.path(), 241), &plan.experiment, demonstration(&plan.experiment)).unwrap();
    assert!(everything(&loaded.agent) == everything(&agent));
}

/// A checkpoint that cannot be written is reported when the next one is taken, or this one waited for.
#[test]
fn a_failure_to_write_is_reported() {
    let plan = plan(&[]);
    let (dir, agent) = run(&plan, &[6]);
    let checkpoints = dir.path().join(CHECKPOINTS_DIR);
    fs::remove_dir_all(&checkpoints).unwrap();
    fs::write(&checkpoints, b"in the way").unwrap();
    let mut saver = Saver::new(dir.path());
    let fault = save(&mut saver, &plan, 7, &agent).unwrap_err().to_string();
    assert!(fault.contains("checkpoints"), "{fault}");
    saver.wait().unwrap();
}

/// The plan of a later learner of the same run, which goes on from checkpoint `from`.
fn later(plan: &RunPlan, generation: u16, from: Option<Round>) -> RunPlan {
    RunPlan { life: Life { generation, resume_tick: from, ..plan.life }, ..plan.clone() }
}

/// The same in another history.
fn of_history(history: u64, plan: &RunPlan) -> RunPlan {
    RunPlan { life: Life { history, ..plan.life }, ..plan.clone() }
}

/// An agent that has lived through other ticks than that of [`run`].
fn other_agent(plan: &RunPlan, ticks: usize) -> Agent {
    let mut agent = Agent::new(&plan.experiment, demonstration(&plan.experiment)).unwrap();
    live(&mut agent, &mut World::new(&plan.experiment, 77), plan.experiment.config.run.actors, ticks);
    agent
}

#[test]
fn a_sound_checkpoint_of_the_same_tick_is_kept_only_if_it_is_ones_own() {
    let first = plan(&[]);
    let other_run = of_history(8, &first);
    for (plan, what) in [
        (later(&first, 1, Some(4.into())), "a later learner"),
        (later(&first, 1, None), "a later learner, from the beginning"),
        (other_run, "another run"),
    ] {
        let (dir, theirs) = run(&first, &[4, 6]);
        let own = other_agent(&plan, 6);
        assert_ne!(own.weights(), theirs.weights());
        let mut saver = Saver::new(dir.path());
        save(&mut saver, &plan, 6, &own).unwrap();
        let loaded =
            load(&directory(dir.path(), 6), &plan.experiment, demonstration(&plan.experiment)).unwrap();
        assert!(everything(&loaded.agent) == everything(&own), "{what}");
        assert_eq!(newest_resumable(dir.path(), &plan).unwrap().unwrap().0, 6.into(), "{what}");
    }
    // What a learner has gone on from is the same cut, whichever learner wrote it.
    let (dir, _) = run(&first, &[4, 6]);
    let mut saver = Saver::after(dir.path(), 6.into()).unwrap();
    let written = || fs::metadata(directory(dir.path(), 6).join(MANIFEST)).unwrap().modified().unwrap();
    let before = written();
    let next = later(&first, 1, Some(6.into()));
    let again =
        load(&directory(dir.path(), 6), &next.experiment, demonstration(&next.experiment)).unwrap().agent;
    save(&mut saver, &next, 6, &again).unwrap();
    assert_eq!(written(), before);
}

#[test]
fn a_run_that_has_gone_back_leaves_what_came_after() {
    let first = plan(&["checkpoint.keep=9"]);
    let (dir, _) = run(&first, &[4, 6, 8]);
    let newest = |plan: &RunPlan| newest_resumable(dir.path(), plan).unwrap().map(|(tick, _)| tick);
    assert_eq!(newest(&first), Some(8.into()));
    // As after damage to 6 and 8 that is not there any more when somebody looks again.
    let second = later(&first, 1, Some(4.into()));
    assert_eq!(newest(&second), Some(4.into()));
    let mut agent =
        load(&directory(dir.path(), 4), &second.experiment, demonstration(&second.experiment)).unwrap().agent;
    live(&mut agent, &mut World::new(&second.experiment, 77), second.experiment.config.run.actors, 3);
    let mut saver = Saver::after(dir.path(), 4.into()).unwrap();
    save(&mut saver, &second, 7, &agent).unwrap();
    assert_eq!(newest(&second), Some(7.into()));
    assert_eq!(ticks(dir.path()).unwrap(), [7.into(), 4.into()], "6 and 8 are of another past");
    // The next one knows both.
    assert_eq!(newest(&later(&first, 2, Some(7.into()))), Some(7.into()));
    // From the beginning, there is nothing before it.
    assert_eq!(newest(&later(&first, 2, None)), None);
    assert_eq!(newest(&of_history(8, &second)), None);
}

#[test]
fn segments_of_another_learner_are_never_linked() {
    let plan = plan(&["learner.replay=640", "checkpoint.keep=9"]);
    let (dir, mut agent) = run(&plan, &[20]);
    let mut saver = Saver::after(dir.path(), 20.into()).unwrap();
    // Somebody else puts another checkpoint in its place: of the same sizes, under the same names.
    let rival = later(&plan, 1, None);
    save(&mut Saver::new(dir.path()), &rival, 20, &other_agent(&rival, 20)).unwrap();
    live(&mut agent, &mut World::new(&plan.experiment, 5), plan.experiment.config.run.actors, 20);
    save(&mut saver, &plan, 40, &agent).unwrap();
    let loaded = load(&directory(dir.path(), 40), &plan.experiment, demonstration(&plan.experiment)).unwrap();
    assert!(everything(&loaded.agent) == everything(&agent));
}

#[test]
fn checkpoints_tell_whose_they_are_where_the_plan_is_lost() {
    let first = plan(&["checkpoint.keep=9"]);
    let (dir, agent) = run(&first, &[4]);
    let experiment = &first.experiment;
    assert_eq!(newest_life(dir.path(), &plan(&["run.seed=77"]).experiment).unwrap(), None);
    let life = |generation, tick: u64| {
        Some(Life { run: 0, generation, resume_tick: Some(tick.into()), ..first.life })
    };
    assert_eq!(newest_life(dir.path(), experiment).unwrap(), life(0, 4));
    let next = later(&first, 3, Some(4.into()));
    save(&mut Saver::after(dir.path(), 4.into()).unwrap(), &next, 6, &agent).unwrap();
    assert_eq!(newest_life(dir.path(), experiment).unwrap(), life(3, 6));
    assert_eq!(newest_life(&dir.path().join("none"), experiment).unwrap(), None);
}

/// What an earlier version has left can be looked at, and not gone on from.
#[test]
fn a_checkpoint_that_does_not_say_whose_it_is_gives_its_weights_alone() {
    let plan = plan(&[]);
    let (dir, agent) = run(&plan, &[6]);
    let checkpoint = directory(dir.path(), 6);
    let text = fs::read_to_string(checkpoint.join(MANIFEST)).unwrap();
    let mut manifest: serde_json::Value = serde_json::from_str(&text).unwrap();
    let fields = manifest.as_object_mut().unwrap();
    fields["format"] = 4.into();
    assert!(fields.remove("history").is_some() && fields.remove("generation").is_some());
    let text = manifest.to_string();
    fs::write(checkpoint.join(MANIFEST), &text).unwrap();
    fs::write(checkpoint.join(COMPLETE), manifest::seal(text.as_bytes())).unwrap();
    assert_eq!(load_model(&checkpoint, agent.network().layout()).unwrap(), agent.weights());
    assert_eq!(newest_complete(dir.path()).unwrap().unwrap().0, 6.into());
    assert_eq!(newest_resumable(dir.path(), &plan).unwrap(), None);
    assert_eq!(newest_life(dir.path(), &plan.experiment).unwrap(), None);
}
