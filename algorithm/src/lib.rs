//! The paper's algorithm, as plain functions over plain data. Nothing here sends, waits, or reads a clock.
//!
//! In reading order; every module names the equations, figures and choices that it stands for:
//!
//! 1. [`similarity`]: the distance of two states, and the mentor states near a state;
//! 2. [`demonstration`]: the mentor's states; [`summary`]: the thresholds that follow from them;
//! 3. [`history`] and [`states`]: the observer's transitions, as inference and bridges look at them;
//! 4. [`inference`]: which action the mentor probably took (a_est), and how good the guess is (e_KL);
//! 5. [`bridge`]: other ways from a mentor state back onto the mentor's path;
//! 6. [`mentor`]: these together, one batch of transitions after the other;
//! 7. [`losses`]: the observer's loss and the mentor's; [`selection`]: the rules that weigh one against the other;
//! 8. [`replay`]: what a gradient step draws from;
//! 9. [`agent`]: the gradient step and all that it changes;
//! 10. [`learned_bridges`] (ours): a policy that leads back onto the mentor's path, learnt to explore;
//! 11. [`rivals`]: other people's ways to learn from a mentor's states, to compare with;
//! 12. [`reference`](mod@reference): all of this in one loop.

pub mod agent;
pub mod bridge;
pub mod demonstration;
pub mod history;
pub mod inference;
pub mod learned_bridges;
pub mod losses;
pub mod mentor;
pub mod reference;
pub mod replay;
pub mod rivals;
pub mod selection;
pub mod similarity;
pub mod states;
pub mod summary;

#[cfg(test)]
mod testing;
