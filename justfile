# What CI does, by the same script: `just` alone runs all of it.

# All sections of CI.
ci:
    .ci/run

# Installs what the other sections need, if it is missing.
tools:
    .ci/run tools

# libmujoco, for the Point Maze, from PyPI into third_party/mujoco.
mujoco:
    .ci/run mujoco

# The whole test suite.
test:
    .ci/run test

# A sweep on a real SLURM on this machine, which needs root; with `tests/slurm/run.sh --time-limit` by a real time limit.
slurm:
    .ci/run slurm

# Manifests for Kubernetes against its schemas.
kubernetes:
    .ci/run kubernetes

# Every decoder under libFuzzer, for a few seconds; `tests/fuzz/run.sh SECONDS` for longer.
fuzz:
    .ci/run fuzz

# Whether everything is formatted (`cargo fmt --all` formats).
fmt:
    .ci/run fmt

# clippy, warnings denied.
lint:
    .ci/run lint

# The documentation of all crates, warnings denied.
doc:
    .ci/run doc

# Licences, duplicate versions and sources of the dependencies.
deny:
    .ci/run deny

# Whether the instructions that a gradient step and a tick take have grown; `benches/instructions.sh --record` records.
instructions:
    .ci/run instructions

# Known vulnerabilities; needs the network for the advisory database, so CI leaves it out.
advisories:
    cargo deny --workspace check advisories

# A first run.
demo:
    cargo run --release -- train maze-small --algo ha-diiqn --seed 7

# The properties of the algorithm against naive scans and Algorithm 1, many cases each; for a night, not for every change.
properties cases="10000":
    PROPTEST_CASES={{cases}} cargo test -p trestle-algorithm --lib
