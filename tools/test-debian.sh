#!/bin/sh
# Makes a bare Debian with debootstrap, copies this source tree into it and runs `make test` and `make eval` there, as
# on a machine that has git and make and nothing else. Prints what each step took; ends with 1 where one failed.
# usage: test-debian.sh SUITE [TARGET...]        SUITE: bookworm, trixie, ...; TARGET of make: default test and eval
# In the environment:
#   ARGS    arguments that every target gets, as in `make test ARGS=...`
#   BARE    folder of the bare system, kept, and used again where it stands; default: a new one, removed at the end
#   MIRROR  of Debian; default http://deb.debian.org/debian
#   PYTHONDEVMODE, PYTHONWARNINGS  handed on
# Needs root, for debootstrap and chroot. Settings of apt's and pip's transfers, certificates and proxies are the host's.
# Mounts live in a name space of their own: whatever ends this script, none stays.
set -eu

say() { echo "test-debian: $*"; }

fail() {
    echo "test-debian: $*" >&2
    exit 2
}

case ${1:-} in -h | --help) sed -n '/^[^#]/q; 2,$s/^# *//p' "$0"; exit 0 ;; esac
[ $# -ge 1 ] || fail "which release? usage: test-debian.sh bookworm|trixie|... [TARGET...]"
[ "$(id -u)" -eq 0 ] || fail "making a system needs root (debootstrap, chroot): sudo make test-debian13"

if [ "${TEST_DEBIAN_INSIDE:-}" != yes ]; then
    if ! command -v debootstrap >/dev/null; then
        command -v apt-get >/dev/null || fail "no debootstrap here; install it first"
        apt-get -q -y install --no-install-recommends debootstrap </dev/null ||
            fail "no debootstrap here, and apt-get could not install it"
    fi
    bare=${BARE:-$(mktemp -d "${TMPDIR:-/var/tmp}/test-debian-$1.XXXXXX")}
    mkdir -p "$bare"
    bare=$(cd "$bare" && pwd)
    # a killed shell leaves no process and no mount behind: both belong to the name spaces that end with it
    status=0
    TEST_DEBIAN_INSIDE=yes unshare --mount --pid --fork --kill-child --propagation private \
        "$0" "$bare" "$@" || status=$?
    [ -n "${BARE:-}" ] || rm -rf --one-file-system "$bare"
    exit "$status"
fi

bare=$1 suite=$2
shift 2
[ $# -gt 0 ] || set -- test eval
tree=$(cd "$(dirname "$0")/.." && pwd)
report=''

timed() { # LABEL COMMAND...: runs it, remembers and prints its time and its exit status
    label=$1 started=$(date +%s) status=0
    shift
    "$@" || status=$?
    line="$label: $(($(date +%s) - started)) s, exit status $status"
    say "$line"
    report="$report$line
"
    return "$status"
}

# -- the bare system
if [ -e "$bare/etc/debian_version" ]; then
    say "using the system in $bare"
else
    timed "debootstrap $suite" debootstrap --variant=minbase --include=ca-certificates,git,make "$suite" "$bare" \
        "${MIRROR:-http://deb.debian.org/debian}" >"$bare.log" 2>&1 || { tail -n 20 "$bare.log" >&2; exit 1; }
    rm -f "$bare.log"
fi
echo force-unsafe-io >"$bare/etc/dpkg/dpkg.cfg.d/unsafe-io" # nobody needs this system after a power failure
printf '#!/bin/sh\nexit 101\n' >"$bare/usr/sbin/policy-rc.d" # packages start no services
chmod 755 "$bare/usr/sbin/policy-rc.d"

# -- the host's way to the outside: resolver, proxies, certificates, apt's and pip's settings of transfers
cp -L /etc/resolv.conf "$bare/etc/resolv.conf"
apt-config dump 2>/dev/null | grep -E '^Acquire::(https?|Check|Retries)' >"$bare/etc/apt/apt.conf.d/90host" || true
if ls /usr/local/share/ca-certificates/*.crt >/dev/null 2>&1; then
    cp /usr/local/share/ca-certificates/*.crt "$bare/usr/local/share/ca-certificates/"
    chroot "$bare" update-ca-certificates >/dev/null 2>&1
fi
for file in /etc/pip.conf "$HOME/.config/pip/pip.conf" "$HOME/.pip/pip.conf"; do
    [ ! -e "$file" ] || install -D -m 644 "$file" "$bare$file"
done
mount --rbind /dev "$bare/dev"
mount -t proc proc "$bare/proc"
mount -t sysfs -o ro sysfs "$bare/sys" 2>/dev/null || true
mount -t tmpfs tmpfs "$bare/tmp"
mount -t tmpfs tmpfs "$bare/run"
# folders of packages that pip's settings name are seen read-only at the same place: of an index in files (simple/) the
# folder around it, since its pages point to packages next to them
for word in $( (cat /etc/pip.conf "$HOME/.config/pip/pip.conf" "$HOME/.pip/pip.conf" 2>/dev/null; env | grep '^PIP_') |
    grep -oE '(file://)?/[^ ]+' | sort -u); do
    folder=${word#file://}
    [ "$folder" = "$word" ] || [ "$(dirname "$folder")" = / ] || folder=$(dirname "$folder")
    if [ -d "$folder" ]; then
        mkdir -p "$bare$folder"
        mount --bind -o ro "$(readlink -f "$folder")" "$bare$folder"
    fi
done

# -- the source tree: what git knows and what it does not ignore, as a fresh clone has it
rm -rf "$bare/src"
mkdir -p "$bare/src"
git -C "$tree" ls-files -z --cached --others --exclude-standard -- . ':!.venv' ':!.venv-train' |
    tar -C "$tree" --null --ignore-failed-read -T - -c 2>/dev/null | tar -C "$bare/src" --no-same-owner -x

# -- the targets
kept=$(env | grep -E '^(PIP_[A-Z_]*|https?_proxy|HTTPS?_PROXY|no_proxy|NO_PROXY|SSL_CERT_FILE|REQUESTS_CA_BUNDLE|PYTHONDEVMODE|PYTHONWARNINGS)=' || true)
inside() { # COMMAND...: in the bare system, in the source tree, with nothing of this environment but $kept
    (
        IFS='
'
        # shellcheck disable=SC2086
        exec chroot "$bare" /usr/bin/env -i $kept HOME="$HOME" PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin \
            LC_ALL=C.UTF-8 TERM=dumb /bin/sh -c 'cd /src && exec "$@"' sh "$@"
    )
}

failed=0
timed "make setup" inside make setup || failed=1
if [ "$failed" = 0 ]; then
    timed "make setup-test" inside make setup-test || failed=1
fi
if [ "$failed" = 0 ]; then
    for target; do
        timed "make $target" inside make "$target" ARGS="${ARGS:-}" || failed=1
    done
    versions=$(inside .venv/bin/python -c '
import platform, numpy, scipy, onnxruntime
from gnuradio import gr
print("Python", platform.python_version(), "GNU Radio", gr.version(), "NumPy", numpy.__version__, "SciPy",
      scipy.__version__, "ONNX Runtime", onnxruntime.__version__)' 2>/dev/null) || true
fi
if [ -d "$bare/src/results" ]; then
    mkdir -p "$tree/results/$suite"
    cp -r "$bare/src/results/." "$tree/results/$suite/"
    say "results of the runs are in results/$suite"
fi

say "---- Debian $(cat "$bare/etc/debian_version") ($suite)${versions:+: $versions}"
printf '%s' "$report"
exit "$failed"
