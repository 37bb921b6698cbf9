#!/bin/sh
# Which weight each rival gets: three of each, on five tasks of the choosing set. docs/rivals.md has the result.
# usage: rivals-choosing.sh OUT [further arguments of `trestle sweep`, such as --jobs 2]
# It goes on where it was stopped.
out=${1:?the directory of the sweep}
shift
[ -e "$out" ] && set -- --resume "$@"
exec "${TRESTLE:-target/release/trestle}" sweep suite --task-set choosing --out "$out" --seeds 0..1 --env-steps 40000 \
    --tasks 'mazes-one-hot/halls-16x16-*' --tasks 'mazes-one-hot/corridors-2-14x14-*' --tasks 'mazes-one-hot/rooms-18x18-*' \
    --tasks 'mazes-coordinates/halls-16x16-*' --tasks 'point-maze/serpentine-6x7-*' \
    --arm dqn:algo=dqn \
    --arm shaped-1:algo=dqn,shaping.potential=1 \
    --arm shaped-5:algo=dqn,shaping.potential=5 \
    --arm shaped-20:algo=dqn,shaping.potential=20 \
    --arm ot-0.01:algo=dqn,rival.kind=optimal-transport,rival.transport.weight=0.01 \
    --arm ot-0.1:algo=dqn,rival.kind=optimal-transport,rival.transport.weight=0.1 \
    --arm ot-1:algo=dqn,rival.kind=optimal-transport,rival.transport.weight=1 \
    --arm gaifo-0.01:algo=dqn,rival.kind=gaifo,rival.gaifo.weight=0.01 \
    --arm gaifo-0.1:algo=dqn,rival.kind=gaifo,rival.gaifo.weight=0.1 \
    --arm gaifo-1:algo=dqn,rival.kind=gaifo,rival.gaifo.weight=1 \
    --arm d-shape-0.01:algo=dqn,rival.kind=d-shape,rival.dshape.weight=0.01 \
    --arm d-shape-0.1:algo=dqn,rival.kind=d-shape,rival.dshape.weight=0.1 \
    --arm d-shape-1:algo=dqn,rival.kind=d-shape,rival.dshape.weight=1 "$@"
