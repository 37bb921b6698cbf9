//! The losses of a sample, as plain functions: which targets, which mentor transition, and which weights.
//!
//! With y a target under the target network θ⁻ and ℓ the Huber or the squared loss ([`trestle_qnet::Loss`]):
//!
//! * L_o = ℓ(Q(s_o, a_o; θ), y_o), equation (2);
//! * L_m = ℓ(Q(s_m, a_m; θ), y_m) for a feasible mentor transition, (3);
//! * L_m = ℓ(Q(s_m, a_feas; θ), y_feas) for a bridged one, (6);
//! * an infeasible mentor transition without a bridge has no L_m.
//!
//! With `learner.n_step` above 1 (not the paper's) y_o looks several steps ahead; y_m and y_feas never do.
//!
//! [`target`] computes y, [`mentor`] finds a_m and the next state, [`weights`] shares a sample out between
//! L_o and L_m by the weight that a rule of [`crate::selection`] gives.

pub mod mentor;
pub mod target;
pub mod weights;

pub use mentor::{MentorKind, MentorRule, MentorTerm, mentor_term};
pub use target::{n_step, next_value, target_value};
pub use weights::{Weights, acts};
