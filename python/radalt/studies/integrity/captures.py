"""SigMF recordings of what was received before a hazardous output."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...core.radio.recording import Stretch, write_metadata
from ...core.receiver.altimeter import AltimeterSettings
from ...core.returns.point import point_return
from ...core.scene import AltitudeSpec, Scene, load_scene
from .cases import WAVEFORM, Case, case_of
from .flights import fly
from .received import received
from .study import IntegrityStudy

_BEFORE = 400  # frames kept up to the event: ten outputs
_PREAMBLE = 8  # frames at altitude zero, on which a replay takes its timing


def write_capture(study: IntegrityStudy, event: Mapping[str, Any], folder: Path) -> Path:
    """Write the frames up to a hazardous output behind a clean preamble; returns the path of the metadata.

    Frames are those that the methods got, aligned by the segmenter, with gaps for missing ones.
    """
    case, last = case_of(event["case"]), event["frame_index"]
    first, n = max(0, last + 1 - _BEFORE), WAVEFORM.samples_per_frame
    flight = fly(case, study.seed, event["batch"], study.frames)
    folder.mkdir(parents=True, exist_ok=True)
    name = f"{case.name}_{study.seed}_{event['batch']}".replace("/", "_")
    data = folder / f"{name}.sigmf-data"
    stretches, start = [Stretch(0, 0, _PREAMBLE * n)], _PREAMBLE * n
    with data.open("wb") as file:
        point_return(WAVEFORM, np.zeros(_PREAMBLE)).tofile(file)
        for index, frames, _ in received(case, flight, study.seed, event["batch"]):
            for k, frame in zip(index, frames, strict=True):
                if first <= k <= last:
                    frame.tofile(file)
                    stretches.append(Stretch(start, int(_PREAMBLE + k - first) * n, n))
                    start += n
            if index[-1] > last:
                break
    altitude_m = np.nan_to_num(flight.middle_m[first : last + 1])
    scene = _scene(case, study.settings, altitude_m, flight.speed_m_per_s[first])
    return write_metadata(data, scene, _joined(stretches), latency_samples=0.0, recorder="integrity.py")


def _joined(stretches: list[Stretch]) -> list[Stretch]:
    out = stretches[:1]
    for s in stretches[1:]:
        before = out[-1]
        if before.global_index + before.count == s.global_index:
            out[-1] = dataclasses.replace(before, count=before.count + s.count)
        else:
            out.append(s)
    return out


def _scene(case: Case, settings: AltimeterSettings, altitude_m: np.ndarray, speed_m_per_s: float) -> Scene:
    """The scene flown, an altitude per frame, zero without a return."""
    flown = AltitudeSpec(
        programme_m=tuple(float(a) for a in altitude_m),
        frames=1,
        mode="true_delay",
        vertical_speed_m_per_s=float(speed_m_per_s),
        preamble_frames=_PREAMBLE,
    )
    shipped = case.scene and case.kind != "gnuradio"  # whose emitters are no scene
    scene = load_scene(case.scene).at(overlap=case.overlap, sir_db=case.sir_db) if shipped else Scene()
    text = f"{case.kind}: {case.name}" + ("" if case.ground else ", without a return")
    return dataclasses.replace(
        scene, name="integrity", description=text, altitude=flown, altimeter=settings, landing=None
    )
