"""The tables of the paper and of its predecessor, with the networks of a folder.

    PYTHONPATH=python .venv/bin/python training/paper_tables.py
    PYTHONPATH=python .venv/bin/python training/paper_tables.py --models FOLDER --networks fc,cnn,paper

RMSE over SINR and overlap with LMS beside it, Pd over overlap, peak-to-sidelobe ratio and range error over SIR, false
altitudes on the landing. Runs in the runtime environment, without PyTorch. --resume completes a stopped run.
"""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import onnxruntime
from evaluate import FIRST_DRAW, NETWORKS, SEED, SNR_DB, Scenes, chain_of, emitters

from radalt.core.interference import Interferer, QpskEmitter, ToneEmitter
from radalt.core.waveform import Waveform
from radalt.evaluation.engine.chain_study import ChainStudy
from radalt.evaluation.engine.options import Parser, names_of, number, path
from radalt.evaluation.engine.shell import StudyCommand
from radalt.evaluation.engine.study import Point, Run
from radalt.evaluation.results.chain import Chain
from radalt.evaluation.results.folder import RunFolder
from radalt.evaluation.results.page import write_result
from radalt.evaluation.results.rows import Columns
from radalt.evaluation.results.score import SCORE_COLUMNS, score_frames
from radalt.evaluation.results.table import DASH, interval, metres, table
from radalt.evaluation.results.table import number as number_of
from radalt.studies.landing.config import ApproachSpec, load_config
from radalt.studies.landing.points import approach_frames, impaired

ROOT = Path(__file__).resolve().parent.parent
BESIDE = ("none", "lms", "lms_reference_input")
SINRS_DB = (0.0, -5.0, -10.0, -15.0)
OVERLAPS = (0.25, 0.5, 0.75, 1.0)
SIRS_DB = (0.0, -5.0, -10.0, -15.0, -20.0)
LANDING_SIR_DB = -20.0 - 10.0 * float(np.log10(2.0))  # tones and QPSK together, each at -20 dB
# Statements of the authors of arXiv:2505.22783: "over 400 m" without mitigation; in the abstract of a later version
# than the first "more than 85%" less than LMS
STATED = {(-15.0, 1.0): "none above 400, TCAE more than 85 % below LMS"}
Row = dict[str, Any]
COLUMNS = Columns(
    ("interferer", "overlap", "level_db", "method", *SCORE_COLUMNS, "diverged_frames"),
    text=frozenset({"interferer", "method"}),
    whole=frozenset({"trials", "detections", "correct", "forced", "frames_lost", "wrong_far"})
    | {"diverged_frames"},
)


@dataclass(frozen=True)
class TablePoint(Point):
    """No interference (``clean``), QPSK at a SINR and an overlap (``sinr``), an interferer at a SIR, or the landing."""

    part: str = "sinr"
    interferer: str = "qpsk_rectangular"
    overlap: float = 1.0
    level_db: float = 0.0


@lru_cache(maxsize=1)
def _scenes(trials: int) -> Scenes:
    return Scenes.draw(Waveform(), trials, FIRST_DRAW + 500)


@dataclass(frozen=True)
class PaperTables(ChainStudy):
    """``trials`` frames per point, ``landing_frames`` of the approach; either may be 0."""

    chains: tuple[Chain, ...]
    trials: int = 150
    landing_frames: int = 200

    tables: ClassVar[Mapping[str, Columns]] = {"rows": COLUMNS}
    published: ClassVar[Mapping[str, str]] = {"rows.csv": "data/paper_tables.csv"}

    def check(self) -> None:
        """See `Study`; raises `MitigationError` where a model does not fit."""
        for chain in self.chains:
            chain.build(Waveform())

    def head(self) -> dict[str, Any]:
        """See `Study`."""
        return {
            "seed": [SEED, FIRST_DRAW + 500],
            "snr_db": SNR_DB,
            "methods": [chain.label for chain in self.chains],
            "trials": self.trials,
            "landing_frames": self.landing_frames,
            "models": {chain.label: _about(chain.model) for chain in self.chains if chain.model},
        }

    def points(self) -> list[TablePoint]:
        """Every point, in the order of the report."""
        n, flown = self.trials, self.landing_frames
        swept = [TablePoint("clean", n, "rows", "clean", "clean", 0.0)]
        swept += [
            TablePoint(f"SINR {sinr:g} dB, overlap {rho:g}", n, "rows", overlap=rho, level_db=sinr)
            for sinr in SINRS_DB
            for rho in OVERLAPS
        ] + [
            TablePoint(f"{name}, SIR {sir:g} dB", n, "rows", "sir", name, level_db=sir)
            for name in ("tones", "qpsk_rectangular")
            for sir in SIRS_DB
        ]
        landing = [
            TablePoint("landing", flown, "rows", "landing", "tones and QPSK", level_db=LANDING_SIR_DB),
            TablePoint("landing, clean", flown, "rows", "landing", "clean", 0.0),
        ]
        return (swept if n else []) + (landing if flown else [])

    def _frames(self, point: TablePoint) -> tuple[np.ndarray, np.ndarray, Chain]:
        """(n, N) frames, (n,) altitudes in metres, and a chain with the altimeter for them."""
        if point.part != "landing":
            scenes = _scenes(self.trials)
            if point.part == "clean":
                return scenes.frames, scenes.altitude_m, Chain("none", "none")
            noise = 10.0 ** (-SNR_DB / 10.0) if point.part == "sinr" else 0.0
            sir_db = -10.0 * float(np.log10(10.0 ** (-point.level_db / 10.0) - noise))
            parts = emitters()[point.interferer]
            frames = scenes.with_interference(parts, point.overlap, sir_db, FIRST_DRAW + 500)
            return frames, scenes.altitude_m, Chain("none", "none")
        placed = (Interferer(ToneEmitter(5)), Interferer(QpskEmitter())) if point.overlap else ()
        config = replace(
            load_config(ROOT / "flowgraphs" / "landing" / "study.yaml"),
            interference=placed,
            approach=ApproachSpec(frames=self.landing_frames),
        )
        truth = approach_frames(config, 0, self.landing_frames)
        rng = np.random.default_rng([SEED, FIRST_DRAW + 501])
        frames, _, _ = impaired(config, truth, rng, overlap=point.overlap, sir_db=point.level_db)
        return frames[:, 0], truth.height_m, Chain("none", "none", settings=config.altimeter)

    def measure(self, point: TablePoint) -> list[Row]:
        """A row per method, all on the same frames."""
        frames, altitude_m, like = self._frames(point)
        rows = []
        for chain in self.chains:
            results, method = replace(chain, settings=like.settings).results(frames, Waveform())
            about = (f"{point.part} {point.interferer}", point.overlap, point.level_db, chain.label)
            row = dict(zip(COLUMNS.names, about, strict=False)) | score_frames(results, altitude_m).row()
            rows.append(row | {"diverged_frames": method.diverged_frames})
        return rows

    def report(self, folder: RunFolder, rows: Mapping[str, list[Row]], run: Run) -> Path:
        """See `Study`."""
        names, found = folder.head["methods"], rows["rows"]
        tables = {
            "summary": summary(found),
            "clean_table": _clean(found),
            "sinr_table": _grid(found, "sinr", names, lambda r: metres(r["rmse_forced_m"]), STATED),
            "pd_table": _grid(found, "sinr", names, lambda r: number_of(r["pd"], 2)),
            "ratio_table": _grid(found, "sir", names, lambda r: number_of(r["peak_to_sidelobe_db"], 1)),
            "range_table": _grid(found, "sir", names, _errors),
            "landing_table": _landing(found),
        }
        return write_result(
            folder, Path(__file__).with_name("paper_tables.md.j2"), run.as_dict(), rows, tables
        )


def _about(model: Path) -> str:
    """Recipe, epochs and hash of a network's file."""
    session = onnxruntime.InferenceSession(str(model), providers=["CPUExecutionProvider"])
    info = session.get_modelmeta().custom_metadata_map
    examples = f"{int(info['radalt_training_examples']):,} examples"
    return f"(`{info['radalt_recipe']}`, {examples}, `{hashlib.sha256(model.read_bytes()).hexdigest()[:16]}`)"


def _errors(row: Row) -> str:
    return f"{metres(row['rmse_forced_m'])} / {metres(row['rmse_detected_m'])}"


def _grid(
    rows: Sequence[Row],
    part: str,
    names: Sequence[str],
    cell: Callable[[Row], str],
    stated: Mapping[tuple[float, float], str] = {},  # noqa: B006 - never changed
) -> str:
    """A line per interferer, overlap and level, a column per method, the authors' last; empty without rows."""
    mine = [r for r in rows if r["interferer"].startswith(f"{part} ")]
    by_point: dict[tuple, dict[str, str]] = {}
    for r in mine:
        key = (r["interferer"].removeprefix(f"{part} "), r["overlap"], r["level_db"])
        by_point.setdefault(key, {})[r["method"]] = cell(r)
    level = {"sinr": "SINR / dB", "sir": "SIR / dB"}[part]
    lines = [
        [
            name,
            f"{overlap:g}",
            f"{level_db:g}",
            *(cells[m] for m in names),
            stated.get((level_db, overlap), DASH),
        ]
        for (name, overlap, level_db), cells in by_point.items()
    ]
    return table(["interferer", "overlap", level, *names, "authors"], lines) if lines else ""


def _rmse(row: Row) -> str:
    return metres(row["rmse_forced_m"])


def _sidelobe(row: Row) -> str:
    return number_of(row["peak_to_sidelobe_db"], 1)


def _wrong(row: Row) -> str:
    return f"{row['detections'] - row['correct']} / {row['wrong_far']} / {row['correct']}"


# Lines of the summary: label, part and interferer, overlap, level in dB, cell
_SUMMARY: tuple[tuple[str, str, float, float, Callable[[Row], str]], ...] = (
    ("RMSE / m, no interference", "clean clean", 0.0, 0.0, _rmse),
    ("Pd, no interference", "clean clean", 0.0, 0.0, lambda r: number_of(r["pd"], 2)),
    ("RMSE / m, QPSK, SINR 0 dB", "sinr qpsk_rectangular", 1.0, 0.0, _rmse),
    ("QPSK, SINR -15 dB", "sinr qpsk_rectangular", 1.0, -15.0, _rmse),
    ("QPSK, SINR -15 dB, overlap 0.25", "sinr qpsk_rectangular", 0.25, -15.0, _rmse),
    ("tones, SIR 0 dB", "sir tones", 1.0, 0.0, _rmse),
    ("tones, SIR -20 dB", "sir tones", 1.0, -20.0, _rmse),
    ("peak to sidelobe / dB, QPSK, SIR -20 dB", "sir qpsk_rectangular", 1.0, -20.0, _sidelobe),
    ("tones, SIR -20 dB", "sir tones", 1.0, -20.0, _sidelobe),
    ("landing, no interference: wrong and valid / by 20 m / right", "landing clean", 0.0, 0.0, _wrong),
    ("landing, tones and QPSK at -20 dB each", "landing tones and QPSK", 1.0, LANDING_SIR_DB, _wrong),
)


def summary(rows: Sequence[Row]) -> str:
    """The table of docs/tcae.md: its lines for no mitigation, LMS in its better wiring and the networks."""
    names = [name for name in dict.fromkeys(r["method"] for r in rows) if name != "lms"]
    lines = []
    for label, interferer, overlap, level_db, cell in _SUMMARY:
        found = {
            r["method"]: r
            for r in rows
            if (r["interferer"], r["overlap"]) == (interferer, overlap)
            and abs(r["level_db"] - level_db) < 0.01
        }
        if found:
            lines.append([label, *(cell(found[name]) for name in names)])
    return table(["", *(f"`{name}`" for name in names)], lines) if lines else ""


def _clean(rows: Sequence[Row]) -> str:
    """Pd and errors of every method without interference; empty without rows."""
    mine = [r for r in rows if r["interferer"] == "clean clean"]
    lines = [[r["method"], interval(r["pd"], r["pd_low"], r["pd_high"]), _errors(r)] for r in mine]
    return table(["method", "Pd (95 %)", "RMSE forced / detected / m"], lines) if lines else ""


def _landing(rows: Sequence[Row]) -> str:
    """Wrong and valid altitudes of every method with and without interference; empty without rows."""
    mine = [r for r in rows if r["interferer"].startswith("landing ")]
    lines = []
    for method in dict.fromkeys(r["method"] for r in mine):
        cells = []
        for r in (r for r in mine if r["method"] == method):
            wrong = r["detections"] - r["correct"]
            cells += [wrong, r["wrong_far"], number_of(r["pd"], 2)]
        lines.append([method, *cells, DASH])
    case = ["wrong and valid", "by 20 m", "Pd"]
    header = ["method", *case, *(f"{name}, clean" for name in case), "authors"]
    return table(header, lines) if lines else ""


def describe(rows: Sequence[Row]) -> str:
    """A measured point in a line."""
    return f"{rows[0]['interferer']}: Pd " + ", ".join(f"{r['method']} {r['pd']:.3g}" for r in rows)


def _arguments(parser: Parser) -> None:
    add, count = parser.add_argument, number(int, 0, 1_000_000)
    add("--models", type=path, default=ROOT / "models", help="folder of the networks' files")
    add("--networks", default=",".join(NETWORKS), help=f"of {', '.join(NETWORKS)}")
    add("--trials", type=count, default=150, help="frames per point; 0 leaves those tables out")
    add("--landing-frames", type=count, default=200, help="frames of the approach; 0: no landing")


def _study(args: argparse.Namespace, parser: Parser) -> PaperTables:
    networks = names_of(parser, "--networks", args.networks, NETWORKS)
    if not args.trials + args.landing_frames:
        parser.error("--trials and --landing-frames are both 0; give one of them")
    chains = tuple(chain_of(name, args.models.resolve()) for name in (*BESIDE, *networks))
    return PaperTables(chains, args.trials, args.landing_frames)


OUT = str(ROOT / "results" / "paper_tables")
main = StudyCommand("paper_tables", __name__, _arguments, _study, describe, out=OUT, time_limit_s=3600.0).main


if __name__ == "__main__":
    raise SystemExit(main())
