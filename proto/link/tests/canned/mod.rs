//! A small run and a mentor for the tests of transports.
#![allow(clippy::unwrap_used, unreachable_pub)]

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use trestle_link::MentorHandler;
use trestle_proto::NONE;
use trestle_proto::annotation::{AnnotationTable, Estimate};
use trestle_proto::batch::Spaces;
use trestle_proto::config::{self, Config};
use trestle_proto::experiment::{Experiment, MentorPart};
use trestle_proto::observe::{ObserveAnswer, ObserveRequest, Observed, Part};
use trestle_proto::plan::{Life, RunPlan};
use trestle_proto::query::{OK, OUT_OF_RANGE, QueryAnswer, QueryRequest, SIMILAR};
use trestle_proto::row::Element;
use trestle_proto::space::EnvSpec;

/// Longer than anything takes that comes at all.
pub const LONG: Duration = Duration::from_secs(20);
/// Actors of the run.
pub const ACTORS: u32 = 2;
/// Transitions of its demonstration.
pub const MENTOR: usize = 3;
/// Steps of a bridge after the first, at most: one less than `mentor.k`.
pub const FURTHER: usize = 3;

/// The plan of a run that no other test has, in `mode`.
pub fn plan(mode: &str) -> RunPlan {
    static NEXT: AtomicU64 = AtomicU64::new(0);
    // Process ids are at most 2^22, so no run of a user, which draws 64 bits, is likely to meet these.
    let run = u64::from(std::process::id()) << 32 | NEXT.fetch_add(1, Ordering::Relaxed);
    let mode = format!("run.mode={mode}");
    let small = ["run.episodes=9", "run.actors=2", "run.rollout=4", "learner.hidden=[8]", &mode];
    // Messages have every part that they can have together.
    let whole = ["run.algo=ha-diiqn", "exploration.guide_start=0.5", "exploration.guide_whole=true"];
    let overrides: Vec<String> = small.into_iter().chain(whole).map(String::from).collect();
    let config: Config = config::from_table(&(), config::Table::new(), &overrides).unwrap();
    let spec = EnvSpec {
        name: "test".into(),
        element: Element::F32,
        shape: Vec::new(),
        low: vec![0.0; 2],
        high: vec![9.0; 2],
        scale: vec![1.0; 2],
        integral: true,
        categories: Vec::new(),
        velocities: Vec::new(),
        actions: ["a", "b", "c"].map(String::from).to_vec(),
        best_return: None,
        threshold: None,
        goal_bonus: 0.0,
        defines_success: true,
    };
    let mentors = vec![MentorPart { name: "mentor".into(), transitions: MENTOR }];
    RunPlan {
        life: Life { run, ..Life::default() },
        experiment: Experiment { config, spec, mentors, waypoints: None },
    }
}

/// A mentor that names transition 1 for every observation of actor 0 and knows one annotation for each part. It refuses a
/// request that is far ahead.
pub struct Canned;

impl MentorHandler for Canned {
    fn forget(&mut self) {}

    fn observe(
        &mut self,
        request: &ObserveRequest,
        mut payload: &[u32],
        out: &mut Vec<u32>,
    ) -> ObserveAnswer {
        if request.first_index > 1000 {
            return ObserveAnswer { status: OUT_OF_RANGE, ..Default::default() };
        }
        let mut wide = Vec::new();
        while let Some(part) = Part::take(&mut payload, request.obs_dim as usize) {
            let batch =
                part.check(&Spaces { actors: ACTORS, row: 2.into(), n_actions: 3 }, &mut wide).unwrap();
            let mut table = AnnotationTable::new(MENTOR, 2, 3).keeping(FURTHER);
            table.set_estimate(
                part.actor as usize,
                &Estimate { action: 1, e_kl: 0.5, start_kl: 0.0, reward: -1.0 },
            );
            let mut answer = Observed::default();
            answer.mentor.extend((0..batch.len()).map(|at| if batch.get(at).action == 0 { 1 } else { NONE }));
            table.encode(part.actor as usize, &mut answer.changed);
            answer.encode(table.record_words(), out);
        }
        ObserveAnswer { first_index: request.first_index, ..Default::default() }
    }

    fn query(&mut self, request: &QueryRequest, payload: &[f32], out: &mut Vec<u32>) -> QueryAnswer {
        if request.op != SIMILAR {
            return QueryAnswer { status: OUT_OF_RANGE, count: 0 };
        }
        out.extend(payload.iter().map(|x| x.to_bits()));
        QueryAnswer { status: OK, count: payload.len() as u32 }
    }
}
