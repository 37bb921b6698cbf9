#!/usr/bin/env bash
# Checks the manifests of this directory, and some that the program makes, against the published schemas of Kubernetes.
#
#   deploy/kubernetes/check.sh [PROGRAM]       PROGRAM: target/debug/trestle unless given
#
# What Python needs goes into target/kubernetes.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
cd "$here/../.."
program=$(realpath "${1:-target/debug/trestle}")
work=target/kubernetes
mkdir -p "$work"
if [[ ! -x $work/venv/bin/kubernetes-validate ]]; then
    python3 -m venv "$work/venv"
    "$work/venv/bin/pip" install --quiet kubernetes-validate
fi
"$program" config show maze-small > "$work/config.toml"
"$program" sweep "$work/config.toml" --arm 'odd: name:learner.lr=1e-3' --seeds 0..3 --out "$work/odd" --submit kubernetes --dry-run \
    --kubernetes 'namespace=x' >/dev/null 2>&1 && { echo 'an arm with such a name was taken' >&2; exit 1; }
"$program" sweep "$work/config.toml" --arm 'odd:learner.hidden=[8,8],env.map="random:1:9x9"' --seeds 0..3 --out "$work/Odd name" \
    --submit kubernetes --dry-run --kubernetes 'namespace=x,cpus=2,memory=4Gi,shm=1Gi' > "$work/made.yaml"
# A JobSet is none of Kubernetes's own kinds, but the jobs in it are.
"$work/venv/bin/python" "$here/jobset.py" "$here/hosts.yaml" "$work/hosts-jobs.yaml"
for version in 1.31 1.33; do
    "$work/venv/bin/kubernetes-validate" --strict -k "$version" "$here"/{sweep,claim}.yaml "$work"/{made,hosts-jobs}.yaml
done
