#!/bin/sh
# Builds the package (`make deb`), installs it into a bare Debian, runs a flowgraph there, with the network among the
# methods, in GNU Radio's own Python, and removes it; ends with 1 where a step failed or a file is left.
# usage: test-deb.sh [SUITE]        SUITE: bookworm (default) or that of the Debian that this runs on
# In the environment: DEB, a package that is built already; BARE, folder of the bare system, kept and used again; MIRROR
# of Debian. Needs root.
set -eu
case ${1:-} in -h | --help) sed -n '/^[^#]/q; 2,$s/^# *//p' "$0"; exit 0 ;; esac
suite=${1:-bookworm}

if [ "${TEST_DEB_INSIDE:-}" != yes ]; then
    [ "$(id -u)" -eq 0 ] || { echo "test-deb: making a system needs root" >&2; exit 2; }
    tree=$(cd "$(dirname "$0")/.." && pwd)
    DEB=${DEB:-$(/usr/bin/python3 "$tree/packaging/make_deb.py" "$tree/build" | tail -n 1)}
    bare=${BARE:-$(mktemp -d "${TMPDIR:-/var/tmp}/test-deb.XXXXXX")}
    status=0
    export DEB
    TEST_DEB_INSIDE=yes bare=$bare unshare --mount --pid --fork --kill-child --propagation private "$0" "$suite" || status=$?
    [ -n "${BARE:-}" ] || rm -rf --one-file-system "$bare"
    exit "$status"
fi

if [ ! -e "$bare/etc/debian_version" ]; then
    command -v debootstrap >/dev/null || apt-get -q -y install --no-install-recommends debootstrap </dev/null ||
        { echo "test-deb: no debootstrap here, and apt-get could not install it" >&2; exit 2; }
    debootstrap --variant=minbase --include=ca-certificates "$suite" "$bare" "${MIRROR:-http://deb.debian.org/debian}"
    apt-config dump | grep -E '^Acquire::(https?|Check|Retries)' >"$bare/etc/apt/apt.conf.d/90host" || true
    cp /usr/local/share/ca-certificates/*.crt "$bare/usr/local/share/ca-certificates/" 2>/dev/null &&
        chroot "$bare" update-ca-certificates || true
fi
cp -L /etc/resolv.conf "$bare/etc/resolv.conf"
printf '#!/bin/sh\nexit 101\n' >"$bare/usr/sbin/policy-rc.d"
chmod 755 "$bare/usr/sbin/policy-rc.d"
mount --rbind /dev "$bare/dev"
mount -t proc proc "$bare/proc"
mount -t tmpfs tmpfs "$bare/tmp"
mount -t tmpfs tmpfs "$bare/run"
inside() { chroot "$bare" /usr/bin/env HOME=/root LC_ALL=C.UTF-8 TERM=dumb DEBIAN_FRONTEND=noninteractive "$@"; }
apt() { inside apt-get -q -y -o DPkg::Lock::Timeout=600 "$@" </dev/null; }
files() { # everything of the module, wherever it lies
    (cd "$bare" && find usr etc var/lib/gr-radalt \( -path '*radalt*' -o -path '*gr-radalt*' \) 2>/dev/null || true)
}

cp "$DEB" "$bare/srv/gr-radalt.deb"
apt update
apt install --reinstall --no-install-recommends /srv/gr-radalt.deb bash-completion man-db
inside radalt --version
inside sh -c 'cd /srv && radalt eval --sim --overlap 0.5 --altitudes 100 --frames 5 --methods none,whitening,tcae --out /srv/run'
test -s "$bare/srv/run/report.md"
inside sh -c 'cd /srv && grcc -o /srv /usr/share/gr-radalt/flowgraphs/ota_sim.grc && test -s /srv/ota_sim.py'
inside bash -c '. /usr/share/bash-completion/bash_completion; . /usr/share/bash-completion/completions/radalt
    COMP_WORDS=(radalt eval --sce) COMP_CWORD=2; _radalt; test "${COMPREPLY[*]}" = --scene
    COMP_WORDS=(radalt eval --scene nr1) COMP_CWORD=3; _radalt; test "${COMPREPLY[*]}" = nr10'
apt purge gr-radalt
left=$(files | grep -v '^var/lib/dpkg' || true)
[ -z "$left" ] || { echo "test-deb: left behind:"; echo "$left"; exit 1; }
echo "test-deb: installed, run and removed on Debian $(cat "$bare/etc/debian_version"); nothing is left"
