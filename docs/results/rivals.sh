#!/bin/sh
# The rivals beside `dqn` and `trestle` on one maze of each of eight generators. No value was chosen on any of them.
# docs/rivals.md has the result.
# usage: rivals.sh OUT [further arguments of `trestle sweep`, such as --jobs 2]
# It goes on where it was stopped. The weights are the ones that rivals-choosing.sh found best.
out=${1:?the directory of the sweep}
shift
[ -e "$out" ] && set -- --resume "$@"
exec "${TRESTLE:-target/release/trestle}" sweep suite --task-set reporting --out "$out" --seeds 0..3 --tasks 'mazes-one-hot/*01' \
    --algos dqn,trestle,diiqn+labels,dqn+resets \
    --arm shaped:algo=dqn,shaping.potential=1 \
    --arm optimal-transport:algo=dqn,rival.kind=optimal-transport,rival.transport.weight=0.01 \
    --arm gaifo:algo=dqn,rival.kind=gaifo,rival.gaifo.weight=0.01 \
    --arm d-shape:algo=dqn,rival.kind=d-shape,rival.dshape.weight=0.01 "$@"
