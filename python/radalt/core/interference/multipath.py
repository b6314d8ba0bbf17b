"""Multipath: tapped-delay-line channels by name, for interference and for the radar's return.

Profiles: TDL-A..E of 3GPP TR 38.901 (Tables 7.7.2-1 to -5, delays normalised to a delay spread). With fixed delays:
EPA, EVA, ETU of 3GPP TS 36.104 Annex B.2, PA (Pedestrian A) of ITU-R M.1225 Table 3, and RA4 (rural area, four paths,
all Rayleigh here) of 3GPP TS 45.005 Annex C.3.1. Mean channel power is 1 over the ensemble of draws.
"""

from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from ..parsing import Settings, setting
from ..waveform import exp_cycles

_LOS_DOPPLER = 0.7  # Doppler of the line of sight over the maximum, TR 38.901 clause 7.7.2
_WAVES = 32  # plane waves per tap: with Gaussian weights, the tap is exactly Gaussian for any number


@dataclass(frozen=True)
class Profile:
    """A tapped delay line.

    `delays` are in seconds, or in units of the delay spread if `normalised`; `powers_db` are relative mean powers of
    the same length. `los_db`, if given, is the power of a non-fading line of sight at delay 0 on the same scale.
    """

    delays: tuple[float, ...]
    powers_db: tuple[float, ...]
    los_db: float | None = None
    normalised: bool = True


def _tdl(rows: str, los_db: float | None = None) -> Profile:
    pairs = [tuple(map(float, row.split())) for row in rows.split(",")]
    return Profile(tuple(p[0] for p in pairs), tuple(p[1] for p in pairs), los_db)


def _lte(delays_ns: tuple[float, ...], powers_db: tuple[float, ...]) -> Profile:
    return Profile(tuple(d * 1e-9 for d in delays_ns), powers_db, normalised=False)


PROFILES = MappingProxyType(
    {
        "TDL-A": _tdl(
            "0 -13.4, 0.3819 0, 0.4025 -2.2, 0.5868 -4, 0.4610 -6, 0.5375 -8.2, 0.6708 -9.9, 0.5750 -10.5,"
            "0.7618 -7.5, 1.5375 -15.9, 1.8978 -6.6, 2.2242 -16.7, 2.1718 -12.4, 2.4942 -15.2, 2.5119 -10.8,"
            "3.0582 -11.3, 4.0810 -12.7, 4.4579 -16.2, 4.5695 -18.3, 4.7966 -18.9, 5.0066 -16.6,"
            "5.3043 -19.9, 9.6586 -29.7"
        ),
        "TDL-B": _tdl(
            "0 0, 0.1072 -2.2, 0.2155 -4, 0.2095 -3.2, 0.2870 -9.8, 0.2986 -1.2, 0.3752 -3.4, 0.5055 -5.2,"
            "0.3681 -7.6, 0.3697 -3, 0.5700 -8.9, 0.5283 -9, 1.1021 -4.8, 1.2756 -5.7, 1.5474 -7.5,"
            "1.7842 -1.9, 2.0169 -7.6, 2.8294 -12.2, 3.0219 -9.8, 3.6187 -11.4, 4.1067 -14.9,"
            "4.2790 -9.2, 4.7834 -11.3"
        ),
        "TDL-C": _tdl(
            "0 -4.4, 0.2099 -1.2, 0.2219 -3.5, 0.2329 -5.2, 0.2176 -2.5, 0.6366 0, 0.6448 -2.2, 0.6560 -3.9,"
            "0.6584 -7.4, 0.7935 -7.1, 0.8213 -10.7, 0.9336 -11.1, 1.2285 -5.1, 1.3083 -6.8, 2.1704 -8.7,"
            "2.7105 -13.2, 4.2589 -13.9, 4.6003 -13.9, 5.4902 -15.8, 5.6077 -17.1, 6.3065 -16, 6.6374 -15.7,"
            "7.0427 -21.6, 8.6523 -22.8"
        ),
        "TDL-D": _tdl(
            "0 -13.5, 0.035 -18.8, 0.612 -21, 1.363 -22.8, 1.405 -17.9, 1.804 -20.1, 2.596 -21.9, "
            "1.775 -22.9, 4.042 -27.8, 7.937 -23.6, 9.424 -24.8, 9.708 -30, 12.525 -27.7",
            los_db=-0.2,
        ),
        "TDL-E": _tdl(
            "0 -22.03, 0.5133 -15.8, 0.5440 -18.1, 0.5630 -19.8, 0.5440 -22.9, 0.7112 -22.4, 1.9092 -18.6,"
            "1.9293 -20.8, 1.9589 -22.6, 2.6426 -22.3, 3.7136 -25.6, 5.4524 -20.2, "
            "12.0034 -29.8, 20.6519 -29.2",
            los_db=-0.03,
        ),
        "EPA": _lte((0, 30, 70, 90, 110, 190, 410), (0.0, -1.0, -2.0, -3.0, -8.0, -17.2, -20.8)),
        "EVA": _lte(
            (0, 30, 150, 310, 370, 710, 1090, 1730, 2510),
            (0.0, -1.5, -1.4, -3.6, -0.6, -9.1, -7.0, -12.0, -16.9),
        ),
        "ETU": _lte(
            (0, 50, 120, 200, 230, 500, 1600, 2300, 5000), (-1.0, -1.0, -1.0, 0.0, 0.0, 0.0, -3.0, -5.0, -7.0)
        ),
        "PA": _lte((0, 110, 190, 410), (0.0, -9.7, -19.2, -22.8)),
        "RA4": _lte((0, 200, 400, 600), (0.0, -2.0, -10.0, -20.0)),
    }
)


@dataclass(frozen=True, kw_only=True)
class FadingChannel(Settings, where="fading"):
    """Random multipath channel; `draw` gives one of its draws, which is defined at any time.

    y(t) = sum_i g_i(t) x(t - tau_i), g_i complex Gaussian (Rayleigh) with the profile's powers, plus a constant line of
    sight where the profile has one (Rice). With Doppler each g_i has Clarke's spectrum, with the autocorrelation J0(2
    pi f_D t); the line of sight then moves at 0.7 f_D (TR 38.901 clause 7.7.2).

    >>> FadingChannel(profile="TDL-C").draw(np.random.default_rng(1)).gains(np.arange(4) * 1e-3).shape
    (4, 24)
    """

    profile: str = "TDL-C"
    """'TDL-A' .. 'TDL-E', 'EPA', 'EVA', 'ETU', 'PA' or 'RA4'."""
    delay_spread_s: float = setting(100e-9, 0.0, 1e-5)
    """RMS delay spread that scales TDL profiles, 0..1e-5 (TR 38.901 Table 7.7.3-1: 10 ns very short, 30 short, 100
    nominal, 300 long, 1000 very long); not used by the others."""
    doppler_hz: float = setting(0.0, 0.0, 5e4)
    """Maximum Doppler f_D; 0 keeps a channel fixed within a frame."""
    _taps: tuple = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.profile not in PROFILES:
            raise ValueError(
                f"fading.profile {self.profile!r} is unknown; choose one of {', '.join(PROFILES)}"
            )
        profile = PROFILES[self.profile]
        scale = self.delay_spread_s if profile.normalised else 1.0
        power = 10.0 ** (np.array(profile.powers_db) / 10.0)
        los = 0.0 if profile.los_db is None else 10.0 ** (profile.los_db / 10.0)
        total = power.sum() + los
        object.__setattr__(self, "_taps", (np.array(profile.delays) * scale, power / total, los / total))

    @property
    def delays_s(self) -> np.ndarray:
        """(taps,) delays in seconds."""
        return self._taps[0]

    @property
    def powers(self) -> np.ndarray:
        """(taps,) mean powers of the Rayleigh parts; with `los_power` they sum to 1."""
        return self._taps[1]

    @property
    def los_power(self) -> float:
        """Power of the line of sight at delay 0."""
        return float(self._taps[2])

    def draw(self, rng: np.random.Generator) -> "Paths":
        """One draw of the channel; its gains are defined at any time."""
        waves = _WAVES if self.doppler_hz else 1
        shape = (self.powers.size, waves)
        weights = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2.0)
        weights *= np.sqrt(self.powers / waves)[:, None]
        wave_hz = self.doppler_hz * np.cos(2 * np.pi * rng.random(shape))
        sight = np.sqrt(self.los_power) * np.exp(2j * np.pi * rng.random())
        return Paths(weights, wave_hz, sight, _LOS_DOPPLER * self.doppler_hz)


@dataclass(frozen=True)
class Paths:
    """A draw of a `FadingChannel`: each tap is a sum of plane waves, ``weights`` (taps, waves) at ``wave_hz``.

    ``sight`` is the line of sight's complex amplitude, at ``sight_hz``, in tap 0.
    """

    weights: np.ndarray
    wave_hz: np.ndarray
    sight: complex
    sight_hz: float

    def gains(self, seconds: np.ndarray) -> np.ndarray:
        """(n, taps) complex128 gains at (n,) times, any time."""
        cycles = seconds[:, None, None] * self.wave_hz
        waves = exp_cycles((cycles - np.rint(cycles)).astype(np.float32))
        gains = np.einsum("ntw,tw->nt", waves, self.weights)
        gains[:, 0] += self.sight * exp_cycles(seconds * self.sight_hz, np.complex128)
        return gains
