#!/usr/bin/env bash
# Measures everything that docs/performance.md quotes, on this machine, and rewrites its tables.
#
#   benches/report.sh                 everything, the peers in Python included: some twenty minutes
#   benches/report.sh --no-peers      without the peers in Python; their tables stay as they are
#   benches/report.sh --tables-only   no measurement: the tables from what was measured last
#
# The peers' venv and JAX's are target/peers-venv and target/jax-venv, or what PEERS_VENV and JAX_VENV name; they are
# made if they are absent, which needs the network. What was measured stays in target/bench as JSON.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

readonly TARGET="${CARGO_TARGET_DIR:-$PWD/target}"
readonly OUT="$TARGET/bench"
readonly PEERS_VENV="${PEERS_VENV:-$TARGET/peers-venv}"
readonly JAX_VENV="${JAX_VENV:-$TARGET/jax-venv}"

peers=yes
measure=yes
case "$*" in
    "") ;;
    --no-peers) peers=no ;;
    --tables-only) measure=no ;;
    *)
        printf 'arguments `%s`; accepted: none, --no-peers or --tables-only\n' "$*" >&2
        exit 2
        ;;
esac

# A venv at `$1` with the packages of file `$2`.
venv() {
    if [[ ! -x "$1/bin/python" ]]; then
        python3 -m venv "$1"
        "$1/bin/pip" install --quiet -r "$2"
    fi
}

# The standard output of a command as $OUT/$1.json, complete or not at all.
keep() {
    local name=$1
    shift
    printf '+ %s\n' "$*" >&2
    "$@" >"$OUT/$name.json.new"
    mv "$OUT/$name.json.new" "$OUT/$name.json"
}

mkdir -p "$OUT"
if [[ $measure == yes ]]; then
    cargo build --release -p trestle -p trestle-bench
    for name in step threads infer replay mentor tick free message weights idle memory loop demonstration slopes; do
        keep "$name" "$TARGET/release/trestle-bench" "$name" --json
    done
    if [[ $peers == yes ]]; then
        venv "$PEERS_VENV" benches/peers/requirements-minatar.txt
        "$PEERS_VENV/bin/pip" install --quiet ./deploy/python
        venv "$JAX_VENV" benches/peers/requirements-jax.txt
        keep step_torch "$PEERS_VENV/bin/python" benches/peers/step_torch.py
        keep step_jax "$JAX_VENV/bin/python" benches/peers/step_jax.py
        keep sampling "$PEERS_VENV/bin/python" benches/peers/sampling.py
        keep minatar "$PEERS_VENV/bin/python" benches/peers/compare_minatar.py --peer "$PEERS_VENV/bin/python"
        keep maze30 benches/peers/compare_maze30.py --trestle "$TARGET/release/trestle" --venv "$PEERS_VENV"
    fi
fi
python3 benches/report.py "$OUT" docs/performance.md
