//! The rows of `metrics.jsonl` and the points of TensorBoard's curves: keys and values, and the window over
//! the newest episodes that some of them are means of.

use serde::{Deserialize, Serialize, Serializer};
use std::borrow::Cow;
use std::collections::VecDeque;
use trestle_algorithm::agent::Counters;
use trestle_proto::episode::Episode;

/// Episodes that the rolling means look back on, as in Stable-Baselines3.
pub const WINDOW: usize = 100;

/// Means over episodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Means {
    pub(super) total_reward: f64,
    pub(super) length: f64,
    /// Share of the episodes that succeeded; none where success is not defined.
    pub(super) success: Option<f64>,
}

/// Means over `episodes`, none if there are none. Summed in order, so that the same episodes give the same
/// bits.
pub(super) fn means<'a>(episodes: impl ExactSizeIterator<Item = &'a Episode>) -> Option<Means> {
    let n = episodes.len();
    if n == 0 {
        return None;
    }
    let (mut total_reward, mut length, mut success) = (0.0, 0, Some(0_u64));
    for episode in episodes {
        total_reward += episode.total_reward;
        length += episode.length;
        success = success.zip(episode.success).map(|(count, success)| count + u64::from(success));
    }
    let n = n as f64;
    let success = success.map(|count| count as f64 / n);
    Some(Means { total_reward: total_reward / n, length: length as f64 / n, success })
}

/// The newest [`WINDOW`] training episodes. Part of a checkpoint.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Window(VecDeque<Episode>);

impl Window {
    pub(super) fn push(&mut self, episode: Episode) {
        if self.0.len() == WINDOW {
            self.0.pop_front();
        }
        self.0.push_back(episode);
    }

    pub(super) fn means(&self) -> Option<Means> {
        means(self.0.iter())
    }
}

/// What the loop knows of itself at the moment of an interval row. NaN stands for "not known": the key is
/// then left out of the row.
#[derive(Clone, Debug, PartialEq)]
pub struct Gauges {
    /// ε of the actors' policy, 0 to 1.
    pub exploration_rate: f64,
    /// Loss of the newest gradient step, or its mean since the last interval.
    pub loss: f64,
    /// Learning rate.
    pub learning_rate: f64,
    /// Share of the mentor's transitions that are taken as feasible, 0 to 1.
    pub feasible_frac: f64,
    /// Share of the mentor's transitions that have a bridge, 0 to 1.
    pub bridged_frac: f64,
    /// Mean over the mentor's transitions of the divergence e_KL of their best estimate.
    pub e_kl_mean: f64,
    /// Mean length of the bridges, environment steps.
    pub bridge_len_mean: f64,
    /// Searches for bridges that met their limit so far; NaN without a mentor.
    pub searches_cut_short: f64,
    /// The same of each demonstration, where there are several.
    pub mentors: Vec<MentorGauges>,
    /// Share of the samples of gradient steps whose loss is the mentor's, 0 to 1.
    pub mentor_loss_frac: f64,
    /// What learned bridges do, with them.
    pub guide: Option<GuideGauges>,
    /// Transitions in the replay.
    pub replay_size: u64,
    /// Share of the wall clock spent waiting for other processes, 0 to 1.
    pub ipc_wait_frac: f64,
    /// The part of it that went on waiting for actors.
    pub wait_actors_frac: f64,
    /// The part of it that went on waiting for the mentor-server.
    pub wait_mentor_frac: f64,
    /// Share of the wall clock for which training stood still while a checkpoint was taken, 0 to 1.
    pub checkpoint_frac: f64,
    /// Memory of this process that is in use, MiB.
    pub memory_mb: f64,
    /// What has gone over the network to other hosts and from them, since the newest start of the run.
    pub hosts: Vec<HostGauges>,
    /// Free mode: mean age of the weights that batches were collected with, in publications, since the last interval.
    pub staleness_mean: f64,
    /// The highest of these ages.
    pub staleness_max: f64,
    /// Free mode: samples of gradient steps per stored transition, since the run began.
    pub samples_per_insert: f64,
}

/// What the loop knows of one demonstration. NaN as in [`Gauges`].
#[derive(Clone, Debug, PartialEq)]
pub struct MentorGauges {
    /// Its name.
    pub name: String,
    /// Share of its transitions that are taken as feasible, 0 to 1.
    pub feasible_frac: f64,
    /// Share of its transitions that have a bridge, 0 to 1.
    pub bridged_frac: f64,
    /// Mean over its transitions of the divergence e_KL of their best estimate.
    pub e_kl_mean: f64,
    /// Mean length of its bridges, environment steps.
    pub bridge_len_mean: f64,
    /// Share of its transitions that have been picked for an observer transition, 0 to 1.
    pub visited_frac: f64,
}

/// What is known of another host, by its name.
#[derive(Clone, Debug, PartialEq)]
pub struct HostGauges {
    /// Its name.
    pub name: String,
    /// Actors that it runs now.
    pub actors: u64,
    /// Time from a piece of a message to its acknowledgement, milliseconds; NaN before the first one.
    pub round_trip_ms: f64,
    /// Bytes sent to it.
    pub bytes_sent: u64,
    /// Bytes received from it.
    pub bytes_received: u64,
    /// Pieces of messages that were sent to it again.
    pub resent: u64,
    /// Pieces that came from it again.
    pub repeated: u64,
}

impl Default for HostGauges {
    /// Nothing known, and nothing sent.
    fn default() -> Self {
        Self {
            name: String::new(),
            actors: 0,
            round_trip_ms: f64::NAN,
            bytes_sent: 0,
            bytes_received: 0,
            resent: 0,
            repeated: 0,
        }
    }
}

/// What the loop knows of learned bridges. NaN as in [`Gauges`].
#[derive(Clone, Debug, PartialEq)]
pub struct GuideGauges {
    /// Share of the environment steps that took an action of theirs, since the last interval, 0 to 1.
    pub steps_frac: f64,
    /// Mean furthest share of the mentor's path over the episodes that ended since the last interval, 0 to 1.
    pub progress_mean: f64,
    /// Guided episodes that have ended since the run began.
    pub guided_episodes: u64,
    /// Those of them that got stuck.
    pub stuck_episodes: u64,
    /// Own paths that are kept.
    pub own_paths: u64,
    /// Mean loss of their policy since the last interval, nats.
    pub loss: f64,
    /// Mean loss of the imitation of own paths since the last interval.
    pub imitation_loss: f64,
    /// Return of the newest evaluation's episode that followed their policy alone.
    pub total_reward: f64,
}

impl Default for Gauges {
    /// Nothing known.
    fn default() -> Self {
        Self {
            exploration_rate: f64::NAN,
            loss: f64::NAN,
            learning_rate: f64::NAN,
            feasible_frac: f64::NAN,
            bridged_frac: f64::NAN,
            e_kl_mean: f64::NAN,
            bridge_len_mean: f64::NAN,
            searches_cut_short: f64::NAN,
            mentors: Vec::new(),
            mentor_loss_frac: f64::NAN,
            guide: None,
            replay_size: 0,
            ipc_wait_frac: f64::NAN,
            wait_actors_frac: f64::NAN,
            wait_mentor_frac: f64::NAN,
            checkpoint_frac: f64::NAN,
            memory_mb: f64::NAN,
            hosts: Vec::new(),
            staleness_mean: f64::NAN,
            staleness_max: f64::NAN,
            samples_per_insert: f64::NAN,
        }
    }
}

/// A value of a row.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(untagged)]
enum Value {
    Count(u64),
    Real(f64),
}

/// A row: values by key, in order. Serialises as one JSON object.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Row(Vec<(Cow<'static, str>, Value)>);

impl Serialize for Row {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|(key, value)| (key, value)))
    }
}

impl Row {
    fn count(&mut self, key: impl Into<Cow<'static, str>>, value: u64) {
        self.0.push((key.into(), Value::Count(value)));
    }

    /// Leaves out what is not finite: JSON has no word for it.
    fn real(&mut self, key: impl Into<Cow<'static, str>>, value: f64) {
        if value.is_finite() {
            self.0.push((key.into(), Value::Real(value)));
        }
    }

    fn means(&mut self, window: &Window) {
        if let Some(means) = window.means() {
            self.real("rollout/ep_rew_mean", means.total_reward);
            self.real("rollout/ep_len_mean", means.length);
            self.real("rollout/success_rate", means.success.unwrap_or(f64::NAN));
        }
    }

    /// The row as points of curves.
    pub(super) fn scalars(&self) -> Vec<(&str, f32)> {
        let single = |value: &Value| match value {
            Value::Count(value) => *value as f32,
            Value::Real(value) => *value as f32,
        };
        self.0.iter().map(|(key, value)| (key.as_ref(), single(value))).collect()
    }
}

/// The row of a finished episode; the window holds it already.
pub(super) fn episode_row(now: &Counters, wall_s: f64, episode: &Episode, window: &Window) -> Row {
    let mut row = Row::default();
    row.count("time/episodes", now.episodes);
    row.count("time/total_timesteps", now.env_steps);
    row.real("time/time_elapsed", wall_s);
    row.real("rollout/ep_rew", episode.total_reward);
    row.count("rollout/ep_len", episode.length);
    if let Some(success) = episode.success {
        row.count("rollout/ep_success", u64::from(success));
    }
    row.means(window);
    row
}

/// The row of an interval.
pub(super) fn interval_row(now: &Counters, wall_s: f64, fps: f64, window: &Window, gauges: &Gauges) -> Row {
    let mut row = Row::default();
    row.count("time/episodes", now.episodes);
    row.count("time/total_timesteps", now.env_steps);
    row.real("time/fps", fps);
    row.real("time/time_elapsed", wall_s);
    row.means(window);
    row.real("rollout/exploration_rate", gauges.exploration_rate);
    row.real("train/loss", gauges.loss);
    row.count("train/n_updates", now.grad_steps);
    row.real("train/learning_rate", gauges.learning_rate);
    row.real("mentor/feasible_frac", gauges.feasible_frac);
    row.real("mentor/bridged_frac", gauges.bridged_frac);
    row.real("mentor/e_kl_mean", gauges.e_kl_mean);
    row.real("bridge/len_mean", gauges.bridge_len_mean);
    row.real("bridge/searches_cut_short", gauges.searches_cut_short);
    for mentor in &gauges.mentors {
        let key = |what| format!("mentor/{}/{what}", mentor.name);
        row.real(key("feasible_frac"), mentor.feasible_frac);
        row.real(key("bridged_frac"), mentor.bridged_frac);
        row.real(key("e_kl_mean"), mentor.e_kl_mean);
        row.real(key("bridge_len_mean"), mentor.bridge_len_mean);
        row.real(key("visited_frac"), mentor.visited_frac);
    }
    row.real("loss/mentor_frac", gauges.mentor_loss_frac);
    if let Some(guide) = &gauges.guide {
        row.real("guide/steps_frac", guide.steps_frac);
        row.real("guide/progress_mean", guide.progress_mean);
        row.count("guide/guided_episodes", guide.guided_episodes);
        row.count("guide/stuck_episodes", guide.stuck_episodes);
        row.count("guide/own_paths", guide.own_paths);
        row.real("guide/loss", guide.loss);
        row.real("loss/imitation", guide.imitation_loss);
        row.real("guide/return", guide.total_reward);
    }
    row.count("replay/size", gauges.replay_size);
    row.real("ipc/wait_frac", gauges.ipc_wait_frac);
    row.real("ipc/wait_actors_frac", gauges.wait_actors_frac);
    row.real("ipc/wait_mentor_frac", gauges.wait_mentor_frac);
    row.real("time/checkpoint_frac", gauges.checkpoint_frac);
    row.real("memory/learner_mb", gauges.memory_mb);
    for host in &gauges.hosts {
        let key = |what| format!("hosts/{}/{what}", host.name);
        row.count(key("actors"), host.actors);
        row.real(key("round_trip_ms"), host.round_trip_ms);
        row.count(key("bytes_sent"), host.bytes_sent);
        row.count(key("bytes_received"), host.bytes_received);
        row.count(key("resent"), host.resent);
        row.count(key("repeated"), host.repeated);
    }
    row.real("free/staleness_mean", gauges.staleness_mean);
    row.real("free/staleness_max", gauges.staleness_max);
    row.real("free/samples_per_insert", gauges.samples_per_insert);
    row
}

/// TensorBoard's points of a greedy evaluation, with Stable-Baselines3's names.
pub(super) fn evaluation_scalars(means: &Means) -> Vec<(&'static str, f32)> {
    let always = [("eval/mean_reward", means.total_reward), ("eval/mean_ep_length", means.length)];
    let success = means.success.map(|share| ("eval/success_rate", share));
    always.into_iter().chain(success).map(|(key, value)| (key, value as f32)).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn unknown_values_are_left_out() {
        let now = Counters { episodes: 2, env_steps: 30, grad_steps: 7 };
        let gauges =
            Gauges { loss: f64::INFINITY, learning_rate: 5e-4, replay_size: 30, ..Gauges::default() };
        let row = interval_row(&now, 1.5, 20.0, &Window::default(), &gauges);
        assert_eq!(
            serde_json::to_string(&row).unwrap(),
            r#"{"time/episodes":2,"time/total_timesteps":30,"time/fps":20.0,"time/time_elapsed":1.5,"train/n_updates":7,"train/learning_rate":0.0005,"replay/size":30}"#
        );
        assert_eq!(row.scalars()[2], ("time/fps", 20.0));
    }

    #[test]
    fn a_host_has_keys_of_its_own() {
        let host = HostGauges { name: "b".into(), actors: 2, bytes_sent: 9, ..HostGauges::default() };
        let gauges = Gauges { hosts: vec![host], ..Gauges::default() };
        let row = interval_row(&Counters::default(), 1.5, 20.0, &Window::default(), &gauges);
        let text = serde_json::to_string(&row).unwrap();
        let expected = r#""hosts/b/actors":2,"hosts/b/bytes_sent":9,"hosts/b/bytes_received":0,"hosts/b/resent":0,"hosts/b/repeated":0}"#;
        assert!(text.ends_with(expected), "{text}");
    }

    proptest! {
        /// Against the tail of all episodes.
        #[test]
        fn window_is_the_newest(returns in proptest::collection::vec(-100i32..100, 0..260)) {
            let episodes: Vec<Episode> = returns
                .iter()
                .map(|r| Episode { total_reward: f64::from(*r), length: r.unsigned_abs().into(), success: Some(*r > 0) })
                .collect();
            let mut window = Window::default();
            episodes.iter().for_each(|episode| window.push(*episode));
            let tail = &episodes[episodes.len().saturating_sub(WINDOW)..];
            match window.means() {
                None => prop_assert!(tail.is_empty()),
                Some(means) => {
                    let n = tail.len() as f64;
                    prop_assert_eq!(means.total_reward, tail.iter().map(|e| e.total_reward).sum::<f64>() / n);
                    prop_assert_eq!(means.length, tail.iter().map(|e| e.length as f64).sum::<f64>() / n);
                    prop_assert_eq!(means.success, Some(tail.iter().filter(|e| e.success == Some(true)).count() as f64 / n));
                }
            }
        }
    }
}
