//! What the supervisor does about whatever happens to a run: a state machine without clocks, processes or signals.
//!
//! [`step`] takes a state and an event and gives the next state and the actions. `drive` makes events of what tokio
//! reports, and carries the actions out. This table is the whole of it, and the test reads it from here. A cell holds the
//! actions and, after an arrow, the next state where it is another one.
//!
//! | event | Starting | Training | Headless | Cancelling | Saving |
//! |---|---|---|---|---|---|
//! | Progress | Commit Show → Training | Show | | Commit Show → Saving | Show |
//! | Stop | Ask → Cancelling | Ask → Saving | End(Interrupted) | | |
//! | StopNow | End(Interrupted) | End(Interrupted) | End(Interrupted) | End(Interrupted) | End(Interrupted) |
//! | Left | End(Left) | End(Left) | End(Left) | End(Left) | End(Left) |
//! | Died(All) | End(Again) | End(Again) | End(Again) | End(Interrupted) | End(Failed) |
//! | Died(One) | Plan | Plan | Plan | Tidy | Tidy |
//! | Died(Learner) | Plan → Headless | Plan → Headless | Plan | End(Interrupted) | End(Failed) |
//! | LostPeer | Suspect | Suspect | Suspect | Suspect | Suspect |
//! | Blamed(All) | End(Again) | End(Again) | End(Again) | End(Interrupted) | End(Failed) |
//! | Blamed(One) | Plan | Plan | Plan | Tidy | Tidy |
//! | Blamed(Learner) | Plan → Headless | Plan → Headless | Plan | End(Interrupted) | End(Failed) |
//! | Faulty(All) | End(Again) | End(Again) | End(Again) | End(Interrupted) | End(Failed) |
//! | Faulty(One) | Kill | Kill | Kill | Kill | Kill |
//! | Faulty(Learner) | Kill | Kill | Kill | Kill | Kill |
//! | Due | Start | Start | Start | Start | Start |
//! | Replaced | | | | | |
//! | NewLearner | | | → Starting | | |
//! | Irreplaceable | End(Again) | End(Again) | End(Again) | End(Interrupted) | End(Failed) |
//! | Reap | Reap | Reap | Reap | Reap | Reap |

/// Where the run stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum State {
    /// The learner has reported no progress since it was started: there is nothing that it could save.
    Starting,
    /// The learner trains.
    Training,
    /// The learner has died, and another one is to take its place (free mode).
    Headless,
    /// The run was asked to stop while it was starting.
    Cancelling,
    /// The run was asked to stop while it was training: the learner finishes its tick and saves.
    Saving,
}

/// What a death means for the other processes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Reach {
    /// None of them can go on.
    All,
    /// They can go on until this actor or mentor-server is replaced (free mode).
    One,
    /// They can go on until the learner is replaced (free mode).
    Learner,
}

/// What happens to a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Event {
    /// The learner says how far it is.
    Progress,
    /// The run is asked to stop in good order.
    Stop,
    /// The run is asked to stop at once.
    StopNow,
    /// The learner has left of itself.
    Left,
    /// A process has died, through its own fault or by a signal.
    Died(Reach),
    /// A process has ended because it lost another one, whose end may not have been noticed yet.
    LostPeer,
    /// Nobody else has died within a moment: those that had lost a peer were the first to die after all.
    Blamed(Reach),
    /// A process lives, but is silent or does not get ahead.
    Faulty(Reach),
    /// It is time to start a replacement.
    Due,
    /// Replacements have been started, but not the learner's.
    Replaced,
    /// Replacements have been started, the learner's among them.
    NewLearner,
    /// A replacement could not be started.
    Irreplaceable,
    /// It is time to remove what dead clients left.
    Reap,
}

/// What is done about it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Action {
    /// The run has begun: what it replaces is removed for good.
    Commit,
    /// Show the progress.
    Show,
    /// Ask the learner to finish its tick, save and leave.
    Ask,
    /// Kill the faulty process.
    Kill,
    /// Plan the replacement of the dead, if they have not died too often.
    Plan,
    /// Remove what the dead left, so that the others notice their end, and replace nobody.
    Tidy,
    /// Start the replacements that are due.
    Start,
    /// Wait a moment for the death of the process that is to blame.
    Suspect,
    /// Remove what dead processes left in shared memory.
    Reap,
    /// Stop watching: the remaining processes are ended.
    End(End),
}

/// How a watch ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum End {
    /// The learner's result says what the run came to.
    Left,
    /// All processes may be started again after the death.
    Again,
    /// The death ends a run that was stopping anyway, and what it would have saved is lost.
    Failed,
    /// The run stops with what was saved before.
    Interrupted,
}

/// What follows from `event` in `state`.
pub(super) fn step(state: State, event: Event) -> (State, Vec<Action>) {
    use Action as A;
    use Event as E;
    use State as S;
    let stays = |action: Action| (state, vec![action]);
    match (event, state) {
        (E::Progress, S::Starting) => (S::Training, vec![A::Commit, A::Show]),
        (E::Progress, S::Cancelling) => (S::Saving, vec![A::Commit, A::Show]),
        (E::Progress, S::Training | S::Saving) => stays(A::Show),
        (E::Progress, S::Headless) => (state, Vec::new()),

        (E::Stop, S::Starting) => (S::Cancelling, vec![A::Ask]),
        (E::Stop, S::Training) => (S::Saving, vec![A::Ask]),
        (E::Stop, S::Headless) => stays(A::End(End::Interrupted)),
        (E::Stop, S::Cancelling | S::Saving) => (state, Vec::new()),

        (E::StopNow, _) => stays(A::End(End::Interrupted)),
        (E::Left, _) => stays(A::End(End::Left)),

        (E::Died(Reach::All) | E::Blamed(Reach::All) | E::Faulty(Reach::All) | E::Irreplaceable, _) => {
            stays(A::End(after_death(state)))
        }
        (E::Died(Reach::Learner) | E::Blamed(Reach::Learner), S::Cancelling | S::Saving) => {
            stays(A::End(after_death(state)))
        }
        (E::Died(Reach::Learner) | E::Blamed(Reach::Learner), _) => (S::Headless, vec![A::Plan]),
        (E::Died(Reach::One) | E::Blamed(Reach::One), S::Cancelling | S::Saving) => stays(A::Tidy),
        (E::Died(Reach::One) | E::Blamed(Reach::One), _) => stays(A::Plan),
        (E::LostPeer, _) => stays(A::Suspect),
        (E::Faulty(Reach::One | Reach::Learner), _) => stays(A::Kill),

        (E::Due, _) => stays(A::Start),
        (E::NewLearner, S::Headless) => (S::Starting, Vec::new()),
        (E::NewLearner | E::Replaced, _) => (state, Vec::new()),
        (E::Reap, _) => stays(A::Reap),
    }
}

/// The end after a death that the other processes cannot survive.
fn after_death(state: State) -> End {
    match state {
        State::Starting | State::Training | State::Headless => End::Again,
        State::Cancelling => End::Interrupted,
        State::Saving => End::Failed,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const STATES: [State; 5] =
        [State::Starting, State::Training, State::Headless, State::Cancelling, State::Saving];

    fn events() -> Vec<Event> {
        let mut events = vec![
            Event::Progress,
            Event::Stop,
            Event::StopNow,
            Event::Left,
            Event::LostPeer,
            Event::Due,
            Event::Replaced,
            Event::NewLearner,
            Event::Irreplaceable,
            Event::Reap,
        ];
        for reach in [Reach::All, Reach::One, Reach::Learner] {
            events.extend([Event::Died(reach), Event::Blamed(reach), Event::Faulty(reach)]);
        }
        events
    }

    /// The cells of the table in this file's head: the first row is its heads, the second the rule below them.
    fn table() -> Vec<Vec<&'static str>> {
        let rows = include_str!("watch.rs").lines().filter_map(|line| line.strip_prefix("//! |"));
        rows.map(|row| row.trim_end_matches('|').split('|').map(str::trim).collect()).collect()
    }

    /// What the table should say of `event` in `state`.
    fn cell(state: State, event: Event) -> String {
        let (next, actions) = step(state, event);
        let mut words: Vec<String> = actions.iter().map(|action| format!("{action:?}")).collect();
        if next != state {
            words.push(format!("→ {next:?}"));
        }
        words.join(" ")
    }

    #[test]
    fn every_event_in_every_state_is_as_the_table_says() {
        let table = table();
        let heads: Vec<String> =
            std::iter::once("event".to_string()).chain(STATES.map(|state| format!("{state:?}"))).collect();
        assert_eq!(table[0], heads);
        let rows = &table[2..];
        assert_eq!(rows.len(), events().len(), "a row an event");
        for event in events() {
            let name = format!("{event:?}");
            let row = rows.iter().find(|row| row[0] == name).unwrap_or_else(|| panic!("no row {name}"));
            for (state, written) in STATES.into_iter().zip(&row[1..]) {
                assert_eq!(cell(state, event), *written, "{name} in {state:?}");
            }
        }
    }

    /// Whatever comes, in whatever order: a run that was asked to stop never trains on, and one stop request is enough.
    #[test]
    fn a_run_that_was_asked_to_stop_stops() {
        for state in [State::Cancelling, State::Saving] {
            for event in events() {
                let (next, actions) = step(state, event);
                assert!(matches!(next, State::Cancelling | State::Saving), "{event:?} in {state:?}");
                let futile = [Action::Ask, Action::Plan, Action::End(End::Again)];
                assert!(!actions.iter().any(|action| futile.contains(action)), "{event:?} in {state:?}");
            }
        }
        for state in STATES {
            let (next, actions) = step(state, Event::Stop);
            let ends = actions == [Action::End(End::Interrupted)];
            assert!(ends || matches!(next, State::Cancelling | State::Saving), "{state:?}");
        }
    }
}
