//! A fixed amount of the work that dominates a run, to count instructions of: `instructions step|mentor|tick N`.
//! Nothing here depends on time or chance, so that the difference between two counts is exact but for what memory
//! costs the allocator. `benches/instructions.sh` runs it.

use anyhow::{Context, Result, bail};
use trestle_actor::env::registry;
use trestle_actor::worker::Worker;
use trestle_algorithm::agent::Agent;
use trestle_algorithm::demonstration::Demonstration;
use trestle_algorithm::replay::Replay;
use trestle_bench::gradient::GradientStep;
use trestle_bench::server::{BATCH, DIM, Server};
use trestle_mentor_server::run::mentor_of;
use trestle_proto::batch::Batch;
use trestle_proto::config;
use trestle_proto::experiment::{Experiment, MentorPart};
use trestle_proto::observe::Observed;
use trestle_proto::orders::Collect;
use trestle_qnet::{Isa, Kernels, Layout};

fn main() -> Result<()> {
    let mut args = std::env::args().skip(1);
    let (what, times) = (args.next().unwrap_or_default(), args.next().unwrap_or_default());
    let times: u64 = times.parse().with_context(|| format!("N is `{times}`; accepted: whole numbers"))?;
    match what.as_str() {
        "step" => steps(times),
        "mentor" => observations(times),
        "tick" => ticks(times),
        _ => bail!("`{what}`; accepted: step, mentor, tick"),
    }
}

/// Gradient steps of maze30's network, with AVX2: valgrind does not know AVX-512.
fn steps(times: u64) -> Result<()> {
    let kernels = Kernels::new(Isa::Avx2).context("this machine has no AVX2 with FMA")?;
    let mut step = GradientStep::new(Layout::new(&[2, 128, 128, 4])?, 32, false, kernels)?;
    (0..times).try_for_each(|_| step.run())
}

/// Batches through the mentor-server and into the replay.
fn observations(times: u64) -> Result<()> {
    let stored = 64 * BATCH as usize;
    let (mut server, mut replay) = (Server::new(stored)?, Replay::new(stored, DIM)?);
    for _ in 0..times {
        let (batch, observed) = server.observe()?;
        for at in 0..batch.len() {
            replay.push(&batch.transition(at), 0, observed.mentor[at]);
        }
    }
    Ok(())
}

/// Ticks of HA-DIIQN on maze30 with one actor, in one process and without any message.
fn ticks(times: u64) -> Result<()> {
    anyhow::ensure!(
        Isa::detect() == Isa::Avx2,
        "kernels for {}; accepted: avx2, as in valgrind",
        Isa::detect()
    );
    let sets = [
        "run.algo=\"ha-diiqn\"",
        "env.encoding=coordinates",
        "learner.train_every=4",
        "learner.warmup=32",
        "learner.replay=4096",
    ]
    .map(String::from);
    let mut config = config::load(registry(), "maze30", &sets)?;
    registry().resolve(&mut config.env, config.run.seed)?;
    let spec = registry().build(&config.env)?.spec().clone();
    let mut demonstration = Demonstration::new((0..spec.obs_dim()).map(|i| format!("s{i}")).collect())?;
    let states = registry().plan_states(&config.env, &config.mentor.actions)?;
    demonstration.push_trajectory(&states.concat(), true)?;
    let mentors = vec![MentorPart { name: "plan".into(), transitions: demonstration.n_transitions() }];
    let experiment = Experiment { config, spec, mentors, waypoints: None };

    let mut worker = Worker::new(&experiment, 0)?;
    let mut mentor = mentor_of(&experiment, &demonstration)?;
    let mut agent = Agent::new(&experiment, Some(demonstration.transitions()))?;
    let (mut batch, mut observed) = (Batch::default(), Observed::default());
    for number in 1..=times {
        let env_steps = agent.counters().env_steps;
        let steps = experiment.config.run.rollout;
        let order = Collect { run: 1, round: number.into(), env_steps, steps, ..Collect::default() };
        worker.collect(agent.acting(), &order, &mut batch)?;
        let checked = batch.check(&experiment.spaces())?;
        mentor.observe(env_steps, checked.transitions(), &mut observed)?;
        agent.ingest(&checked, Some(&observed))?;
        agent.train(|| ())?;
        batch = checked.into_inner();
    }
    Ok(())
}
