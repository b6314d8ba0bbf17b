#!/bin/sh
# A newcomer's first hour in a fresh clone: an evaluation, help, what one brings, installing below a prefix, the
# installed command, a flowgraph generated there, uninstalling; ends with 1 where a step fails or something is left.
# usage: newcomer.sh [ENVIRONMENT]
# ENVIRONMENT is a Python environment that exists, as `make setup` makes it. With it nothing is fetched: the clone and what
# is installed use its packages.
set -eu
case ${1:-} in -h | --help) sed -n '/^[^#]/q; 2,$s/^# *//p' "$0"; exit 0 ;; esac
tree=$(cd "$(dirname "$0")/.." && pwd)
environment=${1:+$(cd "$1" && pwd)}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
git clone -q "$tree" "$work/gr-radalt"
cd "$work/gr-radalt"
if [ -n "$environment" ]; then
    ln -s "$environment" .venv
    touch -d @0 requirements.lock # or make would bring the environment up to date
fi
make help
# with what one brings: a network and a method in addition to the shipped ones, a recording, samples in a file
make eval ARGS="--overlap 1 --sir-db=-10 --altitudes 100,300 --frames 5 --methods none --jobs 1 --capture \
    --model mine=models/any_sweep.onnx --method-file own=flowgraphs/own_method.py --out results/first"
test -s results/first/report.md
for row in none mine own; do grep -q "^$row," results/first/rows.csv; done
recording=$(ls results/first/captures/overlap*.sigmf-meta)
.venv/bin/python flowgraphs/ota_eval.py --replay "$recording" --methods none --out results/replay
PYTHONPATH=python .venv/bin/python examples/own_samples.py "${recording%meta}data" | grep "frames ok"
touch flowgraphs/ota_sim.py flowgraphs/ota_b210_epy_block_0.py # as the companion leaves them: no part of the module
make install PREFIX="$work/prefix" PACKAGES="${environment:+no}"
for made in ota_sim.py ota_b210_epy_block_0.py; do
    [ ! -e "$work/prefix/share/gr-radalt/flowgraphs/$made" ] || { echo "newcomer: $made was installed"; exit 1; }
done
cd "$work"
radalt=$work/prefix/bin/radalt
[ -z "$environment" ] ||
    export PYTHONPATH="$("$environment/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')"
"$radalt" eval --sim --overlap 0 --altitudes 100 --frames 2 --methods none --out "$work/run"
test -s "$work/run/report.md"
eval "$("$radalt" env)"
grcc -o "$work" "$work/prefix/share/gr-radalt/flowgraphs/ota_sim.grc"
/usr/bin/python3 -c 'from gnuradio import radalt; print(radalt.__file__)'
make -C "$work/gr-radalt" uninstall
left=$(find "$work/prefix" 2>/dev/null || true)
[ -z "$left" ] || [ "$left" = "$work/prefix" ] || { echo "newcomer: left behind:"; echo "$left"; exit 1; }
echo "newcomer: every step worked, and nothing is left"
