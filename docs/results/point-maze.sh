#!/bin/sh
# The comparison on the Point Maze: a mentor that plain DQN learns with the orthogonal actions, and seven arms with the diagonal
# ones, 30 seeds each. docs/results.md shows what it came to.
# usage: point-maze.sh OUT [further arguments of `trestle sweep`, such as --resume or --jobs 2]
set -eu
out=${1:?the directory of the sweep}
shift
trestle=${TRESTLE:-target/release/trestle}
mentor=$out.mentor.csv
settings="--set learner.n_step=1 --set learner.warmup=2000 --set learner.tau=0.005 --set exploration.epsilon_decay_steps=40000
    --set eval.threshold=-0.12 --set mentor.inference=any --set mentor.metric=kl"
if [ ! -e "$mentor" ]; then
    # shellcheck disable=SC2086 # Settings are words.
    "$trestle" train point-maze --algo dqn --seed 1000 --set env.actions=orthogonal --set env.backend=builtin \
        $settings --out "$out.mentor"
    "$trestle" demo record "$out.mentor" --episodes 1 --out "$mentor"
fi
# shellcheck disable=SC2086
exec "$trestle" sweep point-maze --out "$out" --seeds 0..30 $settings --set run.algo=ha-diiqn --set env.backend=builtin --set mentor.demo="$mentor" \
    --set mentor.e_infeas=1.0 --set run.stop_when_solved=true --set checkpoint.every_env_steps=0 \
    --arm dqn:run.algo=dqn \
    --arm diiqn:run.algo=diiqn,mentor.selection=min-distance \
    --arm literal:mentor.selection=min-distance,mentor.reward=observer \
    --arm matched:mentor.selection=min-distance \
    --arm gated:mentor.selection=min-distance,mentor.bridges=false \
    --arm confidence:mentor.selection=confidence \
    --arm guided:mentor.selection=confidence,exploration.guide_start=0.9,exploration.guide_decay_steps=40000 "$@"
