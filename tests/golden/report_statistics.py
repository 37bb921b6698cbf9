"""Golden values for the statistics of reports: SciPy's and rliable's results on fixed samples, as JSON.

    pip install numpy==2.4.6 scipy==1.17.1 rliable==1.2.0 "pandas<3"
    python tests/golden/report_statistics.py > tests/golden/report_statistics.json
"""

import json

import numpy as np
from rliable import library, metrics
from scipy import stats

RESAMPLES = 2000
REPEATS = 6


def intervals(scores, function):
    """Ends of the stratified bootstrap's interval, their mean and the larger standard deviation over repeats."""
    ends = []
    for seed in range(REPEATS):
        _, found = library.get_interval_estimates(
            scores, function, reps=RESAMPLES, random_state=np.random.RandomState(seed)
        )
        ends.append(np.ravel(found["x"]))
    ends = np.array(ends)
    return ends.mean(axis=0).tolist(), float(ends.std(axis=0).max())


def case(rng, tasks, runs, shift):
    """`tasks` x `runs` samples of two arms, rounded so that ties occur; `shift` is between the arms."""
    scale = np.arange(1, tasks + 1)
    a = np.round(rng.gamma(3.0, 20.0, size=(runs, tasks)) * scale)
    b = np.round(rng.gamma(3.0, 20.0, size=(runs, tasks)) * scale + shift)
    pooled = a.ravel()
    iqm, iqm_noise = intervals({"x": a}, lambda x: np.array([metrics.aggregate_iqm(x)]))
    # rliable's probability of improvement is that of larger scores.
    improvement, improvement_noise = intervals(
        {"x": (-a, -b)}, lambda x, y: np.array([metrics.probability_of_improvement(x, y)])
    )
    return {
        "a": a.T.tolist(),
        "b": b.T.tolist(),
        "mean": float(np.mean(pooled)),
        "std": float(np.std(pooled)),
        "iqm": float(stats.trim_mean(pooled, 0.25)),
        "median": float(np.median(pooled)),
        "quantile_10": float(np.quantile(pooled, 0.1)),
        "probability_smaller": float(metrics.probability_of_improvement(-a, -b)),
        "iqm_interval": iqm,
        "improvement_interval": improvement,
        "iqm_noise": iqm_noise,
        "improvement_noise": improvement_noise,
    }


def wilson(hits, runs):
    """Wilson's interval of a share."""
    found = stats.binomtest(hits, runs).proportion_ci(method="wilson")
    return {"hits": hits, "runs": runs, "low": float(found.low), "high": float(found.high)}


def main():
    rng = np.random.default_rng(7)
    cases = [case(rng, *sizes) for sizes in [(1, 30, 10.0), (1, 7, -20.0), (4, 5, 25.0), (10, 9, 0.0)]]
    shares = [wilson(*case) for case in [(7, 10), (0, 5), (5, 5), (1, 30)]]
    print(json.dumps({"cases": cases, "shares": shares}, indent=1))


if __name__ == "__main__":
    main()
