#!/bin/sh
# Checks for what Escarp needs beside Rust and a C compiler, and installs what is missing where
# it may: Debian and its kin, as root or with a sudo that asks for no password.
#
# usage: scripts/setup.sh [--window]      --window: also the libraries that open a window
#
# Exit codes: 0 all is there; 1 nothing can be built; 3 it can be built, but something that is
# needed to draw is missing.
set -eu
cd "$(dirname "$0")/.."

window=no
case "${1-}" in
    '') ;;
    --window) window=yes ;;
    *) echo "usage: scripts/setup.sh [--window]" >&2; exit 2 ;;
esac

say() { echo "setup: $*" >&2; }
fail() { say "$*"; exit 1; }

# --- Rust and a C compiler -------------------------------------------------------------------

needed=$(sed -n 's/^rust-version *= *"\([0-9.]*\)".*/\1/p' Cargo.toml | head -n 1)
get_rust="get it from https://rustup.rs, or by 'rustup update'"
command -v cargo >/dev/null 2>&1 || fail "cargo is missing: Rust $needed or later is needed; $get_rust"
found=$(rustc --version 2>/dev/null | sed -n 's/^rustc \([0-9]*\.[0-9]*\).*/\1/p')
[ -n "$found" ] || fail "rustc does not run: Rust $needed or later is needed; $get_rust"
needed_minor=${needed#*.}
if [ "${found%%.*}" -lt "${needed%%.*}" ] ||
    { [ "${found%%.*}" -eq "${needed%%.*}" ] && [ "${found#*.}" -lt "${needed_minor%%.*}" ]; }; then
    fail "Rust $found is too old: $needed or later is needed; $get_rust"
fi
command -v "${CC:-cc}" >/dev/null 2>&1 ||
    fail "a C compiler is missing (${CC:-cc}); Debian: apt-get install gcc libc6-dev"

# What the system brings elsewhere: Metal on macOS, Direct3D on Windows.
[ "$(uname -s)" = Linux ] || exit 0

# --- What is there? --------------------------------------------------------------------------

# have_lib SONAME
have_lib() {
    PATH="$PATH:/sbin:/usr/sbin" ldconfig -p 2>/dev/null | grep -qF "$1 " && return 0
    machine=$(uname -m)
    IFS_before=$IFS
    IFS=:
    for folder in ${LD_LIBRARY_PATH-} /lib /lib64 /usr/lib /usr/lib64 /usr/local/lib \
        "/lib/$machine-linux-gnu" "/usr/lib/$machine-linux-gnu"; do
        if [ -n "$folder" ] && [ -e "$folder/$1" ]; then
            IFS=$IFS_before
            return 0
        fi
    done
    IFS=$IFS_before
    return 1
}

# Files that name Vulkan drivers, one a line, in the places where the loader looks.
drivers() {
    chosen=${VK_DRIVER_FILES:-${VK_ICD_FILENAMES-}}
    if [ -n "$chosen" ]; then
        places=$chosen
    else
        places=${VK_ADD_DRIVER_FILES-}
        for base in "${XDG_CONFIG_HOME:-${HOME-}/.config}" "${XDG_CONFIG_DIRS:-/etc/xdg}" \
            /usr/local/etc /etc "${XDG_DATA_HOME:-${HOME-}/.local/share}" \
            "${XDG_DATA_DIRS:-/usr/local/share:/usr/share}"; do
            places="$places:$(echo "$base" | sed 's|/*:|/vulkan/icd.d:|g; s|/*$|/vulkan/icd.d|')"
        done
    fi
    echo "$places" | tr : '\n' | while read -r place; do
        if [ -f "$place" ]; then
            echo "$place"
        elif [ -d "$place" ]; then
            find "$place" -name '*.json' 2>/dev/null || true
        fi
    done
}

# A driver counts if it draws in software, or if there is a device that it could be for.
have_driver() {
    have_lib libvulkan.so.1 || return 1
    all=$(drivers)
    [ -n "$all" ] || return 1
    echo "$all" | grep -q -e lvp_ -e lavapipe -e swiftshader && return 0
    for device in /dev/dri/renderD* /dev/nvidia[0-9]* /dev/dxg; do
        [ -e "$device" ] && return 0
    done
    return 1
}

# Each line: soname, package of Debian, of Fedora, of Arch.
window_libraries='libxkbcommon-x11.so.0 libxkbcommon-x11-0 libxkbcommon-x11 libxkbcommon-x11
libxkbcommon.so.0 libxkbcommon0 libxkbcommon libxkbcommon
libX11.so.6 libx11-6 libX11 libx11
libX11-xcb.so.1 libx11-xcb1 libX11-xcb libx11
libXcursor.so.1 libxcursor1 libXcursor libxcursor
libXi.so.6 libxi6 libXi libxi
libxcb.so.1 libxcb1 libxcb libxcb
libxcb-xkb.so.1 libxcb-xkb1 libxcb libxcb
libwayland-client.so.0 libwayland-client0 libwayland-client wayland'

debian='' fedora='' arch=''
# missing DEBIAN FEDORA ARCH
missing() { debian="$debian $1" fedora="$fedora $2" arch="$arch $3"; }

check() {
    debian='' fedora='' arch=''
    have_lib libvulkan.so.1 || missing libvulkan1 vulkan-loader vulkan-icd-loader
    have_driver || missing mesa-vulkan-drivers mesa-vulkan-drivers vulkan-swrast
    [ "$window" = yes ] || return 0
    while read -r soname on_debian on_fedora on_arch; do
        have_lib "$soname" || missing "$on_debian" "$on_fedora" "$on_arch"
    done <<LIST
$window_libraries
LIST
}

check
if [ -z "$debian" ]; then exit 0; fi

# --- Install, or say how ---------------------------------------------------------------------

as_root=none
if [ "$(id -u)" -eq 0 ]; then
    as_root=''
elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
    as_root='sudo -n'
fi

# install PACKAGE...
install() {
    log=$(mktemp)
    # shellcheck disable=SC2086 # empty, or two words
    if { $as_root env DEBIAN_FRONTEND=noninteractive apt-get update &&
        $as_root env DEBIAN_FRONTEND=noninteractive apt-get install --yes \
            --no-install-recommends -o DPkg::Lock::Timeout=120 "$@"; } >"$log" 2>&1 </dev/null; then
        rm -f "$log"
    else
        say "apt-get failed:"
        tail -n 20 "$log" >&2
        rm -f "$log"
        return 1
    fi
}

case "$debian" in
    *mesa-vulkan-drivers*) say "no Vulkan driver that can work here was found; Mesa's draws in software, too" ;;
esac
if command -v apt-get >/dev/null 2>&1 && [ "$as_root" != none ]; then
    say "installing$debian"
    # shellcheck disable=SC2086 # words
    if install $debian; then
        check
        if [ -z "$debian" ]; then
            say "installed"
            exit 0
        fi
        say "still missing after that:$debian"
    fi
elif command -v apt-get >/dev/null 2>&1; then
    say "missing, and this user may not install them:$debian"
fi
words() { echo "$*" | tr ' ' '\n' | awk 'NF && !seen[$0]++' | tr '\n' ' ' | sed 's/ $//'; }
if command -v dnf >/dev/null 2>&1; then
    say "missing; install them by: sudo dnf install $(words "$fedora")"
elif command -v pacman >/dev/null 2>&1; then
    say "missing; install them by: sudo pacman -S $(words "$arch")"
elif command -v apt-get >/dev/null 2>&1; then
    say "install them by: sudo apt-get install --no-install-recommends $(words "$debian")"
else
    say "missing; Debian's names of the packages are: $(words "$debian")"
fi
exit 3
