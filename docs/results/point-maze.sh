#!/bin/sh
# The comparison on the Point Maze: a mentor that plain DQN learns with the orthogonal actions, and seven arms with the diagonal
# ones, 30 seeds each. docs/results.md shows what it came to.
# usage: point-maze.sh OUT [further arguments of `trestle sweep`, such as --resume or --jobs 2]
set -eu
out=${1:?the directory of the sweep}
shift
trestle=${TRESTLE:-target/release/trestle}
mentor=$out.mentor.csv
if [ ! -e "$mentor" ]; then
    "$trestle" train point-maze --algo dqn --seed 1000 --set env.actions=orthogonal --set env.backend=builtin \
        --out "$out.mentor"
    "$trestle" demo record "$out.mentor" --episodes 1 --out "$mentor"
fi
exec "$trestle" sweep point-maze --out "$out" --seeds 0..30 --set env.backend=builtin --set mentor.demo="$mentor" \
    --set mentor.e_infeas=1.0 --set run.stop_when_solved=true --set checkpoint.every_env_steps=0 \
    --arm dqn:run.algo=dqn \
    --arm diiqn:run.algo=diiqn,mentor.selection=min-distance \
    --arm literal:mentor.selection=min-distance,mentor.reward=observer \
    --arm matched:mentor.selection=min-distance \
    --arm gated:mentor.selection=min-distance,mentor.bridges=false \
    --arm confidence:mentor.selection=confidence \
    --arm guided:mentor.selection=confidence,exploration.guide_start=0.9,exploration.guide_decay_steps=40000 "$@"
