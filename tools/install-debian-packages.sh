#!/bin/sh
# Installs the packages of a list (one a line, # starts a comment) that this Debian lacks; silent when none is.
# `a | b` on one line: the first of them that the distribution has, since names differ between releases.
# usage: install-debian-packages.sh requirements-debian.txt
set -eu

say() { echo "gr-radalt set-up: $*" >&2; }

fail() {
    say "$*"
    exit 2
}

case ${1:-} in -h | --help) sed -n '/^[^#]/q; 2,$s/^# *//p' "$0"; exit 0 ;; esac
[ $# -eq 1 ] || fail "which list? usage: install-debian-packages.sh requirements-debian.txt"
lines=$(sed -e 's/#.*//' -e 's/[[:space:]]//g' -e '/^$/d' "$1") # `a|b`, no blank in it
if ! command -v dpkg-query >/dev/null; then
    # Not Debian: GNU Radio may still be there, which the next step of the set-up checks.
    say "no dpkg here, so the packages of $1 are taken for granted"
    exit 0
fi

# What each line asks for on this distribution: `missing` has what it lacks, `unknown` what it has no package of.
look_up() {
    missing='' unknown=''
    for line in $lines; do
        found=
        for package in $(echo "$line" | tr '|' ' '); do
            status=$(dpkg-query -W -f '${db:Status-Status}' "$package" 2>/dev/null || true)
            if [ "$status" = installed ]; then
                found=yes
            elif apt-cache policy "$package" 2>/dev/null | grep -q '^ *Candidate: [^(]'; then
                found=yes
                missing="$missing $package"
            fi
            [ -z "$found" ] || break
        done
        [ -n "$found" ] || unknown="$unknown $line"
    done
}

look_up
[ -n "$missing$unknown" ] || exit 0

as_root=
if [ "$(id -u)" -ne 0 ]; then
    asked_for="apt-get install --no-install-recommends$missing$unknown"
    command -v sudo >/dev/null || fail "not root and no sudo; ask an administrator for: $asked_for"
    as_root=sudo
    [ -t 0 ] || as_root="sudo -n" # nobody there to type a password
    $as_root true || fail "sudo was refused; ask an administrator for: $asked_for"
fi

apt() {
    # Waits for another apt to finish (a fresh machine often updates itself) instead of failing at its lock.
    $as_root env DEBIAN_FRONTEND=noninteractive apt-get -q -y -o DPkg::Lock::Timeout=600 "$@" </dev/null
}

# The lists are fetched only where packages cannot be found in those at hand, or what these name is gone.
if [ -n "$unknown" ]; then
    apt update
    look_up
fi
[ -z "$unknown" ] || say "this distribution has no package$unknown; going on without"
[ -n "$missing" ] || exit 0
say "installing$missing"
# shellcheck disable=SC2086
if ! { apt -s install --no-install-recommends $missing >/dev/null 2>&1 &&
    apt install --no-install-recommends $missing; }; then
    apt update
    apt install --no-install-recommends $missing || fail "apt-get could not install:$missing"
fi
