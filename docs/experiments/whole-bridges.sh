#!/bin/sh
# Whole bridges as options of the guide, on the mazes with one-hot input and the Point Maze of the set `choosing`: docs/experiments.md.
# usage: whole-bridges.sh OUT [further arguments of `trestle sweep`, such as --resume or --jobs 2]
out=${1:?the directory of the sweeps}
shift
guided=run.algo=ha-diiqn,exploration.guide_start=0.9,exploration.guide_decay_steps=100000
compare() {
    group=$1
    shift
    "${TRESTLE:-target/release/trestle}" sweep suite --task-set choosing --tasks "$group/*" --out "$out/$group" --seeds 0..4 \
        --arm "guided:$guided" --arm "whole:$guided,exploration.guide_whole=true" "$@"
}
compare mazes-one-hot --algos dqn,ha-diiqn "$@" && compare point-maze "$@"
