#!/usr/bin/env bash
# From nothing to a terrain on the screen: builds the programs, makes or takes a DEM, makes a
# dataset of it, serves it, and opens the viewer; without a display it writes pictures and a
# summary. Everything it makes lies in demo/. Called by 'make demo', which says how to steer it.
set -euo pipefail
repo=$(cd "$(dirname "$0")/.." && pwd)

# By the environment, since make passes them so.
dem=${DEM-} name=${NAME-} port=${PORT:-0} build_options=${ARGS-} headless=${HEADLESS-}
server_pid='' running_pid='' private=''

# The trap may speak while a command's output goes to a file.
exec 3>&1
say() { echo "demo: $*" >&3; }
fail() {
    echo "demo: $*" >&2
    exit 1
}

# shellcheck disable=SC2329 # called by the trap
clean_up() {
    local status=$?
    trap - EXIT INT TERM HUP
    [ -z "$running_pid" ] || kill "$running_pid" 2>/dev/null || true
    if [ -n "$server_pid" ] && kill "$server_pid" 2>/dev/null; then
        wait "$server_pid" 2>/dev/null || true
        say 'server stopped'
    fi
    [ -z "$private" ] || rm -rf "$private"
    exit "$status"
}
trap clean_up EXIT
trap 'exit 130' INT
trap 'exit 143' TERM
trap 'exit 129' HUP

# run COMMAND...: so that a signal ends it at once; bash would wait for a command in the foreground.
run() {
    local status=0
    "$@" &
    running_pid=$!
    wait "$running_pid" || status=$?
    running_pid=''
    return "$status"
}

# --- What is asked for? ----------------------------------------------------------------------

# split WORDS: into the array `words`, as a shell does it with quotes, but running nothing.
split() {
    local lines line
    words=()
    [ -n "${1//[[:space:]]/}" ] || return 0
    lines=$(printf '%s\n' "$1" | xargs printf '%s\n') || fail "a quote is not closed in: $1"
    while IFS= read -r line; do words+=("$line"); done <<<"$lines"
}

# take FILE: adds an input, by its absolute path.
take() {
    [ -e "$1" ] || fail "DEM: there is no file $1"
    [ ! -d "$1" ] || fail "DEM: $1 is a folder; name files, as DEM='$1/*.tif'"
    [ -r "$1" ] || fail "DEM: $1 cannot be read"
    inputs+=("$(cd "$(dirname "$1")" && pwd)/$(basename "$1")")
}

inputs=()
if [ -n "$dem" ] && [ -e "$dem" ]; then
    take "$dem"
else
    split "$dem"
    for word in ${words[@]+"${words[@]}"}; do
        word=${word/#\~\//$HOME/}
        if [ ! -e "$word" ] && matches=$(compgen -G "$word"); then
            while IFS= read -r match; do take "$match"; done < <(sort <<<"$matches")
        else
            take "$word"
        fi
    done
fi
split "$build_options"
options=(${words[@]+"${words[@]}"})
if [ -z "$name" ]; then
    name=demo
    if [ ${#inputs[@]} -gt 0 ]; then
        name=$(basename "${inputs[0]}")
        name=$(printf %s "${name%%.*}" | LC_ALL=C tr -c 'A-Za-z0-9_-' -)
    fi
fi
case $name in
    '' | -* | .* | *[!A-Za-z0-9._-]*) fail "NAME=$name: letters, digits, '.', '_' and '-' make a name" ;;
esac
case $port in
    *[!0-9]*) fail "PORT=$port is no number" ;;
esac
cd "$repo"

# --- Set-up and programs ---------------------------------------------------------------------

display=no
if [ -z "$headless" ] && { [ -n "${DISPLAY-}" ] || [ -n "${WAYLAND_DISPLAY-}" ] || [ "$(uname -s)" = Darwin ]; }; then
    display=yes
fi
status=0
if [ $display = yes ]; then scripts/setup.sh --window || status=$?; else scripts/setup.sh || status=$?; fi
[ "$status" -ne 3 ] || fail 'nothing can be drawn without the packages that are named above'
[ "$status" -eq 0 ] || exit "$status"

say 'building the programs (the first time takes minutes)'
run cargo build --release --workspace --bins --locked
compiled=$SECONDS
target=$(cargo metadata --no-deps --format-version 1 --locked |
    sed -n 's/.*"target_directory":"\([^"]*\)".*/\1/p')
tiles=$target/release/escarp-tiles
server=$target/release/escarp-server
client=$target/release/escarp-client

# --- Dataset ---------------------------------------------------------------------------------

mkdir -p demo
if [ ${#inputs[@]} -eq 0 ]; then
    if [ ! -s demo/demo.tif ] || [ "$tiles" -nt demo/demo.tif ]; then
        say 'making a synthetic DEM: demo/demo.tif'
        run "$tiles" sample -o demo/part.tif --size 4097 --seed 42
        mv demo/part.tif demo/demo.tif
    fi
    inputs=("$repo/demo/demo.tif")
fi
dataset=demo/$name.escarp
stamp=demo/$name.inputs
# What the dataset is made of: the same words, files and program make the same dataset.
made_of() {
    printf 'option %s\n' ${options[@]+"${options[@]}"}
    ls -lniL "${inputs[@]}" "$tiles"
}
fresh=no
if [ -d "$dataset" ] && [ -f "$stamp" ] && [ "$(made_of)" = "$(cat "$stamp")" ]; then
    fresh=yes
    # `ls` shows old times by the day only.
    for input in "${inputs[@]}" "$tiles"; do
        if [ "$input" -nt "$stamp" ]; then fresh=no; fi
    done
fi
if [ $fresh = yes ]; then
    say "the dataset $dataset is there already, of the same input"
else
    say "building the dataset $dataset"
    rm -f "$stamp"
    begun=$SECONDS
    run "$tiles" build "${inputs[@]}" -o "$dataset" --overwrite ${options[@]+"${options[@]}"} ||
        fail "the dataset was not built; the reason stands above. 'escarp-tiles build --help' lists what ARGS can say"
    build_s=$((SECONDS - begun))
    made_of >"$stamp"
fi

# --- Server ----------------------------------------------------------------------------------

: >demo/server.url
NO_COLOR=1 "$server" "$dataset" --listen "127.0.0.1:$port" >demo/server.url 2>demo/server.log &
server_pid=$!
url=''
for ((tries = 0; tries < 300; tries++)); do
    url=$(sed -n 's/^\(http:[^ ]*\).*/\1/p' demo/server.url | head -n 1)
    [ -z "$url" ] || break
    if ! kill -0 "$server_pid" 2>/dev/null; then
        cat demo/server.log >&2
        server_pid=''
        fail 'the server did not start; its reason stands above'
    fi
    sleep 0.1
done
[ -n "$url" ] || fail 'the server does not say that it is ready; see demo/server.log'
say "serving $url"

# --- Window ----------------------------------------------------------------------------------

# Without it graphics libraries warn that it is not set.
if [ -z "${XDG_RUNTIME_DIR-}" ]; then
    private=$(mktemp -d)
    export XDG_RUNTIME_DIR=$private
fi
if [ $display = yes ]; then
    say 'opening the viewer; closing its window ends the demo'
    run "$client" view "$url" ||
        fail "the viewer failed; the reason stands above. 'make demo HEADLESS=1' writes pictures instead"
    exit 0
fi

# --- Or pictures -----------------------------------------------------------------------------

# Pictures of an earlier run would pass for those of this one.
pictures=demo/$name.pictures
rm -rf "$pictures"
mkdir -p "$pictures"
say "no window: writing pictures into $pictures/"
# snapshot FILE OPTION...: FILE takes what the client says.
snapshot() {
    local said=$1
    shift
    run "$client" snapshot "$url" "$@" >"$said" || fail 'no picture could be made; the reason stands above'
}
snapshot "$pictures/overview.txt" -o "$pictures/overview.png"
first_picture=$((SECONDS - compiled))
snapshot "$pictures/wireframe.txt" -o "$pictures/wireframe.png" --wireframe --error-px 4
say 'flying from the overview down and low across, in real time'
run "$client" fly "$url" -o "$pictures/flight" --every 60 >"$pictures/flight.jsonl" 2>"$pictures/flight.log" || {
    cat "$pictures/flight.log" >&2
    fail 'the flight failed; the reason stands above'
}

# A line of JSON a frame; the bound is null while nothing is known.
flight() {
    awk '
        function value(key,   at) {
            at = index($0, "\"" key "\":")
            return at ? substr($0, at + length(key) + 3) : "null"
        }
        {
            frames++
            t = value("triangles") + 0; if (t > triangles) triangles = t
            bytes = value("bytes") + 0; seconds = value("time_s") + 0
            b = value("bound_px")
            if (b !~ /^null/) { b += 0; known++; sum += b; if (b > worst) worst = b; last = b }
        }
        END {
            printf "%d frames in %.0f s, at most %d triangles, %.2f MB received\n", frames, seconds, triangles, bytes / 1e6
            if (known) printf "            error bound: mean %.2f px, worst %.2f px, at the end %.2f px (tolerance 2 px)\n", sum / known, worst, last
        }' "$1"
}
{
    echo "input       ${inputs[0]}$([ ${#inputs[@]} -eq 1 ] || echo " and $((${#inputs[@]} - 1)) more")"
    echo "dataset     $dataset, $(du -sk "$dataset" | awk '{ printf "%.1f MB", $1 * 1.024e-3 }'), $(
        [ $fresh = yes ] && echo 'from an earlier run' || echo "built in ${build_s} s")"
    echo "overview    $(cat "$pictures/overview.txt")"
    echo "wireframe   $(cat "$pictures/wireframe.txt")"
    echo "flight      $(flight "$pictures/flight.jsonl")"
    echo "pictures    $pictures/overview.png, wireframe.png, flight/frame-*.png ($(
        find "$pictures/flight" -name '*.png' | wc -l | tr -d ' '))"
    echo "times       first picture ${first_picture} s, all $((SECONDS - compiled)) s after compilation"
    echo "by hand     $server $dataset"
    echo "            $client view http://127.0.0.1:8787/$name"
} >"$pictures/summary.txt"
echo
cat "$pictures/summary.txt"
echo
