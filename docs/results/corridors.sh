#!/bin/sh
# The published methods in corridors two cells wide, with honest inference. docs/results.md has what it came to.
# usage: corridors.sh OUT [further arguments of `trestle sweep`, such as --jobs 2]
# It goes on where it was stopped. corridors.py OUT prints the table.
out=$(realpath -m "${1:?the directory of the sweep}")
program=$(realpath "${TRESTLE:-target/release/trestle}")
shift
[ -e "$out" ] && set -- --resume "$@"
# Maps and demonstrations are named from here.
cd "$(dirname "$0")" || exit
exec "$program" sweep suite --task-set corridors.toml --out "$out" --seeds 0..30 \
    --set run.algo=ha-diiqn \
    --arm dqn:run.algo=dqn \
    --arm diiqn:run.algo=diiqn,mentor.selection=min-distance \
    --arm gated:mentor.selection=min-distance,mentor.bridges=false \
    --arm matched:mentor.selection=min-distance \
    --arm confidence:mentor.selection=confidence "$@"
