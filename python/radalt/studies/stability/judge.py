"""Results of a chain on a case, and their verdict.

A row passes if every frame gives an altitude within the case's bound or ``valid = false`` with a reason, nothing is
raised, and the clean frame after the case is measured as by a method that saw nothing before.
"""

import dataclasses
import math
import warnings
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from scipy.stats import binom

from ...core.altimeter.altimeter import Altimeter, Reason, shared_altimeter
from ...core.mitigation import Mitigation, MitigationError
from ...core.mitigation.tcae import default_model_path
from ...core.returns.point import point_return
from ...evaluation.results.chain import Chain
from .cases import CLEAN_ALTITUDE_M, Case, noisy
from .reference import REFERENCES, covariance_condition, reference_altitude_m

# samples of a frame up to which the float64 references are computed: seconds per case
_MAX_REFERENCE_SAMPLES = 100_000


def judge_all(cases: Iterable[Case], chains: Sequence[Chain]) -> Iterator[dict[str, Any]]:
    """A row for every case and chain."""
    for case in cases:
        condition = covariance_condition(case.frames[0][:_MAX_REFERENCE_SAMPLES])
        for chain in chains:
            yield judge(case, chain) | {"condition": condition}


def judge(case: Case, chain: Chain) -> dict[str, Any]:
    """The row of one case and chain: results, verdict and reason; without results where there are none."""
    row: dict[str, Any] = {
        "case": case.name,
        "chain": chain.label,
        "precision": chain.precision,
        "frames": len(case.frames),
        "bound_m": case.bound_m,
    }
    chain = dataclasses.replace(chain, settings=case.settings)
    try:
        method = chain.build(case.waveform)
    except MitigationError as error:  # refusing a waveform in one line is right
        model = chain.model or default_model_path()  # its folder does not belong to the case
        note = str(error).replace(str(model), model.name)
        return row | {"reasons": f"refused: {note}", "verdict": "refused"}
    row["precision"] = getattr(method, "metadata", {}).get("radalt_precision", chain.precision)
    altimeter = shared_altimeter(case.waveform, case.settings)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # an unexpected overflow is a failure
        try:
            cleaned = method.process(case.frames)
            result = altimeter.process(cleaned)
            recovered = _recovers(case, chain, method, altimeter)
        except (ArithmeticError, RuntimeWarning, ValueError, IndexError) as error:
            return row | {"reasons": f"{type(error).__name__}: {error}", "verdict": "FAIL"}
    row |= _measured(case, method, altimeter, cleaned, result)
    row["recovered"] = recovered
    return row | {"verdict": _verdict(case, chain, method, altimeter, row)}


def _clean_frame(case: Case) -> tuple[np.ndarray, float]:
    """A frame within the case's span that any method should measure, and its altitude."""
    top = case.settings.resolved(case.waveform).max_altitude_m
    truth = min(CLEAN_ALTITUDE_M, 0.3 * top)
    frame = point_return(case.waveform, truth)[None]
    return noisy(frame, 20.0, np.random.default_rng(7)), truth


def _recovers(case: Case, chain: Chain, method: Mitigation, altimeter: Altimeter) -> bool:
    """Whether the clean frame after the case is measured as by a method that saw nothing before."""
    frame, truth = _clean_frame(case)
    after = altimeter.process(method.process(frame))[0]
    fresh = altimeter.process(chain.build(case.waveform).process(frame))[0]
    if not method.carries_altitude:
        return True
    if not fresh["valid"]:
        return bool(after["valid"] == fresh["valid"])
    return bool(after["valid"] and abs(after["altitude_m"] - truth) <= abs(fresh["altitude_m"] - truth) + 1.0)


def _measured(
    case: Case, method: Mitigation, altimeter: Altimeter, cleaned: np.ndarray, result: np.ndarray
) -> dict[str, Any]:
    valid = result["valid"]
    error = np.abs(result["altitude_m"][:, None] - case.truth_m.reshape(len(valid), -1))
    error = np.where(np.isfinite(error), error, np.inf).min(axis=1)
    wrong = valid & ~(error <= case.bound_m)
    reasons = [Reason.NAMES[r] for r in np.unique(result["reason"])]
    worst = float(error[valid].max()) if valid.any() else None
    return {
        "valid": int(valid.sum()),
        "wrong": int(wrong.sum()),
        "error_m": worst if worst is None or math.isfinite(worst) else None,
        "finite": bool(np.isfinite(cleaned.view(np.float32)).all()),
        "diverged": int(method.diverged_frames),
        "silenced": int(method.status().get("unconfirmed_frames", 0)),
        "reasons": ", ".join(reasons),
        **_against_float64(case, method, altimeter, cleaned, result),
    }


def _against_float64(
    case: Case, method: Mitigation, altimeter: Altimeter, cleaned: np.ndarray, result: np.ndarray
) -> dict[str, Any]:
    """Relative error of the output and largest altitude difference against the float64 references."""
    out: dict[str, Any] = {"output_error": None, "altitude_float64_m": None}
    if case.frames.shape[1] > _MAX_REFERENCE_SAMPLES:
        return out
    finite = all(np.isfinite(frames.view(np.float32)).all() for frames in (case.frames, cleaned))
    reference = REFERENCES.get(method.name)
    if reference is not None and finite and not method.diverged_frames:
        few = slice(0, 8)
        wanted = reference(method, case.frames[few].astype(complex))
        have = cleaned[few].astype(complex)
        wanted[~have.any(axis=1)] = 0  # silenced frames
        norm = np.vdot(wanted, wanted).real
        if np.isfinite(norm) and norm > 0:
            # a method may scale its output, as whitening does: compare up to one factor per frame
            power = np.maximum(np.sum(np.abs(have) ** 2, axis=1, keepdims=True), 1e-300)
            factor = np.sum(have.conj() * wanted, axis=1, keepdims=True) / power
            out["output_error"] = float(np.linalg.norm(wanted - factor * have) / np.sqrt(norm))
    differences = []
    for k in np.nonzero(result["valid"])[0][:4]:
        beats = result["beat_up_hz"][k], result["beat_down_hz"][k]
        altitude_m = reference_altitude_m(case.waveform, cleaned[k], beats)
        differences.append(abs(altitude_m - result["altitude_m"][k]))
    if differences and altimeter.settings.strategy == "strongest":
        out["altitude_float64_m"] = float(max(differences))
    return out


def _verdict(case: Case, chain: Chain, method: Mitigation, altimeter: Altimeter, row: dict[str, Any]) -> str:
    if not row["recovered"]:
        return "FAIL"
    if not method.carries_altitude:
        return "flagged"
    if chain.method == "none" and case.detects and row["valid"] - row["wrong"] < row["frames"]:
        return "FAIL"
    return "pass" if row["wrong"] <= allowed_false_alarms(case, altimeter) else "WRONG"


def allowed_false_alarms(case: Case, altimeter: Altimeter) -> int:
    """Wrong altitudes that the CFAR's design rate explains: the 99.9 % quantile over the case's frames."""
    if not case.noise_limited:
        return 0
    return int(binom.ppf(0.999, len(case.frames), altimeter.false_alarms_per_frame))
