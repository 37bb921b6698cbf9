#!/bin/sh
# A mentor that leads into a dead end: docs/dead-end.md shows what comes of it. Runs, report and the page's pictures.
# usage: dead-end.sh OUT [further arguments of `trestle sweep`, such as --jobs 2]
# It goes on where it was stopped.
out=$(mkdir -p "$(dirname "${1:?the directory of the sweep}")" && realpath -m "$1")
shift
cd "$(dirname "$0")/../.." || exit
trestle=${TRESTLE:-target/release/trestle}
map=docs/results/dead-end.txt
if [ -e "$out/sweep.json" ]; then
    set -- --resume "$@"
else
    "$trestle" demo plan maze30 --set env.map="$map" --mentor hugging --out "$out-mentor.csv" --overwrite || exit
fi
"$trestle" sweep maze30 --out "$out" --seeds 0..3 --env-steps 100000 --episodes 1000000000 \
    --set run.stop_when_solved=true --set checkpoint.every_env_steps=0 --set checkpoint.keep=1 \
    --set env.map="$map" --set mentor.demo="$out-mentor.csv" \
    --arm dqn:run.algo=dqn \
    --arm confidence:run.algo=ha-diiqn \
    --arm guided:run.algo=ha-diiqn,exploration.guide_start=0.9,exploration.guide_decay_steps=100000 \
    --arm trestle:run.algo=trestle "$@" || exit
"$trestle" report "$out" --no-titles || exit
cp "$out/report/runs.csv" docs/results/dead-end-runs.csv
for arm in guided trestle; do
    for kind in paths visits values; do
        cp "$out/report/pictures/"*-maze-"$arm-$kind.svg" "docs/pictures/dead-end-$arm-$kind.svg"
    done
done
