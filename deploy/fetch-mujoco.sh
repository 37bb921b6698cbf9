#!/usr/bin/env bash
# Fetches libmujoco from its wheel on PyPI into third_party/mujoco, where Trestle finds it: library, headers, licence.
#
#   deploy/fetch-mujoco.sh [VERSION]     4.0.0 by default; 2.3.7 and later
#
# Needs python3 with pip and the network. What was there before is replaced only when the new one is complete.
set -euo pipefail

readonly VERSION="${1:-4.0.0}"
if [[ ! "$VERSION" =~ ^[0-9]+\.[0-9]+\.[0-9]+$ ]]; then
    printf 'fetch-mujoco: version %s; accepted: three numbers, such as 4.0.0\n' "$VERSION" >&2
    exit 2
fi
cd "$(dirname "${BASH_SOURCE[0]}")/.."
# From 4.0 on the library is in a package of its own.
package=mujoco
if ((${VERSION%%.*} >= 4)); then
    package=mujoco-core
fi
mkdir -p third_party
work=$(mktemp -d third_party/.mujoco.XXXXXX)
trap 'rm -rf "$work"' EXIT
python3 -m pip --disable-pip-version-check download --quiet --no-deps --only-binary :all: --dest "$work" "$package==$VERSION"
python3 -m zipfile -e "$work"/*.whl "$work/wheel"
mkdir -p "$work/mujoco/lib"
cp "$work"/wheel/mujoco/libmujoco.so* "$work/mujoco/lib/"
cp -r "$work/wheel/mujoco/include" "$work/mujoco/"
find "$work/wheel" -ipath '*.dist-info/*' -iname '*licen*' -type f -exec cp {} "$work/mujoco/" \;
rm -rf third_party/mujoco
mv "$work/mujoco" third_party/mujoco
printf 'third_party/mujoco: MuJoCo %s; `trestle doctor` shows whether it is used\n' "$VERSION"
