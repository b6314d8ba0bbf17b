"""FAA radio altimeter tolerance: the mask of 14 CFR 91.220(b) Table 1 as received interference.

91 FR 48656 (in force 2026-09-29) gives the power flux density in dBW/m^2/MHz that an altimeter has to
withstand from 0 to 500 ft. A receiving antenna of gain G collects

    PSD(f) = PFD(f) + G + 10 log10(lambda(f)^2 / 4 pi) - cable        [dBW/MHz]

at the receiver's input (`core/returns/link_budget.py`), weighted by the receiver's selectivity. All bands of the
table are taken as occupied at once, the worst case.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from scipy.constants import Boltzmann, foot

from ...returns.link_budget import diffuse_loop_loss_db, port_density_dbm_per_mhz
from ...returns.terrain.antenna import GaussianAntenna
from ...returns.terrain.ground import reflectivity
from ..receiver_filter import check_count, check_receiver, decimate_window, receiver_taps, window_guard
from . import NamedEmitter, register

# (from MHz, to MHz, dBW/m^2/MHz), 14 CFR 91.220(b) Table 1.
TABLE_1 = (
    (3000.0, 4150.0, 9.5),
    (4150.0, 4160.0, 6.5),
    (4160.0, 4170.0, -1.0),
    (4170.0, 4180.0, -7.0),
    (4180.0, 4190.0, -17.0),
    (4190.0, 4200.0, -34.0),
    (4200.0, 4400.0, -82.0),
    (4400.0, 4410.0, -33.0),
    (4410.0, 4430.0, -21.0),
    (4430.0, 4440.0, -8.0),
    (4440.0, 4450.0, -1.0),
    (4450.0, 4460.0, 6.5),
    (4460.0, 5600.0, 9.5),
)
BAND_HZ = (4.2e9, 4.4e9)  # radio altimeters, ITU Radio Regulations
MAX_ALTITUDE_FT = 500.0  # end of the range of Table 1
REFERENCE_TEMPERATURE_K = 290.0  # of noise figures, IEEE Std 145


def check_altitude_ft(altitude_ft: float) -> None:
    """Raise ValueError unless the table covers the altitude: 0..500 ft."""
    if not 0.0 <= altitude_ft <= MAX_ALTITUDE_FT:
        raise ValueError(
            f"faa_91_220.altitude_ft is {altitude_ft!r}; 14 CFR 91.220(b) Table 1 covers 0..500 ft only"
        )


def pfd_dbw_per_m2_mhz(frequency_hz: np.ndarray | float, altitude_ft: float = 200.0) -> np.ndarray:
    """Power flux density of Table 1 at `frequency_hz` (...), 3.0e9..5.6e9; an edge belongs to the band above.

    Returns dBW/m^2/MHz (...). Raises ValueError outside 0..500 ft or outside 3000..5600 MHz.
    """
    check_altitude_ft(altitude_ft)
    frequency = np.asarray(frequency_hz, dtype=float)
    if frequency.size and not (frequency.min() >= 3.0e9 and frequency.max() <= 5.6e9):
        raise ValueError(
            f"frequency_hz {frequency.min():g}..{frequency.max():g} leaves 3.0e9..5.6e9; Table 1 ends there"
        )
    starts_hz = np.array([row[0] for row in TABLE_1]) * 1e6
    levels = np.array([row[2] for row in TABLE_1])
    return levels[np.searchsorted(starts_hz, frequency, side="right") - 1]


@dataclass(frozen=True, kw_only=True)
class ButterworthFilter:
    """Band-pass selectivity |H|^2 = 1 / (1 + (2 (f - centre) / bandwidth)^(2 order)).

    Parameters
    ----------
    center_hz : middle of the pass band, > 0
    bandwidth_hz : between the 3 dB points, > 0
    order : of the low-pass prototype, 1..20
    """

    center_hz: float = 4.3e9
    bandwidth_hz: float = 7.5e6
    order: int = 5

    def __post_init__(self) -> None:
        if not (self.center_hz > 0 and self.bandwidth_hz > 0):
            raise ValueError(
                f"filter center_hz {self.center_hz!r} and bandwidth_hz {self.bandwidth_hz!r} must be above 0"
            )
        if not 1 <= self.order <= 20:
            raise ValueError(f"filter order is {self.order!r}; it has to be within 1..20")

    def power_gain(self, frequency_hz: np.ndarray) -> np.ndarray:
        """|H(f)|^2, same shape, 0..1."""
        offset = np.abs(np.asarray(frequency_hz) - self.center_hz) / (self.bandwidth_hz / 2)
        return 1.0 / (1.0 + offset ** (2 * self.order))


@dataclass(frozen=True, kw_only=True)
class AttenuationTable:
    """Selectivity from a data sheet: attenuation in dB >= 0 at rising frequencies in Hz, linear in between.

    The first and last attenuation hold beyond the ends.
    """

    frequencies_hz: tuple[float, ...]
    attenuations_db: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.frequencies_hz) != len(self.attenuations_db) or len(self.frequencies_hz) < 2:
            raise ValueError(
                f"filter table has {len(self.frequencies_hz)} frequencies and {len(self.attenuations_db)} "
                "attenuations; give equally many, at least 2"
            )
        if np.any(np.diff(self.frequencies_hz) <= 0):
            raise ValueError(f"filter frequencies_hz {self.frequencies_hz} do not rise; sort them")
        if min(self.attenuations_db) < 0:
            raise ValueError(f"filter attenuations_db {self.attenuations_db} hold a gain; give dB >= 0")

    def power_gain(self, frequency_hz: np.ndarray) -> np.ndarray:
        """|H(f)|^2, same shape, 0..1."""
        return 10.0 ** (-np.interp(frequency_hz, self.frequencies_hz, self.attenuations_db) / 10.0)


@dataclass(frozen=True)
class BandReport:
    """One row of the table as received; all powers in dBm."""

    low_hz: float
    high_hz: float
    pfd_dbw_per_m2_mhz: float
    at_antenna_dbm: float
    after_filter_dbm: float


@dataclass(frozen=True)
class FaaReport:
    """Received powers under the mask in dBm, ratios in dB; `sir_db` before any compression."""

    altitude_ft: float
    range_m: float
    in_band_dbm: float
    out_of_band_dbm: float
    total_dbm: float
    out_of_band_at_antenna_dbm: float
    noise_dbm: float
    return_dbm: float
    i_over_n_db: float
    sir_db: float
    snr_db: float
    bands: tuple[BandReport, ...]


def _db(power: float) -> float:
    return 10.0 * math.log10(power) if power > 0 else -math.inf


@register
@dataclass(frozen=True, kw_only=True)
class FaaMask(NamedEmitter):
    """Interference at the level of 14 CFR 91.220(b) Table 1: link budget and emitter (emitter protocol).

    `samples` gives Gaussian noise of mean power 1, flat over the receiver's band as the table is over 4200-4400 MHz;
    place it at `report().sir_db` to put the radar in the field strength of the table.

    Parameters
    ----------
    altitude_ft : 0..500, the range for which the table is defined; its levels do not change within it
    antenna_gain_dbi : gain of the altimeter's antennas (transmit = receive), also taken out of band
    receiver_filter : all selectivity before the interference meets the beat signal, `ButterworthFilter` or
        `AttenuationTable`; what it lets through from outside 4200-4400 MHz counts as interference
    center_hz : radar centre frequency, in 4.2e9..4.4e9
    noise_figure_db : 0..30; 8 dB as quoted for the first altimeter of ITU-R M.2059 Table 2
    tx_power_w : transmit power of the return's budget, > 0; 0.4 W of the same altimeter
    losses_db : cables, both ways together, 0..60; interference passes the receiver's half. Assumed
    sigma0_db : reflectivity of the ground at nadir (m^2/m^2 in dB), falling with incidence as `Morchin`'s built-up land
        does; no measured value was found, so it is to be swept
    beamwidth_deg : full beam of one antenna between its -3 dB points, 1..120
    antenna_height_m : antenna above the wheels, > 0: the range at 0 ft
    receiver_bandwidth_hz : flat bandwidth of `samples`; None is 0.9 of the rate

    Raises
    ------
    ValueError
        One line with the value, the limit and the remedy.

    Example
    -------
    >>> report = FaaMask(altitude_ft=200.0).report()
    >>> round(report.in_band_dbm, 1)
    -70.3
    """

    scene_name: ClassVar[str] = "faa_91_220"

    altitude_ft: float = 200.0
    antenna_gain_dbi: float = 10.0
    receiver_filter: ButterworthFilter | AttenuationTable = field(default_factory=ButterworthFilter)
    center_hz: float = 4.3e9
    noise_figure_db: float = 8.0
    tx_power_w: float = 0.4
    losses_db: float = 6.0
    sigma0_db: float = 10.5
    beamwidth_deg: float = 40.0
    antenna_height_m: float = 2.0
    receiver_bandwidth_hz: float | None = None

    def __post_init__(self) -> None:
        check_altitude_ft(self.altitude_ft)
        limits = {
            "antenna_gain_dbi": (-20.0, 40.0),
            "center_hz": BAND_HZ,
            "noise_figure_db": (0.0, 30.0),
            "tx_power_w": (1e-6, 1e3),
            "losses_db": (0.0, 60.0),
            "sigma0_db": (-60.0, 40.0),
            "beamwidth_deg": (1.0, 120.0),
            "antenna_height_m": (0.1, 20.0),
        }
        for name, (low, high) in limits.items():
            if not low <= getattr(self, name) <= high:
                raise ValueError(
                    f"faa_91_220.{name} is {getattr(self, name)!r}; it has to be within {low:g}..{high:g}"
                )

    def title(self, band_hz: float) -> str:
        """See `NamedEmitter.title`."""
        return "14 CFR 91.220(b) mask"

    @property
    def stated_sir_db(self) -> float:
        """SIR by the link budget, in decibels: the table states its level."""
        return float(self.report().sir_db)

    def notes(self, rate_hz: float) -> tuple[str, ...]:
        """The link budget in one line: powers, I/N and SIR."""
        r = self.report()
        return (
            f"{self.scene_name}: interference {r.total_dbm:.1f} dBm (in band {r.in_band_dbm:.1f}, "
            f"out of band {r.out_of_band_dbm:.1f} after the receiver's filter), noise {r.noise_dbm:.1f} dBm, "
            f"return {r.return_dbm:.1f} dBm: I/N {r.i_over_n_db:+.1f} dB, SIR {r.sir_db:+.1f} dB, "
            f"SNR {r.snr_db:+.1f} dB",
        )

    def samples(self, count: int, rate_hz: float, rng: np.random.Generator) -> np.ndarray:
        """(count,) complex128 Gaussian noise at `rate_hz`, mean power 1, limited to the receiver's band."""
        count = check_count(count)
        bandwidth_hz = check_receiver(rate_hz, self.receiver_bandwidth_hz)
        return band_limited_noise(count, rate_hz, bandwidth_hz, rng)

    def power_densities_w(self, frequency_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Received W/Hz before and after the filter at `frequency_hz` (...)."""
        unit_db = port_density_dbm_per_mhz(
            0.0, frequency_hz=self.center_hz, gain_dbi=self.antenna_gain_dbi, cable_db=0.5 * self.losses_db
        )
        level_db = pfd_dbw_per_m2_mhz(frequency_hz, self.altitude_ft) + unit_db - 90.0  # of W/Hz
        density = 10.0 ** (level_db / 10.0) * (self.center_hz / frequency_hz) ** 2
        return density, density * self.receiver_filter.power_gain(frequency_hz)

    def return_power_w(self) -> float:
        """Return of level, diffuse ground in watts: the same budget as `RadarLink`'s over terrain."""
        ground = reflectivity()
        nadir_db = 10.0 * math.log10(float(ground.sigma0(np.array(0.0), self.center_hz)))
        loss_db = diffuse_loop_loss_db(
            self.range_m,
            antenna=GaussianAntenna(self.beamwidth_deg, self.antenna_gain_dbi),
            ground=reflectivity(level_db=self.sigma0_db - nadir_db),
            carrier_hz=self.center_hz,
            losses_db=self.losses_db,
        )
        return self.tx_power_w * 10.0 ** (-loss_db / 10.0)

    @property
    def range_m(self) -> float:
        """Altitude of the wheels plus the height of the antenna above them, in metres."""
        return self.altitude_ft * foot + self.antenna_height_m

    def report(self) -> FaaReport:
        """Received powers by band, in-band and out-of-band totals, I/N and SIR.

        The filter's noise bandwidth over 4200-4400 MHz sets the thermal noise k T0 B F, so that I/N compares
        like with like.
        """
        watts = []
        for low_mhz, high_mhz, _ in TABLE_1:
            grid_hz, step_hz = _midpoints(low_mhz * 1e6, high_mhz * 1e6)
            before, after = self.power_densities_w(grid_hz)
            watts.append((before.sum() * step_hz, after.sum() * step_hz))
        bands = tuple(
            BandReport(low * 1e6, high * 1e6, level, _db(before) + 30.0, _db(after) + 30.0)
            for (low, high, level), (before, after) in zip(TABLE_1, watts, strict=True)
        )
        inside = [low * 1e6 >= BAND_HZ[0] and high * 1e6 <= BAND_HZ[1] for low, high, _ in TABLE_1]
        in_band = sum(after for (_, after), here in zip(watts, inside, strict=True) if here)
        out_of_band = sum(after for (_, after), here in zip(watts, inside, strict=True) if not here)
        out_at_antenna = sum(before for (before, _), here in zip(watts, inside, strict=True) if not here)
        grid_hz, step_hz = _midpoints(*BAND_HZ)
        noise_bandwidth_hz = float(self.receiver_filter.power_gain(grid_hz).sum() * step_hz)
        noise = (
            Boltzmann * REFERENCE_TEMPERATURE_K * noise_bandwidth_hz * 10.0 ** (self.noise_figure_db / 10.0)
        )
        received = self.return_power_w()
        total = in_band + out_of_band
        return FaaReport(
            altitude_ft=self.altitude_ft,
            range_m=self.range_m,
            in_band_dbm=_db(in_band) + 30.0,
            out_of_band_dbm=_db(out_of_band) + 30.0,
            total_dbm=_db(total) + 30.0,
            out_of_band_at_antenna_dbm=_db(out_at_antenna) + 30.0,
            noise_dbm=_db(noise) + 30.0,
            return_dbm=_db(received) + 30.0,
            i_over_n_db=_db(total) - _db(noise),
            sir_db=_db(received) - _db(total),
            snr_db=_db(received) - _db(noise),
            bands=bands,
        )


def _midpoints(low_hz: float, high_hz: float, step_hz: float = 10e3) -> tuple[np.ndarray, float]:
    """Midpoint rule over a band that is a whole number of steps; 10 kHz resolves filters from 0.1 MHz on."""
    count = round((high_hz - low_hz) / step_hz)
    return low_hz + (np.arange(count) + 0.5) * step_hz, step_hz


def band_limited_noise(
    count: int, rate_hz: float, bandwidth_hz: float, rng: np.random.Generator
) -> np.ndarray:
    """Complex white Gaussian noise through the receiver's filter: (count,) complex128, mean power 1.

    `bandwidth_hz` is the flat two-sided width, 0 < bandwidth_hz <= 0.98 rate_hz.
    """
    guard = window_guard(rate_hz, 1, bandwidth_hz)
    size = count + 2 * guard
    white = rng.standard_normal(size) + 1j * rng.standard_normal(size)
    # Noise bandwidth of the filter over the rate is the sum of its squared taps: no need to measure it.
    return decimate_window(white, rate_hz, 1, bandwidth_hz) / np.sqrt(
        2.0 * filter_energy(rate_hz, bandwidth_hz)
    )


def filter_energy(rate_hz: float, bandwidth_hz: float) -> float:
    """Sum of the squared taps of the receiver's filter: its mean output power for white input of unit power."""
    return float(np.sum(receiver_taps(rate_hz, rate_hz / 2, bandwidth_hz) ** 2))
