#!/usr/bin/env bash
# Whether a change leaves every result as it was, bit by bit: trains the runs below and compares weights and evaluations
# with those on record in runs.csv. `--record` records them anew, which is for a change that means to alter results.
#
#   tests/golden/bits/runs.sh [--record] [PROGRAM]        PROGRAM: target/debug/trestle unless given
#
# A line of runs.csv: the run's name, `weights_sha256` of its result, SHA-256 of its evals.csv without the column wall_s.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
cd "$here/../../.."
record=
if [[ "${1:-}" == --record ]]; then
    record=1
    shift
fi
program=$(realpath "${1:-target/debug/trestle}")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"

# Without wall_s, the fourth column.
evals() {
    cut -d, -f1-3,5- "$1/evals.csv" | sha256sum | cut -d' ' -f1
}

line() {
    local weights
    weights=$(grep -o '"weights_sha256": *"[0-9a-f]*"' "$1/result.json" | grep -o '[0-9a-f]\{64\}')
    printf '%s,%s,%s\n' "$1" "$weights" "$(evals "$1")"
}

run() {
    local name=$1
    shift
    "$program" train "$@" --quiet --out "$name" >/dev/null
    line "$name"
}

# The learner dies in the middle; the supervisor starts all again, and the run is prolonged afterwards.
killed() {
    local name=killed-and-resumed
    local args=(maze-small --algo ha-diiqn --seed 9 --actors 2 --set checkpoint.every_env_steps=2000)
    "$program" train "${args[@]}" --env-steps 8000 --quiet --out "$name" >/dev/null &
    local supervisor=$! learner=
    until [[ -e "$name/last" ]]; do
        kill -0 "$supervisor"
        read -rt 0.05 <> <(:) || true
    done
    learner=$(pgrep -P "$supervisor" -f learner | head -n 1)
    kill -KILL "$learner" 2>/dev/null || true
    wait "$supervisor"
    "$program" train "${args[@]}" --env-steps 12000 --quiet --resume --out "$name" >/dev/null
    line "$name"
}

all() {
    local small=(maze-small --env-steps 12000)
    local onehot=(--set env.encoding=one-hot)
    printf 'run,weights_sha256,evals_sha256\n'
    run dqn "${small[@]}" --algo dqn --seed 1
    run diiqn "${small[@]}" --algo diiqn --seed 2
    run ha-diiqn "${small[@]}" --algo ha-diiqn --seed 3
    run no-bridges "${small[@]}" --algo ha-diiqn --seed 3 --set mentor.bridges=false
    run one-hot "${small[@]}" --algo ha-diiqn --seed 4 "${onehot[@]}"
    run three-actors "${small[@]}" --algo ha-diiqn --seed 5 --actors 3
    run lag "${small[@]}" --algo ha-diiqn --seed 6 --actors 3 --set run.lag=1
    run guided "${small[@]}" --algo ha-diiqn --seed 7 "${onehot[@]}" --set exploration.guide_start=0.9
    run guided-lag "${small[@]}" --algo ha-diiqn --seed 7 --actors 2 --set run.lag=1 --set exploration.guide_start=0.9
    run confidence "${small[@]}" --algo ha-diiqn --seed 8 --set mentor.selection=confidence
    run one-sided "${small[@]}" --algo ha-diiqn --seed 8 --set mentor.selection=confidence --set mentor.one_sided=true
    run beside "${small[@]}" --algo ha-diiqn --seed 8 --set mentor.selection=confidence --set mentor.combine=beside
    run uniform "${small[@]}" --algo ha-diiqn --seed 8 --set mentor.selection=confidence --set mentor.draw=uniform
    run always "${small[@]}" --algo diiqn --seed 8 --set mentor.selection=always
    run literal-reward "${small[@]}" --algo ha-diiqn --seed 8 --set mentor.reward=observer
    run shaping "${small[@]}" --algo dqn --seed 10 --set shaping.potential=1.0
    run n-step "${small[@]}" --algo ha-diiqn --seed 10 --actors 2 --set learner.n_step=5 --set learner.replay=3000
    run candle maze-small --env-steps 3000 --algo ha-diiqn --seed 11 --set learner.backend=candle
    run reference "${small[@]}" --algo ha-diiqn --seed 6 --actors 3 --set run.lag=1 --mode reference
    run hard-target "${small[@]}" --algo dqn --seed 12 --set learner.target=hard --set learner.loss=squared \
        --set learner.double=false --set learner.max_grad_norm=1.0
    run random-map "${small[@]}" --algo ha-diiqn --seed 13 --set env.map=random:5:10x10
    local point=(point-umaze --env-steps 8000 --set env.backend=builtin)
    run point-dqn "${point[@]}" --algo dqn --seed 1
    run point-ha-diiqn "${point[@]}" --algo ha-diiqn --seed 2 --actors 3
    run point-delta "${point[@]}" --algo ha-diiqn --seed 3 --set mentor.metric=delta
    run point-guided-random "${point[@]}" --algo ha-diiqn --seed 4 --set exploration.guide_start=0.5 \
        --set env.reset=random
    killed
}

all >"$work/runs.csv"
if [[ -n "$record" ]]; then
    cp "$work/runs.csv" "$here/runs.csv"
    printf 'recorded %s runs\n' "$(($(wc -l <"$here/runs.csv") - 1))"
else
    diff "$here/runs.csv" "$work/runs.csv" && printf 'all %s runs are the same\n' "$(($(wc -l <"$here/runs.csv") - 1))"
fi
