#!/usr/bin/env bash
# Makes the run that stands for a minor version in tests/versions.rs: a directory named after the version, and beside it what
# `eval` prints of the run.
#
#   tests/golden/runs/make.sh [PROGRAM]        PROGRAM: target/debug/trestle unless given
#
# A new minor version needs a run of its own, and so does the present one after a change of its formats or numbers. The runs of
# earlier versions stay as their programs made them; 0.1 is of commit 4842d1e.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
program=$(realpath "${1:-$here/../../../target/debug/trestle}")
cd "$here"
version=$("$program" --version | sed -n 's/^trestle \([0-9]*\.[0-9]*\)\..*/\1/p')
rm -rf "$version" "$version.txt"
# command.txt has the program's name without the place of this checkout.
(exec -a trestle "$program" train maze-small --algo ha-diiqn --seed 7 --env-steps 640 --set env.map=random:1:5x5 --set env.step_limit=60 \
    --set 'learner.hidden=[8]' --set learner.lr=0.005 --set learner.warmup=100 --set exploration.epsilon_decay_steps=500 \
    --set eval.every=2 --set checkpoint.keep=1 --quiet --out "$version")
"$program" eval "$version" >"$version.txt"
# No command reads these.
rm -rf "$version"/logs "$version"/events.out.tfevents.*
du -sb "$version"
