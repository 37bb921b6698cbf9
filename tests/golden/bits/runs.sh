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

# The settings with which the first runs were recorded, whatever the presets have become since.
before=(--set env.encoding=coordinates --set learner.lr=5e-4 --set exploration.epsilon_decay_steps=20000)
point_before=(--set exploration.epsilon_decay_steps=40000 --set learner.warmup=2000 --set learner.n_step=1 --set learner.tau=0.005
    --set eval.threshold=-0.12)

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

# A run with the default inference, and as `NAME-any` by the papers' letter. The latter have the results that the former had
# when there was nothing else.
both() {
    local name=$1
    shift
    run "$name" "$@"
    run "$name-any" "${letter[@]}" "$@"
}

# The learner dies in the middle; the supervisor starts all again, and the run is prolonged afterwards.
killed() {
    local name=killed-and-resumed
    local args=(maze-small "${before[@]}" --algo ha-diiqn --seed 9 --actors 2 --set checkpoint.every_env_steps=2000)
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
    local small=(maze-small --env-steps 12000 "${before[@]}")
    local onehot=(--set env.encoding=one-hot)
    local letter=(--set mentor.inference=any --set mentor.metric=kl)
    printf 'run,weights_sha256,evals_sha256\n'
    run dqn "${small[@]}" --algo dqn --seed 1
    both diiqn "${small[@]}" --algo diiqn --seed 2
    both ha-diiqn "${small[@]}" --algo ha-diiqn --seed 3
    both no-bridges "${small[@]}" --algo ha-diiqn --seed 3 --set mentor.bridges=false
    both one-hot "${small[@]}" --algo ha-diiqn --seed 4 "${onehot[@]}"
    both three-actors "${small[@]}" --algo ha-diiqn --seed 5 --actors 3
    both lag "${small[@]}" --algo ha-diiqn --seed 6 --actors 3 --set run.lag=1
    both guided "${small[@]}" --algo ha-diiqn --seed 7 "${onehot[@]}" --set exploration.guide_start=0.9
    both guided-lag "${small[@]}" --algo ha-diiqn --seed 7 --actors 2 --set run.lag=1 --set exploration.guide_start=0.9
    run whole-bridges "${small[@]}" --algo ha-diiqn --seed 7 --actors 2 --set exploration.guide_start=0.9 \
        --set exploration.guide_whole=true
    both confidence "${small[@]}" --algo ha-diiqn --seed 8 --set mentor.selection=confidence
    both one-sided "${small[@]}" --algo ha-diiqn --seed 8 --set mentor.selection=confidence --set mentor.one_sided=true
    both beside "${small[@]}" --algo ha-diiqn --seed 8 --set mentor.selection=confidence --set mentor.combine=beside
    both uniform "${small[@]}" --algo ha-diiqn --seed 8 --set mentor.selection=confidence --set mentor.draw=uniform
    both always "${small[@]}" --algo diiqn --seed 8 --set mentor.selection=always
    both literal-reward "${small[@]}" --algo ha-diiqn --seed 8 --set mentor.reward=observer
    run shaping "${small[@]}" --algo dqn --seed 10 --set shaping.potential=1.0
    both n-step "${small[@]}" --algo ha-diiqn --seed 10 --actors 2 --set learner.n_step=5 --set learner.replay=3000
    both candle maze-small "${before[@]}" --env-steps 3000 --algo ha-diiqn --seed 11 --set learner.backend=candle
    both reference "${small[@]}" --algo ha-diiqn --seed 6 --actors 3 --set run.lag=1 --mode reference
    run hard-target "${small[@]}" --algo dqn --seed 12 --set learner.target=hard --set learner.loss=squared \
        --set learner.double=false --set learner.max_grad_norm=1.0
    both random-map "${small[@]}" --algo ha-diiqn --seed 13 --set env.map=random:5:10x10
    local point=(point-umaze "${point_before[@]}" --env-steps 8000 --set env.backend=builtin)
    run point-dqn "${point[@]}" --algo dqn --seed 1
    both point-ha-diiqn "${point[@]}" --algo ha-diiqn --seed 2 --actors 3
    local delta=("${point[@]}" --algo ha-diiqn --seed 3 --set mentor.metric=delta)
    run point-delta "${delta[@]}"
    # The threshold that `auto` stood for before it was taken from the velocities alone.
    run point-delta-any "${delta[@]}" --set mentor.inference=any --set mentor.e_infeas=0.023945648223161697
    # Wide enough for the mentor to matter within these few steps.
    both point-similar "${point[@]}" --algo ha-diiqn --seed 5 --set mentor.e_th=0.5
    both point-guided-random "${point[@]}" --algo ha-diiqn --seed 4 --set exploration.guide_start=0.5 \
        --set env.reset=random
    killed
    local trestle=(--algo trestle --set exploration.guide_start=0.9)
    run trestle "${small[@]}" "${trestle[@]}" --seed 14
    local many=("${small[@]}" "${trestle[@]}" "${onehot[@]}" --seed 15 --actors 3 --set run.lag=1)
    run trestle-lag "${many[@]}"
    run trestle-reference "${many[@]}" --mode reference
    run learned-guide "${small[@]}" --algo ha-diiqn --seed 16 --set exploration.guide=learned \
        --set exploration.guide_end=0.9 --set mentor.learned.idle=7 --set mentor.learned.gate=false
    run own-paths-off "${small[@]}" "${trestle[@]}" --seed 17 --set mentor.learned.own_paths=0 --set mentor.learned.imitate=0
    run point-trestle "${point[@]}" "${trestle[@]}" --seed 6 --actors 2 --set learner.n_step=5
}

all >"$work/runs.csv"
if [[ -n "$record" ]]; then
    cp "$work/runs.csv" "$here/runs.csv"
    printf 'recorded %s runs\n' "$(($(wc -l <"$here/runs.csv") - 1))"
else
    diff "$here/runs.csv" "$work/runs.csv" && printf 'all %s runs are the same\n' "$(($(wc -l <"$here/runs.csv") - 1))"
fi
