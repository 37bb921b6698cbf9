#!/usr/bin/env bash
# Builds the example, trains it until it is solved, goes on with the run, and evaluates it.
#
#   examples/own-environment/try.sh [TARGET]        TARGET: cargo's directory for what it builds
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
target=$(realpath -m "${1:-target}")
CARGO_TARGET_DIR=$target cargo build
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
program=$target/debug/own-environment
"$program" train cart-pole --algo dqn --out "$place/run" --quiet | tee "$place/solved"
grep -q '^  solved   episode' "$place/solved"
"$program" resume "$place/run" --env-steps 60000 --set run.stop_when_solved=false --quiet
figures=$("$program" eval "$place/run" --json)
printf '%s\n' "$figures"
[[ $figures == *'"episodes":10,'* ]]
