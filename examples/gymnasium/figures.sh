#!/usr/bin/env bash
# The figures of the examples: trains the mentors, records them, and trains every arm on every task.
#
#   examples/gymnasium/figures.sh [OUT] [SEEDS] [TASK...]
#
# OUT defaults to runs/gymnasium, SEEDS to 0..10, TASK to all tasks, such as `cart-pole door-key`. It goes on where it was
# interrupted. It needs the Python package, and for all tasks minigrid, minatar, gymnasium[mujoco], sumo-rl and eclipse-sumo.
# OUT/suite/report has the tables.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"

out=${1:-runs/gymnasium}
seeds=${2:-0..10}
shift $(($# < 2 ? $# : 2))
tasks=("$@")
[[ ${#tasks[@]} -gt 0 ]] || tasks=(cart-pole mountain-car door-key breakout reacher junction)

# A busy machine must not make a process look dead.
patient=(--set supervise.silence_s=600 --set supervise.stall_s=600)

for task in "${tasks[@]}"; do
    mentor="$out/mentors/$task"
    [[ ! -e "$task.csv" ]] || continue
    if [[ -e "$mentor/plan.bin" ]]; then
        trestle resume "$mentor"
    else
        trestle train "$task-mentor.toml" "${patient[@]}" --out "$mentor"
    fi
    trestle demo record "$mentor" --episodes 20 --out "$task.csv"
done
trestle sweep suite --task-set tasks.toml "${tasks[@]/#/--tasks=gymnasium/}" --algos dqn,ha-diiqn,trestle --seeds "$seeds" \
    --jobs 1 "${patient[@]}" --resume --out "$out/suite"
trestle report "$out/suite"
