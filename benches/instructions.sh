#!/usr/bin/env bash
# Instructions that a gradient step, a batch's way through the mentor-server and the replay, and a whole tick take:
# repeatable where time is not.
#
#   benches/instructions.sh            compares with benches/instructions.json; fails if one has grown by more than 5 %
#   benches/instructions.sh --record   writes that file anew
#
# Counts depend on the compiler: with another one than on record they are shown, and nothing fails. They do not depend
# on the processor, which valgrind makes up, as long as it has AVX2 (valgrind knows no AVX-512). The program is the one
# that `cargo test` builds, optimised, so that nothing needs to be compiled twice. One unit of work is the difference
# between two runs of different length, so that starting up does not count. Needs valgrind; installs nothing.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

readonly RECORD=benches/instructions.json
readonly GROWTH_PERCENT=5

case "$*" in
    "" | --record) ;;
    *)
        printf 'arguments `%s`; accepted: none, or --record\n' "$*" >&2
        exit 2
        ;;
esac
if ! command -v valgrind >/dev/null; then
    printf 'valgrind is not installed; it counts the instructions\n' >&2
    exit 1
fi

if ! grep -qw avx2 /proc/cpuinfo; then
    printf 'this machine has no AVX2: nothing is counted\n' >&2
    exit
fi

# As CI builds it: incremental compilation divides the code, and so inlines it, differently.
CARGO_INCREMENTAL=0 cargo test --workspace --no-run --quiet
readonly PROGRAM="${CARGO_TARGET_DIR:-target}/debug/examples/instructions"

# Instructions of `PROGRAM $1 $2`.
total() {
    local log
    if ! log=$(valgrind --tool=callgrind --callgrind-out-file=/dev/null "$PROGRAM" "$1" "$2" 2>&1); then
        printf '%s\n' "$log" >&2
        exit 1
    fi
    sed -n 's/.*Collected : \([0-9]*\).*/\1/p' <<<"$log"
}

# Instructions of one unit of `$1`, from runs of `$2` and `$3` units.
each() {
    local less more
    less=$(total "$1" "$2")
    more=$(total "$1" "$3")
    printf '%d' $(((more - less) / ($3 - $2)))
}

step=$(each step 10 20)
mentor=$(each mentor 100 200)
# The first tick is the warm-up and takes no gradient step.
tick=$(each tick 4 8)

if [[ "${1:-}" == --record ]]; then
    printf '{\n  "rustc": "%s",\n  "step": %d,\n  "mentor": %d,\n  "tick": %d\n}\n' \
        "$(rustc --version)" "$step" "$mentor" "$tick" >"$RECORD"
    cat "$RECORD"
    exit
fi

recorded_with=$(sed -n 's/.*"rustc": "\(.*\)".*/\1/p' "$RECORD")
status=0
for name in step mentor tick; do
    recorded=$(sed -n "s/.*\"$name\": \([0-9]*\).*/\1/p" "$RECORD")
    found=${!name}
    verdict=ok
    if ((found * 100 > recorded * (100 + GROWTH_PERCENT))); then
        verdict="grown by more than $GROWTH_PERCENT %"
        status=1
    fi
    printf '%-6s  %9d instructions, recorded %9d (%+d per thousand): %s\n' "$name" "$found" "$recorded" \
        $(((found - recorded) * 1000 / recorded)) "$verdict"
done
if [[ "$(rustc --version)" != "$recorded_with" ]]; then
    printf 'recorded with another compiler, %s: nothing fails; benches/instructions.sh --record\n' "$recorded_with"
    status=0
elif ((status != 0)); then
    printf 'if the growth is worth it: benches/instructions.sh --record\n' >&2
fi
exit "$status"
