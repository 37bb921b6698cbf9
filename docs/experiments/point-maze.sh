#!/bin/sh
# How frame skip, thresholds and metric of the Point Maze were chosen, on maps that the comparison does not use.
# docs/experiments.md shows what it came to.
# usage: point-maze.sh OUT [further arguments of `trestle sweep`, such as --resume or --jobs 2]
set -eu
out=${1:?the directory of the sweeps}
shift
trestle=${TRESTLE:-target/release/trestle}

# An arm NAME ALGO with SKIP simulated steps to a step, and with it what counts steps: DISCOUNT, steps of DECAY and
# TRAIN_EVERY; solved by a path of up to SOLVED thousandths of a simulated step's reward.
arm() {
    threshold=$(awk "BEGIN { print -$7 / $3 }")
    echo "--arm $1:run.algo=$2,env.frame_skip=$3,env.step_limit=$((4000 / $3)),eval.threshold=$threshold,learner.gamma=$4,exploration.epsilon_decay_steps=$5,learner.train_every=$6"
}
common="--set run.stop_when_solved=true --set checkpoint.every_env_steps=0 --set env.backend=builtin
    --set run.algo=ha-diiqn --set learner.n_step=1 --set learner.warmup=2000 --set learner.tau=0.005
    --set exploration.epsilon_decay_steps=40000 --set mentor.inference=any"

# shellcheck disable=SC2046,SC2086 # Arms and settings are words.
"$trestle" sweep point-umaze --out "$out/frame-skip-umaze" --seeds 0..3 $common \
    $(arm fs1 dqn 1 0.995 100000 4 0.6) $(arm fs5 dqn 5 0.98 20000 1 0.6) $(arm fs10 dqn 10 0.97 10000 1 0.6) \
    $(arm fs5g dqn 5 0.99 20000 1 0.6) $(arm fs10g dqn 10 0.98 10000 1 0.6) "$@"
# shellcheck disable=SC2046,SC2086
"$trestle" sweep point-umaze --out "$out/frame-skip-large" --seeds 0..3 $common --set env.map=large \
    $(arm dqn2 dqn 2 0.99 100000 2 0.9) $(arm dqn5 dqn 5 0.98 40000 1 0.9) $(arm dqn10 dqn 10 0.97 20000 1 0.9) \
    $(arm ha2 ha-diiqn 2 0.99 100000 2 0.9) $(arm ha5 ha-diiqn 5 0.98 40000 1 0.9) $(arm ha10 ha-diiqn 10 0.97 20000 1 0.9) "$@"

mentor=$out/mentor.csv
if [ ! -e "$mentor" ]; then
    "$trestle" train point-umaze --algo dqn --seed 1000 --set env.map=large --set env.actions=orthogonal \
        --set env.backend=builtin --out "$out/mentor"
    "$trestle" demo record "$out/mentor" --episodes 1 --out "$mentor"
fi
guide=exploration.guide_start=0.9,exploration.guide_decay_steps=40000
confidence() { echo "--arm $1:mentor.selection=confidence,mentor.e_th=$2,mentor.e_infeas=$3${4:+,$4}"; }
# shellcheck disable=SC2046,SC2086
"$trestle" sweep point-umaze --out "$out/thresholds-large" --seeds 0..5 $common --set env.map=large --set mentor.demo="$mentor" \
    --arm dqn:run.algo=dqn --arm diiqn:run.algo=diiqn,mentor.selection=min-distance \
    --arm m3:mentor.selection=min-distance,mentor.e_th=0.3,mentor.e_infeas=1.0 $(confidence c3 0.3 1.0) \
    $(confidence ga '"auto"' '"auto"' "$guide") $(confidence ga1 '"auto"' 1.0 "$guide") $(confidence g3 0.3 1.0 "$guide") \
    $(confidence g10 1.0 1.0 "$guide") $(confidence g1 1.0 3.0 "$guide") "$@"

delta() { echo "--arm $1:mentor.selection=confidence,mentor.metric=delta,mentor.e_infeas=$2,$guide"; }
# shellcheck disable=SC2046,SC2086
"$trestle" sweep point-umaze --out "$out/metric-large" --seeds 0..5 $common --set env.map=large --set mentor.demo="$mentor" \
    $(delta da '"auto"') $(delta d03 0.3) $(delta d1 1.0) "$@"
