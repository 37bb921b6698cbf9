#!/bin/sh
# Every decoder of bytes that others wrote, under libFuzzer, one after the other; on stable Rust, without a sanitizer: what is
# looked for are panics, overflows and broken promises. Begins from sound inputs and all that earlier runs have found
# worth keeping, and says how many inputs there were and how many features (edges by how often they were taken, and comparisons)
# they reached. Fails at the first finding, which libFuzzer leaves in the corpus, or if it does not see what the code does. Needs
# a C++ compiler.
# usage: run.sh [seconds for each, 600] [decoder ...]
set -eu
cd "$(dirname "$0")/../.."
seconds=${1:-600}
[ $# -gt 0 ] && shift
target=${CARGO_TARGET_DIR:-target}
# Members alone are compiled anew, with counters: all else is as `cargo test --workspace` has compiled it.
RUSTC_WORKSPACE_WRAPPER=$PWD/tests/fuzz/rustc.sh CARGO_INCREMENTAL=0 \
    cargo build --locked --workspace --example decoders --features trestle-fuzz/libfuzzer
program=$target/debug/examples/decoders
corpus=$target/fuzz/corpus
logs=$target/fuzz/logs
mkdir -p "$logs"
all=$(TRESTLE_SEEDS=$corpus "$program")
[ $# -gt 0 ] || set -- $all
for decoder; do
    mkdir -p "$corpus/$decoder"
    log=$logs/$decoder
    if ! TRESTLE_DECODER=$decoder "$program" -max_total_time="$seconds" -max_len=4096 -timeout=10 -rss_limit_mb=2048 \
        -artifact_prefix="$corpus/$decoder/finding-" -print_funcs=0 "$corpus/$decoder" >"$log" 2>&1; then
        tail -n 100 "$log" >&2
        echo "$decoder: a finding, see above and $log" >&2
        exit 1
    fi
    # Of the last line that has them: how many inputs, and the features that they reached.
    reached=$(grep 'DONE ' "$log" | sed -n 's/^#\([0-9]*\).* ft: \([0-9]*\).*/\1 inputs, \2 features/p')
    if [ -z "$reached" ]; then
        echo "$decoder: libFuzzer does not see what the code does, see $log" >&2
        exit 1
    fi
    echo "$decoder: $reached"
done
