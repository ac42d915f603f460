#!/usr/bin/env bash
# Everything that must pass: set-up, all tests and the examples in the docs; with CI set, lints too.
# All is built in the release profile, as for the demo, so that nothing is built twice.
set -eu
cd "$(dirname "$0")/.."

status=0
scripts/setup.sh || status=$?
case $status in
    0) ;;
    3) echo 'test: going on; the tests that draw will fail' >&2 ;;
    *) exit "$status" ;;
esac
# Lints come and go with the toolchain: they are for whoever changes the code.
if [ -n "${CI-}" ]; then
    scripts/lint.sh
else
    echo 'test: without lints; make lint has them'
fi
if command -v cargo-nextest >/dev/null 2>&1; then
    echo 'test: cargo nextest, then the examples in the docs'
    cargo nextest run --release --workspace --locked
    cargo test --release --workspace --locked --doc
else
    echo 'test: cargo test'
    cargo test --release --workspace --locked
fi
echo 'test: all passed'
