#!/bin/bash
# Runs the cases of a folder on the built program, and says of each whether it ends as it should:
#
#     tests/cases/run.sh [FOLDER]        FOLDER: this one, unless another is named
#
# TRESTLE names the program; without it, it is what `cargo build --release` or `cargo test` has built last. A case is a
# folder. Its `cmd` is run there, with TRESTLE, and with W naming an empty folder. `expected.txt` says in words what it
# should do. `check` says it in lines, each of which must hold for what `cmd` prints on either stream:
#
#     has TEXT         some line contains TEXT
#     is TEXT          some line is TEXT
#     not TEXT         no line contains TEXT
#     matches REGEX    some line matches the extended regular expression
#     also LINE        a line that does not hold for cases of another folder (see below)
#     needs COMMAND    where COMMAND fails, this machine cannot run the case, and it is left out
#
# A case of another folder without `check` has that of the case here that has its name, but for a number before it. Where there is
# none, the reader judges: the output is printed beside what is expected. Whatever a case expects, it must
# end within two minutes, without a panic.
set -u
shopt -s extglob
here=$(cd "$(dirname "$0")" && pwd)
folder=$(cd "${1:-$here}" && pwd) || exit 2
if [ -z "${TRESTLE:-}" ]; then
    TRESTLE=$(ls -t "$here"/../../target/{release,debug}/trestle 2>/dev/null | head -n 1)
fi
TRESTLE=$(realpath -e "${TRESTLE:-none}") || { echo "no program: TRESTLE is not set, and none is built" >&2; exit 2; }
export TRESTLE

# Prints the lines of `check` that do not hold for the output in file $1.
broken() {
    local how text
    while read -r how text; do
        if [ "$how" = also ]; then
            [ "$check" = check ] || continue
            read -r how text <<<"$text"
        fi
        case $how in
        has) grep -qF -e "$text" "$1" ;;
        is) grep -qxF -e "$text" "$1" ;;
        not) ! grep -qF -e "$text" "$1" ;;
        matches) grep -qE -e "$text" "$1" ;;
        needs | '') ;;
        *) false ;;
        esac || echo "$how $text"
    done <"$check"
}

failed=0 judged=0 left_out=0 to_read=0
for cmd in "$folder"/*/cmd; do
    [ -e "$cmd" ] || { echo "$folder holds no cases; accepted: folders with a file cmd" >&2; exit 2; }
    case=$(dirname "$cmd") name=$(basename "$(dirname "$cmd")")
    cd "$case" || exit 2
    check=check
    [ -f $check ] || check=$here/${name##*([0-9])-}/check
    if [ -f "$check" ] && needs=$(sed -n 's/^needs //p' "$check") && [ -n "$needs" ] && ! bash -c "$needs" >/dev/null 2>&1; then
        echo "left out  $name: this machine cannot $needs"
        left_out=$((left_out + 1))
        continue
    fi
    W=$(mktemp -d) out=$(mktemp)
    export W
    timeout --kill-after=10 120 ./cmd >"$out" 2>&1 </dev/null
    status=$? wrong=
    [ $status -lt 124 ] || wrong="it ended with status $status, 124 standing for two minutes"
    ! grep -qF 'panicked at' "$out" || wrong="it panicked"
    [ -z "$wrong" ] && [ -f "$check" ] && wrong=$(broken "$out")
    if [ -n "$wrong" ]; then
        echo "FAILED    $name"
        sed 's/^/    does not hold: /' <<<"$wrong"
        sed 's/^/    expected: /' expected.txt
        head -c 20000 "$out" | sed 's/^/    | /'
        failed=$((failed + 1))
    elif [ -f "$check" ]; then
        echo "ok        $name"
        judged=$((judged + 1))
    else
        echo "to read   $name"
        sed 's/^/    expected: /' expected.txt
        head -c 20000 "$out" | sed 's/^/    | /'
        to_read=$((to_read + 1))
    fi
    rm -rf "$W" "$out"
done
echo "$judged as expected, $failed failed, $left_out left out, $to_read to be read"
[ $failed -eq 0 ]
