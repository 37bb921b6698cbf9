#!/bin/bash
# Plays schedules of the simulation, one after the other on each processor, and stops at the first failure:
#
#     tests/simulation/run.sh [COUNT [SEED]]      COUNT schedules (1000) from SEED (1) on
#
# After each 5000 it says how far it is; with the next seed it goes on from there. A failure is shown with its seed, its schedule
# and all that happened. With COUNT = 1 that is also shown of a schedule that ends well.
set -eu
cd "$(dirname "$0")/../.."
export TRESTLE_SCHEDULES=${1:-1000} TRESTLE_SEED=${2:-1}
exec cargo test --workspace --lib simulation::whatever -- --nocapture
