#!/bin/sh
# The Point Maze with one simulated step to a step, as the paper presumably has it, on umaze: a mentor that plain DQN learns with
# the orthogonal actions, and three arms with the diagonal ones. docs/results.md shows what it came to.
# usage: point-maze-frame-skip-1.sh OUT [further arguments of `trestle sweep`, such as --resume or --jobs 2]
set -eu
out=${1:?the directory of the sweep}
shift
trestle=${TRESTLE:-target/release/trestle}
steps="--set env.backend=builtin --set env.frame_skip=1 --set env.step_limit=4000 --set learner.gamma=0.995
    --set learner.train_every=4 --set exploration.epsilon_decay_steps=100000 --set eval.threshold=-0.6
    --set run.stop_when_solved=true --set checkpoint.every_env_steps=0 --set learner.n_step=1
    --set learner.warmup=2000 --set learner.tau=0.005 --set mentor.inference=any --set mentor.metric=kl"
mentor=$out.mentor.csv
# shellcheck disable=SC2086 # Settings are words.
if [ ! -e "$mentor" ]; then
    "$trestle" train point-umaze --algo dqn --seed 1000 --set env.actions=orthogonal $steps --out "$out.mentor"
    "$trestle" demo record "$out.mentor" --episodes 1 --out "$mentor"
fi
# shellcheck disable=SC2086
exec "$trestle" sweep point-umaze --out "$out" --seeds 0..5 $steps --set run.algo=ha-diiqn --set mentor.demo="$mentor" --set mentor.e_infeas=1.0 \
    --arm dqn:run.algo=dqn --arm diiqn:run.algo=diiqn,mentor.selection=min-distance \
    --arm guided:mentor.selection=confidence,exploration.guide_start=0.9,exploration.guide_decay_steps=100000 "$@"
