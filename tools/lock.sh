#!/bin/sh
# Every package that the environments hold, those that others bring along too, with the SHA-256 of its files:
# requirements.lock (Python 3.10 and later) and requirements-test.lock (3.11 and later). Run it after a change of
# requirements.txt or requirements-test.txt; tests/test_setup.py compares them. Network.
set -eu
case ${1:-} in
    -h | --help)
        echo "usage: tools/lock.sh  # writes requirements.lock and requirements-test.lock anew (network)"
        exit 0
        ;;
esac
cd "$(dirname "$0")/.."
uv=$(mktemp -d)
trap 'rm -rf "$uv"' EXIT
python3 -m venv "$uv" && "$uv/bin/python" -m pip --disable-pip-version-check -q install uv
lock() {
    out=$1 python=$2
    shift 2
    "$uv/bin/uv" pip compile -q --universal --python-version "$python" --generate-hashes --no-emit-index-url --no-annotate \
        --custom-compile-command tools/lock.sh "$@" -o "$out"
}
lock requirements.lock 3.10 requirements.txt
lock requirements-test.lock 3.11 -c requirements.lock requirements.txt requirements-test.txt
