//! Taking a transition into the history and the graph together, and the one that it displaces out of both.

use super::graph::{Graph, News};
use crate::history::History;
use crate::similarity::metric::{Metric, kl};
use trestle_proto::batch::Transition;

/// Stores a transition of `actor`, in place of the oldest one if the history is full. Returns its number and its effect
/// on the graph (nothing without a graph).
pub fn store(
    history: &mut History,
    mut graph: Option<&mut Graph>,
    metric: &Metric,
    actor: u32,
    t: &Transition<'_>,
) -> (u64, News) {
    if let Some((index, old)) = history.displaced() {
        if let Some(graph) = &mut graph {
            graph.remove(index, &old);
        }
        for id in [old.from, old.to] {
            if history.states.release(id)
                && let Some(graph) = &mut graph
            {
                graph.remove_state(id, &history.states);
            }
        }
    }
    if let Some(graph) = &mut graph {
        graph.cells.begin();
    }
    let [from, to] = [t.obs, t.next_obs].map(|state| {
        let (id, new) = history.states.acquire(state, metric);
        if new && let Some(graph) = &mut graph {
            graph.add_state(id, &history.states);
        }
        id
    });
    let index = history.push(actor, from, to, t.action, t.reward, t.flags);
    let news = graph.map_or(News::Nothing, |graph| {
        let step = kl(history.states.whitened(from), history.states.whitened(to));
        graph.strides.push(index, history.oldest(), step);
        graph.add(index, history.get(index))
    });
    (index, news)
}
