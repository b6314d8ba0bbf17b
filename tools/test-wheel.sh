#!/bin/sh
# Installs the wheel into two fresh environments and measures with it: a bare one, whose packages come from the package
# index, and one with the system's packages, whose NumPy has to stay what it is. Neither has GNU Radio on its path.
# usage: test-wheel.sh [PYTHON...]        interpreters of the bare environment; default: python3
# Without GNU Radio: a finder hides the system's, where there is one. Linux only was tried; nothing of it is Linux's.
set -eu
case ${1:-} in -h | --help) sed -n '/^[^#]/q; 2,$s/^# *//p' "$0"; exit 0 ;; esac
cd "$(dirname "$0")/.."
work=$(mktemp -d "${TMPDIR:-/tmp}/test-wheel.XXXXXX")
trap 'rm -rf "$work"' EXIT
[ $# -gt 0 ] || set -- python3
system=${SYSTEM_PYTHON:-/usr/bin/python3}

cat >"$work/try.py" <<'PY'
import importlib.abc
import sys
from importlib.metadata import version


class Absent(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.startswith(("gnuradio.gr", "pmt")):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, Absent())
import numpy as np  # noqa: E402

import radalt  # noqa: E402

w = radalt.Waveform()
frames, truth_m = radalt.simulate("nr10", sir_db=-20, overlap=1, frames=20, seed=1)
result = radalt.Altimeter(w).process(radalt.method("whitening", w).process(frames))
assert (np.abs(result["altitude_m"] - truth_m) < 5).all()
report = radalt.evaluate("nr5", ["none", "tcae"], sir_db=[-40, -30, -20], overlap=1, frames=10, progress=False)
assert len(report.break_points()) == 2 and report.html.is_file()
report.plot()
from radalt.evaluation import programs  # noqa: E402

assert programs.main(["eval", "--sim"]) == 2
print(sys.version.split()[0], "numpy", np.__version__, "radalt", version("gr-radalt"), "Pd", report.to_numpy()["pd"])
PY

# the wheel in an environment that builds alone, as `pip install .` does
for python; do
    "$python" -m venv "$work/bare"
    "$work/bare/bin/python" -m pip --disable-pip-version-check -q install .
    (cd "$work" && MPLBACKEND=Agg bare/bin/python try.py && bare/bin/radalt --version)
    rm -rf "$work/bare" "$work/results"
done
if [ -x "$system" ] && "$system" -c 'import numpy, scipy' 2>/dev/null; then
    before=$("$system" -c 'import numpy; print(numpy.__version__)')
    "$system" -m venv --system-site-packages "$work/system"
    "$work/system/bin/python" -m pip --disable-pip-version-check -q install .
    after=$("$work/system/bin/python" -c 'import numpy; print(numpy.__version__)')
    [ "$before" = "$after" ] || { echo "test-wheel: NumPy went from $before to $after" >&2; exit 1; }
    (cd "$work" && MPLBACKEND=Agg system/bin/python try.py)
else
    echo "test-wheel: $system has no NumPy and SciPy; the environment with the system's packages was left out"
fi
