#!/bin/sh
# The compiler, for members of the workspace: with the counters by which libFuzzer sees what code an input reaches.
# usage: rustc.sh rustc argument ... (RUSTC_WORKSPACE_WRAPPER)
exec "$@" --cfg fuzzing -Copt-level=1 -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
    -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
    -Cllvm-args=-sanitizer-coverage-trace-compares
