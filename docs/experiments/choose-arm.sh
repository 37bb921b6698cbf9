#!/bin/sh
# Variants of HA-DIIQN on four random maps that no comparison uses, two seeds each: docs/experiments.md.
# usage: choose-arm.sh OUT [further arguments of `trestle sweep`, such as --resume or --jobs 2]
out=${1:?the directory of the sweep}
shift
one_sided=mentor.selection=always,mentor.combine=beside,mentor.one_sided=true
guide=exploration.guide_start=0.9,exploration.guide_decay_steps=100000
exec "${TRESTLE:-target/release/trestle}" sweep maze30 --out "$out" --seeds 1..3 --episodes 4500 --env-steps 1000000 \
    --over env.map=random:101:30x30,random:102:30x30,random:103:30x30,random:104:30x30 \
    --set run.stop_when_solved=true --set checkpoint.every_env_steps=0 \
    --set env.encoding=one-hot --set learner.train_every=1 \
    --set run.algo=ha-diiqn --set learner.lr=5e-4 --set exploration.epsilon_decay_steps=200000 \
    --set mentor.inference=any --set mentor.metric=kl \
    --arm dqn:run.algo=dqn \
    --arm conf:mentor.selection=confidence \
    --arm min:mentor.selection=min-distance \
    --arm "one-sided:$one_sided" \
    --arm "guided:mentor.selection=confidence,$guide" \
    --arm "guided-one-sided:$one_sided,$guide" \
    --arm shaped:run.algo=dqn,shaping.potential=5 "$@"
