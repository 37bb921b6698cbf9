#!/bin/sh
# Every decoder of bytes that others wrote, under libFuzzer, one after the other; on stable Rust, without a sanitizer: what is
# looked for are panics, overflows and broken promises. Fails at the first finding, which libFuzzer leaves in the corpus.
# usage: run.sh [seconds for each, 600] [decoder ...]
set -eu
cd "$(dirname "$0")"
seconds=${1:-600}
[ $# -gt 0 ] && shift
[ $# -gt 0 ] || set -- messages frames map config demonstration import replay manifest
target=${CARGO_TARGET_DIR:-../../target}/fuzz
coverage="-Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 -Cllvm-args=-sanitizer-coverage-inline-8bit-counters"
coverage="$coverage -Cllvm-args=-sanitizer-coverage-pc-table -Cllvm-args=-sanitizer-coverage-trace-compares"
# With a target named, the flags are not for build scripts and macros, which are run while building.
host=$(rustc -vV | sed -n 's/^host: //p')
RUSTFLAGS="--cfg fuzzing $coverage" cargo build --release --locked --target "$host" --target-dir "$target"
program=$target/$host/release/decoders
corpus=$target/corpus
TRESTLE_SEEDS=$corpus "$program"
for decoder; do
    mkdir -p "$corpus/$decoder"
    echo "$decoder"
    TRESTLE_DECODER=$decoder "$program" -max_total_time="$seconds" -max_len=4096 -timeout=10 -rss_limit_mb=2048 \
        -artifact_prefix="$corpus/$decoder/finding-" -verbosity=0 -print_funcs=0 -print_final_stats=1 "$corpus/$decoder"
done
