//! Entropic optimal transport between two sets of points of equal weights, by Sinkhorn's algorithm (Cuturi 2013).
//!
//! Of all plans μ ≥ 0 whose rows sum to 1/n and whose columns sum to 1/m it finds the one with the least
//! Σ μ_ij C_ij + ε Σ μ_ij (ln μ_ij - 1). That is μ = diag(u) K diag(v) with K = e^(-C/ε), and u and v are found in turns.

/// The plan ends a round early once its rows miss their sums by less than this in all.
const TOLERANCE: f64 = 1e-9;

/// Working memory, which grows to the largest problem that was solved.
#[derive(Clone, Debug, Default)]
pub struct Sinkhorn {
    kernel: Vec<f64>,
    u: Vec<f64>,
    v: Vec<f64>,
    sums: Vec<f64>,
}

impl Sinkhorn {
    /// What each row's share of the transport costs, Σ_j μ_ij C_ij, is written to `shares`; their sum is returned.
    ///
    /// `cost` is row-major, has `shares.len()` rows, and no cost below 0. `epsilon` is in units of the largest cost, and `rounds`
    /// bounds the work: each looks at every cost twice.
    pub fn shares(&mut self, cost: &[f64], epsilon: f64, rounds: usize, shares: &mut [f64]) -> f64 {
        let rows = shares.len();
        let columns = cost.len() / rows.max(1);
        let largest = cost.iter().copied().fold(0.0, f64::max);
        // Where every cost is 0 every plan is as good as any other.
        if largest == 0.0 {
            shares.fill(0.0);
            return 0.0;
        }
        let Self { kernel, u, v, sums } = self;
        let scale = -1.0 / (epsilon * largest);
        kernel.clear();
        kernel.extend(cost.iter().map(|cost| libm::exp(scale * cost)));
        let (row, column) = (1.0 / rows as f64, 1.0 / columns as f64);
        u.clear();
        u.resize(rows, row);
        v.clear();
        v.resize(columns, 1.0);
        for round in 0..rounds {
            let mut missed = 0.0;
            for (u, kernel) in u.iter_mut().zip(kernel.chunks_exact(columns)) {
                let sum: f64 = kernel.iter().zip(&*v).map(|(k, v)| k * v).sum();
                missed += (*u * sum - row).abs();
                *u = row / sum;
            }
            if round > 0 && missed < TOLERANCE {
                break;
            }
            sums.clear();
            sums.resize(columns, 0.0);
            for (u, kernel) in u.iter().zip(kernel.chunks_exact(columns)) {
                sums.iter_mut().zip(kernel).for_each(|(sum, k)| *sum += u * k);
            }
            v.iter_mut().zip(&*sums).for_each(|(v, sum)| *v = column / sum);
        }
        let rows = kernel.chunks_exact(columns).zip(cost.chunks_exact(columns)).zip(&*u);
        for (share, ((kernel, cost), u)) in shares.iter_mut().zip(rows) {
            let row = kernel.iter().zip(cost).zip(&*v);
            *share = u * row.map(|((k, cost), v)| k * v * cost).sum::<f64>();
        }
        shares.iter().sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn solve(cost: &[f64], rows: usize, epsilon: f64) -> (f64, Vec<f64>) {
        let mut shares = vec![0.0; rows];
        let sum = Sinkhorn::default().shares(cost, epsilon, 20_000, &mut shares);
        (sum, shares)
    }

    /// The least mean cost of a one-to-one assignment, over all of them: by Birkhoff's theorem the least cost of a plan between as
    /// many points on either side.
    fn assignment(cost: &[f64], n: usize, row: usize, taken: u32) -> f64 {
        if row == n {
            return 0.0;
        }
        let free = (0..n).filter(|column| taken & (1 << column) == 0);
        free.map(|column| {
            cost[row * n + column] / n as f64 + assignment(cost, n, row + 1, taken | 1 << column)
        })
        .fold(f64::INFINITY, f64::min)
    }

    /// Two points on either side. With p = μ_00, and so 1/2 - p beside it, the condition of the least is
    /// p² / (1/2 - p)² = e^((C_01 + C_10 - C_00 - C_11) / ε), which is solved for p.
    #[test]
    fn two_points_by_hand() {
        let cost = [0.0, 1.0, 3.0, 0.5f64];
        let epsilon = 0.2f64;
        let ratio = ((cost[1] + cost[2] - cost[0] - cost[3]) / (2.0 * epsilon * 3.0)).exp();
        let p = 0.5 * ratio / (1.0 + ratio);
        let expected = [(0.5 - p) * cost[1], (0.5 - p) * cost[2] + p * cost[3]];
        let (sum, shares) = solve(&cost, 2, epsilon);
        for (share, expected) in shares.iter().zip(expected) {
            assert!((share - expected).abs() < 1e-9, "{share} {expected}");
        }
        assert!((sum - expected[0] - expected[1]).abs() < 1e-9);
    }

    /// Three points against two: rows are worth 1/3 and columns 1/2, so that the middle row is split between them.
    #[test]
    fn the_middle_row_is_split() {
        let (sum, shares) = solve(&[0.0, 8.0, 2.0, 2.0, 8.0, 0.0], 3, 0.01);
        for (share, expected) in shares.iter().zip([0.0, 2.0 / 3.0, 0.0]) {
            assert!((share - expected).abs() < 1e-6, "{shares:?}");
        }
        assert!((sum - 2.0 / 3.0).abs() < 1e-6);
    }

    #[test]
    fn without_a_cost_nothing_is_shared() {
        assert_eq!(solve(&[0.0; 6], 3, 0.01), (0.0, vec![0.0; 3]));
    }

    proptest! {
        /// With a small ε the cost is that of the best assignment: it is above it by at most ε times the entropy that a plan can
        /// have, ln n² for n by n.
        #[test]
        fn the_cost_is_that_of_the_best_assignment(
            n in 1usize..6, seed in proptest::collection::vec(0u8..40, 25),
        ) {
            let cost: Vec<f64> = seed[..n * n].iter().map(|&c| f64::from(c)).collect();
            let largest = cost.iter().copied().fold(0.0, f64::max);
            let (sum, shares) = solve(&cost, n, 0.005);
            let best = assignment(&cost, n, 0, 0);
            let above = 0.005 * largest * ((n * n) as f64).ln();
            prop_assert!(sum < best + above + 2e-2 * largest + 1e-9 && sum > best - 2e-2 * largest - 1e-9, "{} {}", sum, best);
            prop_assert!(shares.iter().all(|share| *share >= 0.0));
        }
    }
}
