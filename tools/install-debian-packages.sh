#!/bin/sh
# Installs the packages of a list (one a line, # starts a comment) that this Debian lacks; silent when none is.
# usage: install-debian-packages.sh requirements-debian.txt
set -eu

fail() {
    echo "gr-radalt set-up: $*" >&2
    exit 2
}

wanted=$(sed 's/#.*//' "$1")
if ! command -v dpkg-query >/dev/null; then
    # Not Debian: GNU Radio may still be there, which the next step of the set-up checks.
    echo "gr-radalt set-up: no dpkg here, so the packages of $1 are taken for granted" >&2
    exit 0
fi

missing=
for package in $wanted; do
    status=$(dpkg-query -W -f '${db:Status-Status}' "$package" 2>/dev/null || true)
    [ "$status" = installed ] || missing="$missing $package"
done
[ -n "$missing" ] || exit 0

as_root=
if [ "$(id -u)" -ne 0 ]; then
    command -v sudo >/dev/null ||
        fail "not root and no sudo; ask an administrator for: apt-get install --no-install-recommends$missing"
    as_root=sudo
    [ -t 0 ] || as_root="sudo -n" # nobody there to type a password
    $as_root true || fail "sudo was refused; ask an administrator for: apt-get install --no-install-recommends$missing"
fi

apt() {
    # Waits for another apt to finish (a fresh machine often updates itself) instead of failing at its lock.
    $as_root env DEBIAN_FRONTEND=noninteractive apt-get -q -y -o DPkg::Lock::Timeout=600 "$@" </dev/null
}

echo "gr-radalt set-up: installing$missing"
# The lists are fetched only where the packages cannot be found in those at hand, or what they name is gone.
# shellcheck disable=SC2086
if ! { apt -s install --no-install-recommends $missing >/dev/null 2>&1 &&
    apt install --no-install-recommends $missing; }; then
    apt update
    apt install --no-install-recommends $missing || fail "apt-get could not install:$missing"
fi
