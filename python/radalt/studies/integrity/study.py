"""Study: altitudes of all methods, tracked and per frame, over the campaign's cases; all share a flight's frames."""

import dataclasses
import itertools
import time
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ...core.altimeter.altimeter import RESULT_DTYPE, AltimeterSettings, Spectra, shared_altimeter
from ...core.altimeter.frame_quality import FrameQuality
from ...core.parsing import InputError
from ...core.tracker.tracker import OUTPUT_DTYPE, AltitudeTracker, Status, TrackerSettings
from ...evaluation.engine.chain_study import ChainStudy
from ...evaluation.engine.study import Point
from ...evaluation.results.chain import Chain, method_of
from ...evaluation.results.integrity import (
    alert_limit_m,
    error_m,
    integrity,
    is_hazardous,
    stanford,
    time_to_alert_s,
    time_to_first_s,
)
from ...evaluation.results.rows import Columns
from ...evaluation.results.score import score_frames
from .beats import beats_of
from .cases import BLOCK, KINDS, LONG, LONGER, WAVEFORM, Case, case_of, cases
from .columns import EDGES, FRAMES, ROWS
from .flights import Flight, fly, rng_of
from .long_flights import flight_of
from .received import received

# a track may start at any altitude: flights without a leakage calibration have no leakage
TRACKER = TrackerSettings(doppler=True, leakage_m=0.0)


@dataclass(frozen=True)
class Judged:
    """A method's tracked outputs of a flight, one per 40 ms, its results per frame, and its CPU time."""

    outputs: np.ndarray
    results: np.ndarray
    ms_per_frame: float


def judge(
    frames_of_flight: Iterable[tuple[np.ndarray, ...]], frames: int, chains: Sequence[Chain]
) -> dict[str, Judged]:
    """Tracked and per-frame altitudes of each chain from the same received frames."""
    altimeter = shared_altimeter(WAVEFORM, chains[0].settings)
    examine = FrameQuality(WAVEFORM, altimeter.settings.max_altitude_m)
    trackers = {chain: AltitudeTracker(altimeter, TRACKER) for chain in chains}
    outputs, results = {c: [] for c in chains}, {c: [] for c in chains}
    spent = dict.fromkeys(chains, 0.0)
    methods = {chain: method_of(chain, WAVEFORM) for chain in chains}
    for method in methods.values():
        method.reset()
    for index, samples, offset_s in frames_of_flight:
        quality = examine(samples)
        received = altimeter.spectra(samples, quality)
        for chain in chains:
            begin = time.thread_time()
            spectra = altimeter.spectra(methods[chain].process(samples, quality), quality)
            timing = {"frame_index": index, "timing_offset_s": offset_s}
            before = None if chain.method == "none" else received
            outputs[chain].append(trackers[chain].process(spectra, received=before, **timing))
            results[chain].append(altimeter.detect(spectra, **timing))
            spent[chain] += time.thread_time() - begin
    return {
        c.label: Judged(
            _complete(outputs[c], frames),
            np.concatenate([*results[c], np.empty(0, RESULT_DTYPE)]),
            1e3 * spent[c] / frames,
        )
        for c in chains
    }


def judge_long(
    case: Case, rng: np.random.Generator, frames: int, settings: AltimeterSettings
) -> tuple[Flight, Judged]:
    """A flight of the kinds `LONG` and its altitudes without mitigation, at the decimated rate; all of its CPU time.

    One frame of each block is measured alone.
    """
    begin, altimeter = time.thread_time(), shared_altimeter(WAVEFORM, settings)
    tracker, path, beats = (
        AltitudeTracker(altimeter, TRACKER),
        flight_of(case, frames, rng),
        beats_of(altimeter),
    )
    level = np.float32(10.0 ** (-case.snr_db / 20.0) / np.sqrt(2.0))
    outputs, alone, middle = [], [], []
    for block in range(frames // BLOCK):
        scatterers = path.scatterers(block)
        spectra = altimeter.of_beats(beats.returns(scatterers) + level * beats.noise(BLOCK, rng))
        outputs.append(tracker.process(spectra, frame_index=block * BLOCK + np.arange(BLOCK)))
        alone.append((spectra.power[BLOCK // 2], spectra.support[BLOCK // 2], spectra.scale[BLOCK // 2]))
        middle.append(scatterers.nearest_m)
    power, support, scale = map(np.array, zip(*alone, strict=True))
    index = BLOCK * np.arange(len(alone)) + BLOCK // 2
    results = altimeter.detect(Spectra(power, support, altimeter.beat_hz, scale), frame_index=index)
    true = np.concatenate(middle)
    step = np.gradient(true)
    ms = 1e3 * (time.thread_time() - begin) / frames
    flight = Flight(true, true + 0.5 * step, step / WAVEFORM.sweep_s)
    return flight, Judged(_complete(outputs, frames), results, ms)


def _complete(parts: list[np.ndarray], frames: int) -> np.ndarray:
    """An output per 40 ms; those after the last frame have status FAILURE."""
    out = np.zeros(frames // BLOCK, dtype=OUTPUT_DTYPE)
    out["frame_index"] = BLOCK * np.arange(1, out.size + 1) - 1
    out["status"] = Status.FAILURE
    for name in ("altitude_m", "vertical_speed_m_per_s", "protection_level_m", "age_s"):
        out[name] = np.nan
    given = np.concatenate([*parts, np.empty(0, OUTPUT_DTYPE)])
    out[given["frame_index"] // BLOCK] = given
    return out


@dataclass(frozen=True)
class IntegrityPoint(Point):
    """A flight through a case; ``part`` is its number among those of the same case."""

    case: str = ""
    part: int = 0


@dataclass(frozen=True)
class IntegrityStudy(ChainStudy):
    """The campaign."""

    methods: tuple[str, ...] = ("none", "whitening", "tcae", "hybrid")
    """The headline's method is `tcae`, or the last if `tcae` is not among them."""
    kinds: tuple[str, ...] = tuple(KINDS)  # names in `cases.KINDS`
    frames: int = 2000
    """Frames per flight, a multiple of 40; those of the kinds `LONG` have `LONGER` times as many."""
    hours: float = 0.0  # least flight hours in all; 0 flies every case once
    seed: int = 1
    allowed_m_per_s: float = 20.0  # vertical speed that altimeter and tracker allow; up to 10 m/s are flown
    pool: tuple[Path, ...] = ()  # rows of earlier flights with other seeds, which count in the rates per hour

    tables: ClassVar[Mapping[str, Columns]] = {"rows": ROWS}
    published: ClassVar[Mapping[str, str]] = {
        "report.md": "integrity.md",
        "cases.csv": "data/integrity.csv",
        "kinds.csv": "data/integrity_kinds.csv",
        "events.csv": "data/integrity_events.csv",
        "flights.csv": "data/integrity_flights.csv",
        "figures/integrity_stanford.png": "figures/integrity_stanford.png",
        "figures/integrity_sir.png": "figures/integrity_sir.png",
        "figures/integrity_land.png": "figures/integrity_land.png",
    }

    @property
    def settings(self) -> AltimeterSettings:
        """Settings of the altimeter behind every method."""
        return AltimeterSettings(max_altitude_m=1500.0, max_vertical_speed_m_per_s=self.allowed_m_per_s)

    @property
    def chains(self) -> tuple[Chain, ...]:
        """The methods, each with this altimeter."""
        return tuple(Chain(m, m, settings=self.settings) for m in self.methods)

    def head(self) -> dict[str, Any]:
        """See `Study`."""
        known = {name: value for name, value in super().head().items() if name not in ("hours", "pool")}
        return known | {"tracker": dataclasses.asdict(TRACKER)}

    def earlier(self) -> list[dict[str, Any]]:
        """Rows of the flights in `pool`; raises InputError, one line, where a file has other ones."""
        out = []
        for path in self.pool:
            for row in ROWS.read(path, "radalt integrity"):
                try:
                    whole = case_of(row["case"]).kind == row["kind"] and row["method"]
                    counts = ROWS.whole.intersection(ROWS.names) | (
                        {"altitude_m"} if row["kind"] in LONG else set()
                    )
                    whole = whole and all(row[name] >= 0 for name in counts)
                except (TypeError, ValueError):  # an empty cell, another case
                    whole = False
                if not whole:
                    raise InputError(
                        f"{path}: a row of case {row['case'][:60]!r} is not one of radalt integrity"
                    )
                out.append(row)
        return out

    def points(self) -> Sequence[IntegrityPoint]:
        """The first flight of every case, then the second, and so on; cases in an order that mixes the kinds."""
        known = [case for case in cases(self.kinds) if case.kind not in LONG or "none" in self.methods]
        known.sort(key=lambda case: zlib.crc32(case.name.encode()))
        out, left = [], 3600.0 * self.hours / self.waveform.sweep_s
        for part in itertools.count():
            for case in known:
                if (part or self.hours) and left <= 0:
                    return out
                frames = self.frames_of(case)
                out.append(IntegrityPoint(f"{case.name}:{part}", frames, case=case.name, part=part))
                left -= frames
            if not known:
                return out

    def frames_of(self, case: Case) -> int:
        """Frames of a flight."""
        return self.frames * (LONGER if case.kind in LONG else 1)

    def flown(self, case: Case, batch: int) -> tuple[Flight, dict[str, Judged]]:
        """One flight and what every method makes of it."""
        if case.kind in LONG:
            rng = rng_of(case, self.seed, batch, 0)
            flight, judged = judge_long(case, rng, self.frames_of(case), self.settings)
            return flight, {"none": judged}
        flight = fly(case, self.seed, batch, self.frames)
        return flight, judge(received(case, flight, self.seed, batch), self.frames, self.chains)

    def measure(self, point: Point) -> list[dict[str, Any]]:
        """A row per method."""
        case = case_of(point.case)
        flight, judged = self.flown(case, point.part)
        stated = vars(case) | {"case": case.name, "batch": point.part}
        return [stated | {"method": m} | _row(flight, j) for m, j in judged.items()]


def _row(flight: Flight, judged: Judged) -> dict[str, Any]:
    outputs, results = judged.outputs, judged.results
    truth = flight.end_m[outputs["frame_index"]]
    limit, sweep_s = _limit_m(outputs, truth), WAVEFORM.sweep_s
    alert = (
        np.nan
        if flight.fault_frame is None
        else time_to_alert_s(outputs, truth, limit, sweep_s, fault_frame=flight.fault_frame)
    )
    counts = stanford(outputs, truth, EDGES, limit)
    frames = score_frames(results, flight.middle_m[results["frame_index"]])
    return {
        **vars(integrity(outputs, truth, limit)),
        "altitude_m": float(np.mean(truth)),
        "misleading_events": _events_of(error_m(outputs, truth) > outputs["protection_level_m"]),
        "hazardous_events": _events_of(is_hazardous(outputs, truth, limit)),
        "largest_m": float(np.nanmax(error_m(outputs, truth), initial=0.0)),
        "first_s": time_to_first_s(outputs, sweep_s),
        "alert_s": alert,
        "unalerted": int(np.isinf(alert)),
        **{name: getattr(frames, name) for name in FRAMES},
        "events": _events(outputs, truth, limit),
        "stanford": " ".join(f"{i},{j},{counts[i, j]}" for i, j in np.argwhere(counts)),
        "ms_per_frame": judged.ms_per_frame,
    }


def _events_of(which: np.ndarray) -> int:
    """Runs of outputs of which something is true."""
    return int(np.count_nonzero(np.diff(which.astype(int), prepend=0) == 1))


def _limit_m(outputs: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(n,) alert limits; without a return that of the output's altitude, the only one that its user knows."""
    return alert_limit_m(np.where(np.isfinite(truth), truth, outputs["altitude_m"]))


def _events(outputs: np.ndarray, truth: np.ndarray, limit: np.ndarray) -> str:
    """Hazardous outputs as words: numbers joined by commas, with an empty truth if there is no return."""
    said = []
    for k in np.nonzero(is_hazardous(outputs, truth, limit))[0]:
        o = outputs[k]
        numbers = (o["altitude_m"], truth[k], o["protection_level_m"], limit[k])
        said.append(f"{o['frame_index']}," + ",".join(f"{x:.6g}" if np.isfinite(x) else "" for x in numbers))
    return " ".join(said)


def replay_lines(study: IntegrityStudy, case: Case, batch: int) -> list[str]:
    """A line for every output of one flight."""
    flight, judged = study.flown(case, batch)
    lines = []
    for method, j in judged.items():
        truth = flight.end_m[j.outputs["frame_index"]]
        hazardous = is_hazardous(j.outputs, truth, _limit_m(j.outputs, truth))
        error = error_m(j.outputs, truth)
        for k, o in enumerate(j.outputs):
            lines.append(
                f"{method:10} {o['frame_index']:6d} {Status.NAMES[o['status']]:16} altitude {o['altitude_m']:8.2f} "
                f"truth {truth[k]:8.2f} error {error[k]:7.2f} level {o['protection_level_m']:6.2f}"
                f"{'  HAZARDOUS' if hazardous[k] else ''}"
            )
    if flight.fault_frame is not None:
        lines.append(f"fault from frame {flight.fault_frame} on")
    return lines
