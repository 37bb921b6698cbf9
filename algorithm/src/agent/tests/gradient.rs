//! The gradient of a step, against a naive computation of every sample's loss and candle's autodiff.

use super::{agent, live};
use crate::agent::{Agent, TrainStats};
use crate::testing::{Walked, World};
use proptest::prelude::*;
use trestle_proto::NONE;
use trestle_proto::annotation::AnnotationTable;
use trestle_proto::batch::FIRST;
use trestle_proto::config::{CombineKind, DrawKind};
use trestle_proto::mentor::MentorTransitions;
use trestle_qnet::autodiff::{Samples, loss_and_gradient};
use trestle_qnet::{Isa, Loss};

/// Q-values of a raw state in f64, layer by layer. None if a ReLU hangs on the last bits.
fn naive_q(agent: &Agent, params: &[f32], obs: &[f32]) -> Option<Vec<f64>> {
    let layers = agent.network().layout().layers();
    // The test's features go from -4 to 4.
    let mut x: Vec<f64> = obs.iter().map(|&v| f64::from(v) / 4.0).collect();
    for (l, layer) in layers.iter().enumerate() {
        let (w, b) = (&params[layer.weights()], &params[layer.bias()]);
        let unit = |o: usize| {
            let sum: f64 = (0..layer.inputs).map(|i| x[i] * f64::from(w[i * layer.outputs + o])).sum();
            sum + f64::from(b[o])
        };
        let sums: Vec<f64> = (0..layer.outputs).map(unit).collect();
        if l + 1 == layers.len() {
            return Some(sums);
        }
        if sums.iter().any(|sum| sum.abs() < 1e-6) {
            return None;
        }
        x = sums.into_iter().map(|sum| sum.max(0.0)).collect();
    }
    None
}

/// The best action; none if that hangs on the last bits.
fn best(q: &[f64]) -> Option<usize> {
    let best = (0..q.len()).max_by(|&a, &b| q[a].total_cmp(&q[b]))?;
    (0..q.len()).all(|a| a == best || q[best] - q[a] > 1e-6).then_some(best)
}

/// One Q-value with its target and weight, from the definitions.
struct Naive {
    obs: Vec<f32>,
    action: u32,
    target: f64,
    weight: f64,
}

/// (action, next state, terminal, reward) of the mentor's loss, from the definitions.
fn naive_mentor(
    agent: &Agent,
    table: &AnnotationTable,
    transitions: &MentorTransitions,
    j: usize,
    r_o: f32,
) -> Option<(u32, Vec<f32>, bool, f32, bool)> {
    let rule = agent.settings.rule;
    let diiqn = rule.algo == trestle_proto::config::Algo::Diiqn;
    let own_reward = rule.reward == trestle_proto::config::RewardKind::Observer;
    let pick = |matched| if own_reward { r_o } else { matched };
    match (table.estimate(j), table.bridge(j)) {
        (Some(e), _) if diiqn || e.e_kl < 0.1 => {
            let next = transitions.next_state(j).to_vec();
            Some((e.action, next, transitions.terminal(j), pick(e.reward), true))
        }
        (_, Some(b)) if !diiqn => Some((b.action, b.next_obs.to_vec(), b.terminated, pick(b.reward), false)),
        _ => None,
    }
}

/// Every transition that was ever stored, in the order of the replay: (actor, its number among that actor's).
fn order(world: &World) -> Vec<(usize, usize)> {
    let batches = world.walked[0].len() / 8;
    let of_batch = |b| (0..world.walked.len()).flat_map(move |a| (8 * b..8 * b + 8).map(move |i| (a, i)));
    (0..batches).flat_map(of_batch).collect()
}

/// Reward and discount of the n-step target of number `at` of `steps`, one actor's, and the step that it ends with.
fn naive_return(agent: &Agent, steps: &[Walked], at: usize) -> (f64, f64, Walked) {
    let (n, gamma) = (agent.settings.learner.n_step, agent.settings.learner.gamma);
    let (mut sum, mut discount, mut last) = (0.0, 1.0, steps[at]);
    for (k, step) in steps[at..].iter().take(n).enumerate() {
        if k > 0 && (last.transition().ends_episode() || step.flags & FIRST != 0) {
            break;
        }
        sum += discount * f64::from(step.reward);
        discount *= gamma;
        last = *step;
    }
    (sum, discount, last)
}

const C_MAX: u32 = 9;

/// Word `at` of what a selection rule remembers.
fn word(memory: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(memory[4 * at..][..4].try_into().unwrap())
}

/// Q_o^past and Q_m^past of `slot` in what `min-distance` remembers.
fn past(agent: &Agent, memory: &[u8], slot: usize) -> [f32; 2] {
    [slot, agent.replay().len() + slot].map(|at| f32::from_bits(word(memory, at)))
}

/// All terms of the drawn samples; none if a choice hangs on the last bits. `memory`: what the selection rule remembered
/// before. `drawn`: the mentor transitions drawn with them, if any were.
fn naive_terms(
    agent: &Agent,
    (selection, memory): (&str, &[u8]),
    world: &World,
    slots: &[u32],
    drawn: &[u32],
    online: &[f32],
    target: &[f32],
) -> Option<Vec<Naive>> {
    let settings = &agent.settings;
    let value = |next: &[f32]| {
        let values = naive_q(agent, target, next)?;
        if settings.learner.double {
            Some(values[best(&naive_q(agent, online, next)?)?])
        } else {
            Some(values.into_iter().fold(f64::NEG_INFINITY, f64::max))
        }
    };
    let y = |reward: f32, terminal: bool, next: &[f32]| {
        let value = if terminal { 0.0 } else { value(next)? };
        Some(f64::from(reward) + settings.learner.gamma * value)
    };
    let order = order(world);
    let stored = agent.replay().first_index() as usize..order.len();
    let mut terms = Vec::new();
    for (at, &slot) in slots.iter().enumerate() {
        let entry = agent.replay().get(slot as usize);
        let (own, mut scratch) = (entry, Vec::new());
        let obs_o = agent.replay().obs(slot as usize).wide(&mut scratch);
        let q_o = naive_q(agent, online, obs_o)?[own.action as usize];
        let j = match settings.draw {
            DrawKind::Similar => entry.mentor,
            DrawKind::Uniform => drawn.get(at).map(|&j| j as usize),
        };
        let mentor = agent.mentor.as_ref().zip(j).and_then(|(m, j)| {
            let term = naive_mentor(agent, &m.annotations, &m.transitions, j, own.reward)?;
            Some((m, j, term))
        });
        let mut phi = 0.0;
        if let Some((m, j, (action, next, terminal, reward, feasible))) = mentor {
            let of_s_m = naive_q(agent, online, m.transitions.state(j))?;
            let q_m = of_s_m[action as usize];
            phi = match selection {
                "min-distance" => {
                    let [past_o, past_m] = past(agent, memory, slot as usize);
                    let (move_o, move_m) = ((q_o - f64::from(past_o)).abs(), (q_m - f64::from(past_m)).abs());
                    if (move_o - move_m).abs() < 1e-6 {
                        return None;
                    }
                    f64::from(u8::from(move_m < move_o))
                }
                "confidence" => {
                    // β and e_max are the defaults, c_max is the test's.
                    let sigmoid = 1.0 / (1.0 + (of_s_m[own.action as usize] - q_m).exp());
                    let count = f64::from(word(memory, j)).min(f64::from(C_MAX));
                    let phi = sigmoid * (1.0 + count).ln() / (1.0 + f64::from(C_MAX)).ln();
                    let zeta = 1.0 - f64::from(m.annotations.errors()[j]);
                    if feasible { phi.min(zeta) } else { phi }
                }
                _ => 1.0,
            };
            let (obs, target) = (m.transitions.state(j).to_vec(), y(reward, terminal, &next)?);
            if settings.one_sided {
                if (target - q_m).abs() < 1e-6 {
                    return None;
                }
                phi = if target > q_m { phi } else { 0.0 };
            }
            terms.push(Naive { obs, action, target, weight: phi });
        }
        let index = stored.clone().find(|&index| agent.replay().slot(index as u64) == slot as usize);
        let (actor, number) = order[index.unwrap()];
        let (reward, discount, end) = naive_return(agent, &world.walked[actor], number);
        let beyond = if end.transition().terminated() { 0.0 } else { value(&end.next_obs)? };
        let (target, transition) = (reward + discount * beyond, own);
        let own = if settings.combine == CombineKind::Beside { 1.0 } else { 1.0 - phi };
        terms.push(Naive { obs: obs_o.to_vec(), action: transition.action, target, weight: own });
    }
    Some(terms)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(192))]
    #[test]
    fn loss_and_gradient_are_those_of_the_definitions(
        algo in prop::sample::select(vec!["dqn", "diiqn", "ha-diiqn"]),
        loss in prop::sample::select(vec!["huber", "squared"]),
        selection in prop::sample::select(vec!["min-distance", "confidence", "always"]),
        combine in prop::sample::select(vec!["instead", "beside"]),
        draw in prop::sample::select(vec!["similar", "uniform"]),
        one_sided: bool,
        reward in prop::sample::select(vec!["matched", "observer"]),
        isa in prop::sample::select(Isa::available().collect::<Vec<_>>()),
        double: bool,
        n_step in 1usize..6,
        actors in 1u32..4,
        seed in 0u64..1000,
    ) {
        let draw = if selection == "min-distance" { "similar" } else { draw };
        let sets = [
            format!("mentor.combine={combine}"),
            format!("mentor.draw={draw}"),
            format!("mentor.one_sided={one_sided}"),
            format!("run.algo={algo}"),
            format!("run.seed={seed}"),
            format!("run.isa={isa}"),
            format!("learner.loss={loss}"),
            format!("mentor.selection={selection}"),
            format!("mentor.reward={reward}"),
            format!("learner.double={double}"),
            format!("learner.n_step={n_step}"),
            format!("run.actors={actors}"),
            "learner.huber_delta=0.7".into(),
            format!("mentor.c_max={C_MAX}"),
        ];
        let (mut agent, mut world) = agent(&sets.each_ref().map(String::as_str), seed);
        live(&mut agent, &mut world, 12);

        let (online, target) = agent.network().with_params(|o, t| (o.to_vec(), t.to_vec())).unwrap();
        let mut stats = TrainStats::default();
        let memory = agent.selection().unwrap_or_default();
        agent.differentiate(&mut stats).unwrap();
        let (samples, grad) = (&agent.step.samples, &agent.step.gradient);
        let (slots, drawn) = (samples.slots(), samples.drawn());

        let chosen = (selection, memory.as_slice());
        let Some(naive) = naive_terms(&agent, chosen, &world, slots, drawn, &online, &target) else {
            return Err(TestCaseError::reject("it hangs on the last bits"));
        };
        let x: Vec<f32> = naive.iter().flat_map(|t| t.obs.iter().map(|v| v / 4.0)).collect();
        let actions: Vec<u32> = naive.iter().map(|t| t.action).collect();
        let targets: Vec<f32> = naive.iter().map(|t| t.target as f32).collect();
        let weights: Vec<f32> = naive.iter().map(|t| t.weight as f32).collect();
        let samples =
            Samples { x: &x, actions: &actions, targets: &targets, weights: &weights, scale: 1.0 / 8.0 };
        let network = agent.network();
        let loss: Loss = agent.settings.loss;
        let (loss, expected) = loss_and_gradient(network.layout(), network.online(), &samples, loss).unwrap();
        let share: f64 = weights.iter().map(|&w| f64::from(w)).sum::<f64>() / 8.0;
        let expected_share = if combine == "beside" { 1.0 + stats.mentor_frac() } else { 1.0 };
        prop_assert!((share - expected_share).abs() < 1e-5, "the weights of a sample: {}", share);
        prop_assert!((stats.loss_sum - f64::from(loss)).abs() < 1e-4 * (1.0 + stats.loss_sum), "{} {loss}", stats.loss_sum);
        let largest = expected.iter().fold(1e-2f32, |max, g| max.max(g.abs()));
        for (at, (got, expected)) in grad.iter().zip(&expected).enumerate() {
            prop_assert!((got - expected).abs() < 2e-4 * largest, "{}: {} {}", at, got, expected);
        }
    }
}

#[test]
fn both_back_ends_learn_the_same() {
    for algo in ["run.algo=dqn", "run.algo=ha-diiqn"] {
        let weights = ["kernels", "candle"].map(|backend| {
            let (mut agent, mut world) = agent(&[algo, &format!("learner.backend={backend}")], 11);
            live(&mut agent, &mut world, 5);
            assert_eq!(agent.counters().grad_steps, 12);
            agent.weights().to_vec()
        });
        for (kernels, candle) in weights[0].iter().zip(&weights[1]) {
            assert!((kernels - candle).abs() < 2e-3, "{kernels} {candle}");
        }
    }
}

/// Q(s, a) of a raw state under the present weights.
fn q(agent: &Agent, obs: &[f32], action: u32) -> f32 {
    naive_q(agent, agent.weights(), obs).unwrap()[action as usize] as f32
}

#[test]
fn past_values_are_set_at_insertion_and_refreshed_when_drawn() {
    let (mut agent, mut world) = agent(&["run.algo=ha-diiqn", "learner.replay=40"], 21);
    live(&mut agent, &mut world, 9);
    let (batch, observed) = world.batch(0, 8);
    agent.ingest(&batch, observed.as_ref()).unwrap();
    let close = |a: f32, b: f32| assert!((a - b).abs() < 1e-4, "{a} {b}");
    let mut with_term = 0;
    let memory = agent.selection().unwrap();
    let slots: Vec<usize> = (agent.replay().next_index() - 8..agent.replay().next_index())
        .map(|i| agent.replay().slot(i))
        .collect();
    for (at, &slot) in slots.iter().enumerate() {
        let (entry, [past_o, past_m]) = (agent.replay().get(slot), past(&agent, &memory, slot));
        let j = observed.as_ref().unwrap().mentor[at];
        assert_eq!(entry.mentor, (j != NONE).then_some(j as usize));
        let Some(j) = entry.mentor else {
            assert!(past_o.is_nan());
            continue;
        };
        close(past_o, q(&agent, agent.replay().obs(slot).wide(&mut Vec::new()), entry.action));
        let m = agent.mentor.as_ref().unwrap();
        match naive_mentor(&agent, &m.annotations, &m.transitions, j, 0.0) {
            Some((action, ..)) => {
                with_term += 1;
                close(past_m, q(&agent, m.transitions.state(j), action));
            }
            None => assert!(past_m.is_nan()),
        }
    }
    assert!(with_term > 0);

    let before: Vec<f32> = (0..40).map(|slot| past(&agent, &memory, slot)[0]).collect();
    let weights = agent.weights().to_vec();
    let mut stats = TrainStats::default();
    agent.gradient_step(&mut stats).unwrap();
    let memory = agent.selection().unwrap();
    let drawn = agent.step.samples.slots().to_vec();
    for (slot, before) in before.iter().enumerate() {
        let (entry, [past_o, _]) = (agent.replay().get(slot), past(&agent, &memory, slot));
        if entry.mentor.is_some() && drawn.contains(&(slot as u32)) {
            let mut scratch = Vec::new();
            let values = naive_q(&agent, &weights, agent.replay().obs(slot).wide(&mut scratch)).unwrap();
            close(past_o, values[entry.action as usize] as f32);
        } else {
            assert_eq!(past_o.to_bits(), before.to_bits());
        }
    }
}
