//! What actors get of whole bridges, against the annotations.

use super::{agent, live};
use crate::agent::{Agent, Parts};
use crate::losses::{MentorKind, MentorRule, mentor_term};
use crate::testing::{MENTOR_LEN, demonstration, experiment};
use trestle_proto::acting::Options;

const WHOLE: [&str; 3] = ["run.algo=ha-diiqn", "exploration.guide_start=0.5", "exploration.guide_whole=true"];

/// Options of the bridges that `agent`'s losses use, each looked up by itself.
fn expected(agent: &Agent) -> Options {
    let experiment = experiment(&WHOLE);
    let transitions = demonstration(&experiment).unwrap();
    let table = agent.annotations().unwrap();
    let rule = MentorRule::new(experiment.config.run.algo, &experiment.config.mentor);
    let mut options = Options::default();
    for j in 0..MENTOR_LEN {
        let term = mentor_term(&rule, j, table, &transitions, 0.0);
        if term.is_some_and(|term| term.kind == MentorKind::Bridged) {
            // Each made-up bridge has two steps.
            options.push(j as u32, table.further(j).unwrap());
        }
    }
    options
}

#[test]
fn options_are_those_of_the_losses_and_come_back_with_the_annotations() {
    let (mut agent, mut world) = agent(&WHOLE, 3);
    let rooms = experiment(&WHOLE).rooms();
    let mut counts = Vec::new();
    for _ in 0..40 {
        live(&mut agent, &mut world, 1);
        assert_eq!(agent.acting().options, expected(&agent));
        assert!(rooms.options.holds(&agent.acting().options));
        counts.push(agent.acting().options.of.len());
    }
    assert!(counts.iter().max() > counts.last(), "some became feasible: {counts:?}");
    let (online, target) = agent.network().with_params(|o, t| (o.to_vec(), t.to_vec())).unwrap();
    let parts = Parts {
        state: agent.state(),
        online,
        target,
        adam: agent.adam().clone(),
        annotations: agent.annotation_records(),
        selection: agent.selection().unwrap(),
    };
    let (mut other, _) = super::agent(&WHOLE, 3);
    other.replay_mut().read_head(&mut &agent.replay().head()[..]).unwrap();
    for (span, _) in agent.replay().segments(&[]) {
        other.replay_mut().read_segment(span, &mut &agent.replay().segment(span)[..]).unwrap();
    }
    other.restore(&parts).unwrap();
    assert_eq!(other.acting(), agent.acting());
}

#[test]
fn without_the_setting_there_are_none() {
    let (mut agent, mut world) = agent(&WHOLE[..2], 3);
    live(&mut agent, &mut world, 20);
    assert_eq!(agent.acting().options, Options::default());
    assert_eq!(agent.acting().known.len(), MENTOR_LEN);
}
