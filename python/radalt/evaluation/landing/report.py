"""What the rows of a landing study say: tables, the comparison with the paper, report.json and report.md."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ...core.mitigation import create
from ...core.receiver.altimeter import Reason
from ...core.receiver.cramer_rao import altitude_crb_m
from ..results.folder import flatten, read_report, versions
from ..results.score import CORRECT_LIMIT_M
from .study import LandingStudy, StudyError, accuracy_limit_m, study_dict
from .variants import VARIANTS

__all__ = ["SCHEMA", "approach_table", "break_points", "comparison", "open_folder", "write_report"]

SCHEMA = "landing-1"
BANDS = (("flare, below 30 m", 0.0, 30.0), ("30..150 m", 30.0, 150.0), ("above 150 m", 150.0, np.inf))
PAPER_RMSE_M = 400.0  # "over 400 m without mitigation", paper, at -15 dB
PAPER_SINR_DB = -15.0
PAPER_REDUCTION = 0.85  # "reduces altitude estimation error by more than 85% compared to [...] LMS": abstract

DIFFERENCES = (
    "SNR: the paper does not state it; ours follows from the radar equation and grows on the way down.",
    "Detection: the paper does not say how it picks a beat; ours needs both half sweeps to agree above a "
    "CFAR threshold and takes the leading edge. A forced decision takes the best pair of cells, "
    "declared or not.",
    "Level: ours is averaged over the whole frame before dechirping, relative to the mean return over "
    "speckle. Meant after dechirping, the same number is 35.7 dB worse.",
    "Clutter: the paper's level is open; ours is Morchin's model of low-relief urban ground with an assumed "
    "nadir peak.",
    "Doppler: on here, off in the paper's hardware test.",
    "Ground: synthetic terrain and a synthetic approach; the paper flies its approach over real terrain.",
    "Interferer: rectangular pulses straight at the sample rate, as in the paper; they are constant between "
    "symbol edges, which a learned method uses. See the rows behind a receiver's filter.",
    "LMS: block LMS with the paper's parameters; it diverges above an input power of about 6.",
)


def _array(rows: Sequence[dict[str, Any]], column: str) -> np.ndarray:
    return np.array([np.nan if r[column] is None else r[column] for r in rows], dtype=float)


def condition(row: dict[str, Any]) -> str:
    """Label of an approach row: its method, or ``no interference``."""
    return "no interference" if row["overlap"] == 0 else row["method"]


def _of(rows: Iterable[dict[str, Any]], kind: str, **match: Any) -> list[dict[str, Any]]:
    return [r for r in rows if r["kind"] == kind and all(r[k] == v for k, v in match.items())]


def approach_table(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Per condition and height band of the approach: detections, accuracy, errors, vertical speed."""
    approach = _of(rows, "approach")
    table = []
    for label in dict.fromkeys(condition(r) for r in approach):
        mine = [r for r in approach if condition(r) == label]
        for band, low, high in (("whole approach", 0.0, np.inf), *BANDS):
            part = [r for r in mine if low <= r["height_m"] < high]
            if part:
                table.append({"condition": label, "band": band, **_band_statistics(part)})
    return table


def _band_statistics(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    valid = _array(rows, "valid") > 0
    height = _array(rows, "height_m")
    error = _array(rows, "altitude_m") - height
    forced = _array(rows, "forced_altitude_m") - height
    speed = (_array(rows, "vertical_speed_m_per_s") - _array(rows, "climb_m_per_s"))[valid]
    with np.errstate(invalid="ignore"):
        inside = valid & (np.abs(error) <= accuracy_limit_m(height))
        correct = valid & (np.abs(error) < CORRECT_LIMIT_M)
    reason = _array(rows, "reason")
    reasons = {Reason.NAMES[int(k)]: int(np.sum(reason == k)) for k in np.unique(reason)}
    return {
        "frames": len(rows),
        "detected": float(valid.mean()),
        "within_5_m": float(correct.mean()),
        "in_band": float(inside.mean()),
        "rmse_m": _rms(error[valid]),
        "forced_rmse_m": _rms(forced[np.isfinite(forced)]),
        "bias_m": float(error[valid].mean()) if valid.any() else None,
        "speed_bias_m_per_s": float(speed.mean()) if speed.size else None,
        "speed_bias_error_m_per_s": float(speed.std() / np.sqrt(speed.size)) if speed.size > 1 else None,
        "speed_rmse_m_per_s": _rms(speed),
        "snr_db": [float(_array(rows, "snr_db").min()), float(_array(rows, "snr_db").max())],
        "reasons": reasons,
    }


def _rms(values: np.ndarray) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if values.size else None


def clean_rows(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """The interference-free ceiling by method."""
    return {r["method"]: r for r in _of(rows, "curve", point="curve/clean")}


def curve(rows: Sequence[dict[str, Any]], overlap: float, method: str) -> list[dict[str, Any]]:
    """One curve of figure 2, by rising SINR asked for."""
    mine = [r for r in _of(rows, "curve", overlap=overlap, method=method) if r["point"] != "curve/clean"]
    return sorted(mine, key=asked_db)


def asked_db(row: dict[str, Any]) -> float:
    """SINR that a curve point was asked for (what it got is limited by the SNR)."""
    return float(row["point"].rsplit("/", 1)[1])


def break_points(study: LandingStudy, rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Lowest SINR from which on Pd stays at 90 % of the interference-free Pd of no mitigation.

    The usual criterion (Pd at least 0.9) is out of reach of extended ground at 20 m resolution, interference
    or not.
    """
    clean = clean_rows(rows)
    if not clean:
        return []
    wanted = 0.9 * next(iter(clean.values()) if "none" not in clean else iter([clean["none"]]))["pd"]
    table = []
    for overlap in study.curve.overlap:
        for method in study.methods:
            good = None
            for row in reversed(curve(rows, overlap, method)):
                if row["pd"] < wanted:
                    break
                good = asked_db(row)
            table.append({"overlap": overlap, "method": method, "break_point_db": good, "pd_needed": wanted})
    return table


def comparison(study: LandingStudy, rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The paper's statements beside our numbers."""
    table = []
    full = max((o for o in study.curve.overlap), default=None)
    if full is None or not study.curve.trials:
        return table
    at = {
        m: next((r for r in curve(rows, full, m) if asked_db(r) == PAPER_SINR_DB), None)
        for m in study.methods
    }
    none = at.get("none")
    if none:
        beyond = [r for r in curve(rows, full, "none") if (r["forced_rmse_m"] or 0) > PAPER_RMSE_M]
        table.append(
            {
                "statement": f"altitude error without mitigation at {PAPER_SINR_DB:g} dB, overlap {full:g}",
                "paper": f"over {PAPER_RMSE_M:g} m",
                "ours": f"{_metres(none['forced_rmse_m'])} over all frames, {_metres(none['rmse_m'])} over "
                f"detections (Pd {none['pd']:.2f})",
            }
        )
        where = f"{max(asked_db(r) for r in beyond):g} dB and below" if beyond else "nowhere on the curve"
        table.append(
            {
                "statement": f"where error without mitigation exceeds {PAPER_RMSE_M:g} m, overlap {full:g}",
                "paper": f"{PAPER_SINR_DB:g} dB",
                "ours": where,
            }
        )
    lms = at.get("lms")
    if lms:
        table.append(
            {
                "statement": f"altitude error of LMS at {PAPER_SINR_DB:g} dB, overlap {full:g}",
                "paper": "-",
                "ours": f"{_metres(lms['forced_rmse_m'])} over all frames (Pd {lms['pd']:.2f})",
            }
        )
    for method, row in at.items():
        if lms and row and method not in ("lms", "nlms") and lms["forced_rmse_m"] and row["forced_rmse_m"]:
            table.append(
                {
                    "statement": f"error of {method} against LMS at {PAPER_SINR_DB:g} dB, overlap {full:g}",
                    "paper": f"TCAE {PAPER_REDUCTION:.0%} lower or more",
                    "ours": f"{1 - row['forced_rmse_m'] / lms['forced_rmse_m']:.0%} lower "
                    f"({_metres(row['forced_rmse_m'])} against {_metres(lms['forced_rmse_m'])}, all frames)",
                }
            )
    return table


def doppler(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What Doppler does to altitude and vertical speed, from the sensitivity table, no mitigation."""
    kept = ("bias_m", "rmse_m", "speed_bias_m_per_s", "speed_rmse_m_per_s", "detections")
    names = {"on": "baseline", "off": "doppler_off", "on, 8 sweeps averaged": "looks_8"}
    found = {k: _of(rows, "variant", variant=v, method="none") for k, v in names.items()}
    return {k: {c: r[0][c] for c in kept} for k, r in found.items() if r}


def sensitivity(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of the sensitivity table, with the text of each assumption."""
    text = {v.name: v for v in VARIANTS}
    table = []
    for row in _of(rows, "variant"):
        variant = text[row["variant"]]
        kept = ("method", "snr_db", "sir_db", "pd", "in_band", "rmse_m", "forced_rmse_m", "bias_m")
        more = (
            "forced_rmse_low_m",
            "forced_rmse_high_m",
            "speed_bias_m_per_s",
            "speed_rmse_m_per_s",
            "trials",
        )
        over = (row["forced_rmse_m"] or 0.0) > PAPER_RMSE_M
        entry = {"group": variant.group, "assumption": variant.text, "variant": variant.name}
        table.append({**entry, **{k: row[k] for k in kept + more}, "over_400_m": over})
    return table


def _metres(value: float | None) -> str:
    if value is None or not np.isfinite(value):
        return "-"
    return f"{value:.0f} m" if value >= 100 else f"{value:.1f} m"


def _plain(value: Any) -> Any:
    """JSON has neither NaN nor infinity."""
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    return value


def _inputs(study: LandingStudy) -> dict[str, str]:
    """SHA-256 of every file of the landing."""
    names = [study.trajectory.file, *study.terrain.files, *filter(None, [study.antenna.pattern])]
    return {Path(n).name: hashlib.sha256(study.spec.path(n).read_bytes()).hexdigest() for n in names}


def _methods(study: LandingStudy) -> dict[str, dict[str, Any]]:
    """What is known of each method; of a network its file, hash, and whether it says it is a placeholder."""
    known = {}
    for method in study.methods:
        stage = create(method, study.waveform, **study.method_options.get(method, {}))
        known[method] = {}
        if hasattr(stage, "sha256"):
            known[method] = {
                "model": stage.model.name,
                "sha256": stage.sha256,
                "placeholder": stage.placeholder,
            }
    return known


def open_folder(folder: Path, study: LandingStudy, *, resume: bool) -> dict[str, Any]:
    """Make a result folder, or make sure that it holds a part of this very run; returns the head of the report.

    Raises
    ------
    StudyError
        If it holds a run and ``resume`` is off, or another run than this one; names the first difference.
    """
    head = _plain(
        {
            "schema": SCHEMA,
            "complete": False,
            "name": study.name,
            "seed": study.seed,
            "study": study_dict(study),
            "inputs_sha256": _inputs(study),
            "methods": _methods(study),
        }
    )
    if (folder / "rows.csv").exists() or (folder / "report.json").exists():
        if not resume:
            raise StudyError(
                f"{folder} holds a run already; add --resume to complete it, or name another --out"
            )
        held = read_report(folder)
        mine, have = (flatten({k: d.get(k) for k in head if k != "complete"}) for d in (head, held))
        for key in [*mine, *(k for k in have if k not in mine)]:
            if mine.get(key) != have.get(key):
                raise StudyError(
                    f"{folder} holds another run: {key} is {have.get(key)!r} there and {mine.get(key)!r} here; "
                    "repeat that run's options, or name another --out"
                )
    folder.mkdir(parents=True, exist_ok=True)
    head |= {"left_out": _left_out(study), "versions": versions("tcae" in study.methods)}
    text = "# the study as used, with all defaults and what the command line changed\n"
    (folder / "study.yaml").write_text(
        text + yaml.safe_dump(head["study"], sort_keys=False), encoding="utf-8"
    )
    _write_json(folder, head)
    return head


def _write_json(folder: Path, report: dict[str, Any]) -> None:
    fresh = folder / "report.tmp"
    fresh.write_text(json.dumps(report, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    fresh.replace(folder / "report.json")


def _left_out(study: LandingStudy) -> list[str]:
    out = []
    if not study.approach.frames:
        out.append("approach over time (approach.frames: 0)")
    if not study.curve.trials:
        out.append("error against SINR (curve.trials: 0)")
    if not study.curve.sensitivity_trials:
        out.append("sensitivity table (curve.sensitivity_trials: 0)")
    if "tcae" not in study.methods:
        out.append("the TCAE (not among the methods): onnxruntime was not imported")
    if not study.terrain.files:
        out.append("DTED terrain (terrain.files is empty: flat earth)")
    return out


def write_report(
    study: LandingStudy,
    rows: Sequence[dict[str, Any]],
    folder: Path,
    figures: Sequence[str],
    *,
    head: dict[str, Any],
    run: dict[str, Any],
) -> dict[str, Any]:
    """Write ``report.md`` and ``report.json`` into a folder and return what the latter holds.

    ``head`` is what `open_folder` gave; ``run`` says how the run went (``jobs, points, points_resumed, wall_s``).
    """
    bounds = {f"{snr:g} dB": float(altitude_crb_m(study.waveform, snr)) for snr in (-30, -20, -10, 0, 20)}
    report = head | _plain(
        {
            "complete": True,
            "created": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            "rows": len(rows),
            "approach": approach_table(rows),
            "ceiling": list(clean_rows(rows).values()),
            "cramer_rao_point_target_m": bounds,
            "doppler": doppler(rows),
            "break_points": break_points(study, rows),
            "paper": {"comparison": comparison(study, rows), "differences": DIFFERENCES},
            "sensitivity": sensitivity(rows),
            "figures": list(figures),
            "run": run,
        }
    )
    (folder / "report.md").write_text(_markdown(study, report), encoding="utf-8")
    _write_json(folder, report)  # last: a complete report.json says that everything else is there
    return report


def _table(header: Sequence[str], lines: Iterable[Sequence[Any]]) -> list[str]:
    out = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return out + ["| " + " | ".join(str(c) for c in line) + " |" for line in lines] + [""]


def _number(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _markdown(study: LandingStudy, report: dict[str, Any]) -> str:
    spec = study.approach
    text = [
        f"# Landing study: {study.name}",
        "",
        f"Trajectory `{study.trajectory.file}`, terrain "
        f"{', '.join(f'`{f}`' for f in study.terrain.files) or 'flat earth'}, ground {study.ground.model}/"
        f"{study.ground.land} ({study.ground.level_db:+g} dB), detection "
        f"{study.altimeter.strategy.replace('_', ' ')}, Doppler {'on' if study.doppler else 'off'}, "
        f"seed {study.seed}.",
        "A correct altitude is within 5 m of the height above ground (the paper) and, apart, within 3 ft "
        "below 100 ft, 3 % up to 500 ft and 5 % above. A frame without detection counts against both.",
        "",
    ]
    text += [f"Left out: {item}." for item in report["left_out"]] + [""]
    if report["approach"]:
        text += [f"## Over the approach (SIR {spec.sir_db:g} dB, overlap {spec.overlap:g})", ""]
        text += _table(
            ("condition", "heights", "frames", "detected", "within 5 m", "in band", "RMSE detections",
             "RMSE all frames", "bias", "vertical speed error (mean +/- s.e.)"),
            [
                (r["condition"], r["band"], r["frames"], _number(r["detected"]), _number(r["within_5_m"]),
                 _number(r["in_band"]), _metres(r["rmse_m"]), _metres(r["forced_rmse_m"]),
                 _metres_signed(r["bias_m"]), _speed(r))
                for r in report["approach"]
            ],
        )  # fmt: skip
    if report["ceiling"]:
        text += ["## Interference-free ceiling, and what a method costs where nothing is wrong", ""]
        text += _table(
            ("method", "trials", "Pd (5 m)", "95 %", "in accuracy band", "RMSE", "95 %", "bias"),
            [
                (r["method"], r["trials"], _number(r["pd"]), f"{r['pd_low']:.2f}..{r['pd_high']:.2f}",
                 _number(r["in_band"]), _metres(r["rmse_m"]), _between(r, "rmse"),
                 _metres_signed(r["bias_m"]))
                for r in report["ceiling"]
            ],
        )  # fmt: skip
        bounds = ", ".join(f"{m:.2g} m at {snr}" for snr, m in report["cramer_rao_point_target_m"].items())
        text += [
            f"Cramer-Rao bound of a point target (one sweep): {bounds}. What separates ceiling and bound is "
            "the extent of the ground, not noise.",
            "",
        ]
    if report["doppler"]:
        text += ["## Doppler: does it cancel, and is the vertical speed right?", ""]
        text += _table(
            ("Doppler", "altitude bias", "RMSE", "vertical speed error, mean", "rms", "detections"),
            [
                (k, _metres_signed(r["bias_m"]), _metres(r["rmse_m"]),
                 f"{_number(r['speed_bias_m_per_s'])} m/s",
                 f"{_number(r['speed_rmse_m_per_s'])} m/s", r["detections"])
                for k, r in report["doppler"].items()
            ],
        )  # fmt: skip
    if report["break_points"]:
        needed = report["break_points"][0]["pd_needed"]
        text += [
            f"## Break-points: lowest SINR from which Pd stays above {needed:.2f}, 90 % of the ceiling",
            "",
        ]
        found = {(r["overlap"], r["method"]): r["break_point_db"] for r in report["break_points"]}
        text += _table(
            ("method", *(f"overlap {o:g}" for o in study.curve.overlap)),
            [
                (m, *("none" if found[o, m] is None else f"{found[o, m]:g} dB" for o in study.curve.overlap))
                for m in study.methods
            ],
        )
    text += _paper_section(report)
    text += _sensitivity_section(study, report)
    text += _run_section(report)
    text += [f"![{name}]({name})" for name in report["figures"]]
    return "\n".join(text) + "\n"


def _run_section(report: dict[str, Any]) -> list[str]:
    run = report["run"]
    resumed = f", {run['points_resumed']} of them from an earlier start" if run["points_resumed"] else ""
    lines = [f"{run['points']} points in {run['wall_s']:.0f} s with {run['jobs']} processes{resumed}"]
    lines.append(", ".join(f"{name} {version}" for name, version in report["versions"].items()))
    for method, known in report["methods"].items():
        if known:
            placeholder = ", a placeholder: it was not trained" if known["placeholder"] else ""
            lines.append(f"{method}: {known['model']} `{known['sha256'][:12]}`{placeholder}")
    return ["## Run", "", *(f"- {line}" for line in lines), ""]


def _between(row: dict[str, Any], name: str) -> str:
    return f"{_metres(row[name + '_low_m'])}..{_metres(row[name + '_high_m'])}"


def _speed(row: dict[str, Any]) -> str:
    return f"{_number(row['speed_bias_m_per_s'], 1)} +/- {_number(row['speed_bias_error_m_per_s'], 1)} m/s"


def _metres_signed(value: float | None) -> str:
    return "-" if value is None else f"{value:+.1f} m"


def _paper_section(report: dict[str, Any]) -> list[str]:
    if not report["paper"]["comparison"]:
        return []
    lines = [(r["statement"], r["paper"], r["ours"]) for r in report["paper"]["comparison"]]
    text = ["## Beside the paper", ""] + _table(("", "paper", "ours"), lines)
    return (
        text + ["Where the regimes differ:", ""] + [f"- {d}" for d in report["paper"]["differences"]] + [""]
    )


def _sensitivity_section(study: LandingStudy, report: dict[str, Any]) -> list[str]:
    if not report["sensitivity"]:
        return []
    spec = study.approach
    over = [r["assumption"] for r in report["sensitivity"] if r["over_400_m"] and r["method"] == "none"]
    text = [
        f"## What the numbers hang on (SIR {spec.sir_db:g} dB, overlap {spec.overlap:g})",
        "",
        "One assumption is changed a row. Without mitigation the error over all frames exceeds "
        f"{PAPER_RMSE_M:g} m under: {'; '.join(over) or 'none of these'}.",
        "",
    ]
    return text + _table(
        ("assumption", "method", "SNR", "SIR", "Pd (5 m)", "in band", "RMSE detections", "RMSE all frames",
         "95 %",
         "bias", "vertical speed mean / rms"),
        [
            (r["assumption"], r["method"], f"{_number(r['snr_db'], 0)} dB",
             "-" if r["sir_db"] is None else f"{r['sir_db']:.1f} dB", _number(r["pd"]), _number(r["in_band"]),
             _metres(r["rmse_m"]), _metres(r["forced_rmse_m"]),
             _between(r, "forced_rmse"), _metres_signed(r["bias_m"]),
             f"{_number(r['speed_bias_m_per_s'], 1)} / {_number(r['speed_rmse_m_per_s'], 1)} m/s")
            for r in report["sensitivity"]
        ],
    )  # fmt: skip
