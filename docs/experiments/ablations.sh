#!/bin/sh
# What each part of `trestle` is worth: the algorithm without it, on the set that its values were chosen on. docs/experiments.md.
# usage: ablations.sh OUT [further arguments of `trestle sweep`, such as --jobs 2]
# It goes on where it was stopped.
out=${1:?the directory of the sweep}
shift
[ -e "$out" ] && set -- --resume "$@"
exec "${TRESTLE:-target/release/trestle}" sweep suite --task-set choosing --out "$out" --seeds 0..2 \
    --arm dqn:run.algo=dqn \
    --arm trestle:run.algo=trestle \
    --arm no-guide:run.algo=trestle,exploration.guide_start=0.000001,mentor.learned.search=0 \
    --arm no-own-paths:run.algo=trestle,mentor.learned.own_paths=0,mentor.learned.imitate=0 \
    --arm no-correction:run.algo=trestle,mentor.learned.correct=0 \
    --arm no-imitation:run.algo=trestle,mentor.learned.imitate=0 \
    --arm no-gate:run.algo=trestle,mentor.learned.gate=false \
    --arm no-search:run.algo=trestle,mentor.learned.search=0 \
    --arm no-roaming:run.algo=trestle,mentor.learned.idle=0 \
    --arm no-persistence:run.algo=trestle,mentor.learned.persist=0 "$@"
