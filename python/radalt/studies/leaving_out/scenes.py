"""Scenes of the study of leaving out."""

from typing import Any

from ...core.scene import Scene, parse_scene

_ALTITUDES = [1200.0, 600.0, 150.0, 30.0]
_QPSK = {"qpsk": {"sir_db": -20.0, "overlap": 0.5, "evm": "typical"}}
SCENES: dict[str, dict[str, Any]] = {
    "no interference, no mitigation": {"methods": ["none"]},
    "the same below 150 m": {"methods": ["none"], "altitude": {"programme_m": [150.0, 100.0, 50.0, 10.0]}},
    "no interference, whitening": {"methods": ["none", "whitening"]},
    "QPSK, whitening": {"methods": ["none", "whitening"], "interference": _QPSK},
    "QPSK, whitening and tcae": {"methods": ["none", "whitening", "tcae"], "interference": _QPSK},
}
# further paths through the channel, on which tests show that leaving out changes no bit; not in the table
CHECKED: dict[str, dict[str, Any]] = {
    "LMS with the reference as input, and NLMS": {
        "methods": ["lms_reference_input", "nlms"],
        "interference": _QPSK,
    },
    "true delay and Doppler, whitening": {
        "methods": ["none", "whitening"],
        "altitude": {"mode": "true_delay", "vertical_speed_m_per_s": -40.0},
    },
    "landing, extended ground, NLMS": {
        "methods": ["none", "nlms"],
        "landing": {},
        "return": "terrain",
        "altitude": {"frames": 1, "landing_frames": 6},
    },
}


def scene_of(name: str, frames: int) -> Scene:
    """A scene by its name, with ``frames`` at each altitude; a landing has its own number of frames."""
    data = dict((SCENES | CHECKED)[name])
    programme = {} if "landing" in data else {"programme_m": _ALTITUDES, "frames": frames}
    altitude = programme | data.pop("altitude", {})
    return parse_scene(data | {"altitude": altitude, "seed": 5})
