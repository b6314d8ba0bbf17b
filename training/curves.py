"""Training curves of several runs side by side: loss over training and over validation examples.

    PYTHONPATH=python .venv/bin/python training/curves.py paper fc cnn_normalised=cnn
    PYTHONPATH=python .venv/bin/python training/curves.py paper fc --logs training/runs --out curves.png

A log is ``RUN.csv`` below ``--logs``, or ``RUN/log.csv`` as `train.py` writes it; ``RUN=LABEL`` has another label.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot as plt

from radalt.evaluation.engine import options

ROOT = Path(__file__).resolve().parent.parent
PLATEAU = 0.5  # mean squared error of a zero output: each rail of a unit frame has half of its power
_STYLES = (("#0072B2", "-"), ("#D55E00", "--"), ("#009E73", "-."), ("#CC79A7", ":"), ("#000000", "-"))


def read_log(logs: Path, name: str) -> dict[str, list[float]]:
    """Columns of a run's log; raises `ValueError` if there is none."""
    path = next((p for p in (logs / f"{name}.csv", logs / name / "log.csv") if p.is_file()), None)
    if path is None:
        raise ValueError(f"{logs} holds neither {name}.csv nor {name}/log.csv; name another run or --logs")
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {key: [float(row[key]) for row in rows] for key in ("epoch", "train_loss", "validation_loss")}


def draw(path: Path, logs: Path, names: Sequence[str]) -> None:
    """One figure: training error and validation error over epochs."""
    figure, axes = plt.subplots(1, 2, figsize=(6, 3.2), layout="constrained")
    for name, (colour, dash) in zip(names, _STYLES, strict=False):
        name, _, label = name.partition("=")
        log = read_log(logs, name)
        for axis, column in zip(axes, ("train_loss", "validation_loss"), strict=True):
            axis.plot(log["epoch"], log[column], dash, color=colour, lw=1.2, label=label or name)
    for axis, title in zip(axes, ("training error", "validation error"), strict=True):
        axis.set(title=title, xlabel="epochs")
        axis.grid(alpha=0.3)
        axis.axhline(PLATEAU, color="0.6", lw=0.8)
        axis.annotate(
            "output of zero", (1, PLATEAU), (0, 2), ("axes fraction", "data"), "offset points", ha="right"
        )
        axis.set_ylim(0.0, 1.1 * PLATEAU)
    axes[0].set_ylabel("mean squared error")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(names))
    figure.savefig(path, dpi=150)
    plt.close(figure)


@options.command("curves")
def main(argv: Sequence[str] | None = None) -> int:
    """Draw; returns 0, or 2 after one line about an error."""
    parser = options.Parser("curves", __doc__)
    parser.add_argument("names", nargs="+", metavar="RUN[=LABEL]", help=f"at most {len(_STYLES)}")
    parser.add_argument("--logs", type=options.path, default=ROOT / "training" / "logs")
    parser.add_argument("--out", type=options.path, default=ROOT / "docs" / "figures" / "tcae_paper.png")
    args = parser.parse_args(argv)
    if len(args.names) > len(_STYLES):
        parser.error(f"{len(args.names)} runs; at most {len(_STYLES)} stay apart in one figure")
    try:
        draw(args.out, args.logs, args.names)
    except ValueError as error:
        parser.error(str(error))
    print(args.out)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
