#!/bin/sh
# Twelve random maps, five seeds each, without a mentor and with one. docs/results.md shows what it came to.
# usage: random-maps.sh OUT [further arguments of `trestle sweep`, such as --resume or --jobs 2]
out=${1:?the directory of the sweep}
shift
exec "${TRESTLE:-target/release/trestle}" sweep maze30 --out "$out" --seeds 0..5 --episodes 4500 --env-steps 1000000 \
    --over "env.map=$(seq -s, -f 'random:%g:30x30' 1 12)" \
    --set run.stop_when_solved=true --set checkpoint.every_env_steps=0 \
    --set env.encoding=one-hot --set learner.train_every=1 \
    --set run.algo=ha-diiqn --set learner.lr=5e-4 --set exploration.epsilon_decay_steps=200000 \
    --set mentor.inference=any --set mentor.metric=kl \
    --arm dqn:run.algo=dqn \
    --arm confidence:mentor.selection=confidence \
    --arm guided:mentor.selection=confidence,exploration.guide_start=0.9,exploration.guide_decay_steps=100000 "$@"
