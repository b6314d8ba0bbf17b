"""Power levels of the two radios: at the transmitters, at the receiver, and the digital drive for an SIR.

The model is an upper bound for the interlock, not for metrology: a radio transmits at most its `Device`'s
``max_tx_dbm`` at its highest transmit gain, every decibel of gain is a decibel of power, and a full-scale tone is the
strongest signal.
"""

from dataclasses import dataclass

import numpy as np

from ..interference.stream import JammerStream
from ..scene import RadioSpec, Scene

# largest sample over the converter's full scale: interpolation filters overshoot by up to 3 dB
_HEADROOM = 0.7
_CREST_MARGIN = 1.25  # margin on the largest rail in `_CREST_FRAMES` frames: longer runs have larger peaks
# frames in which the jammer's peak and power are measured: 180,000 samples at the default rate
_CREST_FRAMES = 24


def rx_level_dbm(radio: RadioSpec, jammer: bool, attenuation_db: float | None = None) -> float:
    """Highest power at the receiver's connector: both transmitters at full scale, less the stated attenuation.

    ``radio``: device, transmit gains and ``attenuation_db`` from each transmitter to the receiver; ``jammer``:
    whether the second transmitter exists; ``attenuation_db``: to another input.
    """
    loss_db = radio.attenuation_db if attenuation_db is None else attenuation_db
    gains = [radio.radar_tx_gain_db] + ([radio.jammer_tx_gain_db] if jammer else [])
    milliwatts = sum(10.0 ** ((radio.limits.tx_power_dbm(g) - loss_db) / 10.0) for g in gains)
    return float(10.0 * np.log10(milliwatts))


@dataclass(frozen=True)
class Drive:
    """Sample value at each converter's full scale, and mean power at each connector by the model; NaN: no jammer."""

    radar_full_scale: float
    jammer_full_scale: float
    radar_dbm: float
    jammer_dbm: float


def drive(scene: Scene) -> Drive:
    """Scale both transmitters together so that neither clips and the SIR at the receiver is the scene's.

    The blocks generate a radar of unit amplitude and a jammer at the SIR relative to it. The jammer's digital scale
    compensates a difference of transmit gains: ``F_j = F_r 10^((g_j - g_r)/20)``. Equal path losses from both
    transmitters are assumed.
    """
    radio = scene.radio
    tx_power_dbm = radio.limits.tx_power_dbm
    radar = 1.0 / _HEADROOM
    if not scene.has_jammer:
        full_dbm = tx_power_dbm(radio.radar_tx_gain_db)
        return Drive(radar, radar, full_dbm - 20.0 * np.log10(radar), float("nan"))
    peak, power = _jammer_peak_and_power(scene)
    difference = 10.0 ** ((radio.jammer_tx_gain_db - radio.radar_tx_gain_db) / 20.0)
    radar = max(radar, peak / _HEADROOM / difference)
    jammer = radar * difference
    with np.errstate(divide="ignore"):
        radar_dbm = tx_power_dbm(radio.radar_tx_gain_db) - 20.0 * np.log10(radar)
        jammer_dbm = tx_power_dbm(radio.jammer_tx_gain_db) + 10.0 * np.log10(power) - 20.0 * np.log10(jammer)
    return Drive(float(radar), float(jammer), float(radar_dbm), float(jammer_dbm))


def radar_stream_args(scene: Scene) -> str:
    """UHD stream arguments of the radar's transmitter."""
    return f"fullscale={drive(scene).radar_full_scale:.6g}"


def jammer_stream_args(scene: Scene) -> str:
    """UHD stream arguments of the jammer's transmitter."""
    return f"fullscale={drive(scene).jammer_full_scale:.6g}"


def _jammer_peak_and_power(scene: Scene) -> tuple[float, float]:
    """Largest rail, with margin, and mean power of the jammer over `_CREST_FRAMES` frames of the scene's seed."""
    stream = JammerStream(
        scene.waveform, scene.interference, seed=scene.seed, total_sir_db=scene.total_sir_db
    )
    frames = np.concatenate([stream.next_frame() for _ in range(_CREST_FRAMES)])
    peak = float(np.abs(frames.view(np.float32)).max())
    return _CREST_MARGIN * peak, float(np.mean(np.abs(frames) ** 2))
