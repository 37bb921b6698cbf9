#!/usr/bin/env bash
# The live page in a real browser: every state that it can show, on desktop and phone, light and dark.
#
#   tests/page/run.sh [PROGRAM]        PROGRAM: target/debug/trestle unless given
#
# Needs Chromium (Debian's package) and Python; what Python needs goes into target/page. Screenshots go there as well.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
cd "$here/../.."
program=$(realpath "${1:-target/debug/trestle}")
work=target/page
mkdir -p "$work"
if [[ ! -x $work/venv/bin/python ]]; then
    python3 -m venv "$work/venv"
    "$work/venv/bin/pip" install --quiet --requirement "$here/requirements.txt"
fi
exec "$work/venv/bin/python" "$here/page.py" "$program" "$work/shots"
