#!/usr/bin/env bash
# rustfmt and clippy over the whole workspace, and cargo-deny where it is installed.
set -eu
cd "$(dirname "$0")/.."

# component PACKAGE COMMAND...: makes sure that a part of the toolchain is there.
component() {
    local package=$1
    shift
    "$@" >/dev/null 2>&1 && return 0
    if command -v rustup >/dev/null 2>&1; then
        echo "lint: installing $package" >&2
        rustup component add "$package" && return 0
    fi
    echo "lint: $package is missing; with rustup: rustup component add $package" >&2
    return 1
}

component rustfmt cargo fmt --version
component clippy cargo clippy --version

echo 'lint: cargo fmt --check'
cargo fmt --all --check
echo 'lint: cargo clippy'
cargo clippy --release --workspace --all-targets --locked -- -D warnings
if command -v cargo-deny >/dev/null 2>&1; then
    echo 'lint: cargo deny'
    cargo deny check licenses bans sources
else
    echo 'lint: cargo-deny is not installed; licences, bans and sources were not checked'
fi
