#!/bin/sh
# The comparison on maze30: eight arms, 30 seeds each. docs/results.md shows what it came to.
# usage: maze30.sh OUT [further arguments of `trestle sweep`, such as --resume, --jobs 2 or --set env.encoding=coordinates]
out=${1:?the directory of the sweep}
shift
exec "${TRESTLE:-target/release/trestle}" sweep maze30 --out "$out" --seeds 0..30 \
    --set run.episodes=4500 --set run.env_steps=1000000 --set run.stop_when_solved=true --set checkpoint.every_env_steps=0 \
    --set env.encoding=one-hot --set learner.train_every=1 \
    --set run.algo=ha-diiqn --set learner.lr=5e-4 --set exploration.epsilon_decay_steps=200000 \
    --set mentor.inference=any --set mentor.metric=kl \
    --arm dqn:run.algo=dqn \
    --arm diiqn:run.algo=diiqn,mentor.selection=min-distance \
    --arm literal:mentor.selection=min-distance,mentor.reward=observer \
    --arm matched:mentor.selection=min-distance \
    --arm gated:mentor.selection=min-distance,mentor.bridges=false \
    --arm confidence:mentor.selection=confidence \
    --arm guided:mentor.selection=confidence,exploration.guide_start=0.9,exploration.guide_decay_steps=100000 \
    --arm shaped:run.algo=dqn,shaping.potential=5 "$@"
