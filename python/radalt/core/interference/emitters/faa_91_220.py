"""FAA radio altimeter tolerance: the mask of 14 CFR 91.220(b) Table 1 as received interference.

91 FR 48656 (in force 2026-09-29; read in a page that quotes it) gives the power flux density in dBW/m^2/MHz that an
altimeter has to withstand from 0 to 500 ft. A receiving antenna of gain G collects

    PSD(f) = PFD(f) + G + 10 log10(lambda(f)^2 / 4 pi) - cable        [dBW/MHz]

at the receiver's input (`core/returns/link_budget.py`), weighted by the receiver's selectivity. All bands of the
table are taken as occupied at once, the worst case.
"""

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from scipy.constants import Boltzmann, foot

from ...parsing import LARGEST, Settings, setting
from ...returns.link_budget import diffuse_loop_loss_db, port_density_dbm_per_mhz
from ...returns.terrain.antenna import GaussianAntenna
from ...returns.terrain.ground import reflectivity
from ..receiver_filter import decimate_window, window_guard, window_taps
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
REFERENCE_TEMPERATURE_K = 290.0  # reference temperature of noise figures, IEEE Std 145


def pfd_dbw_per_m2_mhz(frequency_hz: np.ndarray | float) -> np.ndarray:
    """Power flux density of Table 1 at `frequency_hz` (...), 3.0e9..5.6e9; an edge has the lower of its two levels.

    Returns dBW/m^2/MHz (...), the same from 0 to 500 ft. Raises ValueError outside 3000..5600 MHz.
    """
    frequency = np.asarray(frequency_hz, dtype=float)
    if frequency.size and not (frequency.min() >= 3.0e9 and frequency.max() <= 5.6e9):
        raise ValueError(
            f"frequency_hz {frequency.min():g}..{frequency.max():g} leaves 3.0e9..5.6e9; Table 1 ends there"
        )
    starts_hz = np.array([row[0] for row in TABLE_1]) * 1e6
    levels = np.array([row[2] for row in TABLE_1])
    above, below = (np.searchsorted(starts_hz, frequency, side=side) - 1 for side in ("right", "left"))
    return np.minimum(levels[above], levels[np.maximum(below, 0)])


@dataclass(frozen=True, kw_only=True)
class ButterworthFilter(Settings, where="filter"):
    """Band-pass selectivity |H|^2 = 1 / (1 + (2 (f - centre) / bandwidth)^(2 order))."""

    center_hz: float = setting(4.3e9, 1e8, 1e12)
    """Middle of the pass band."""
    bandwidth_hz: float = setting(7.5e6, 1e5, LARGEST)
    """Width between the 3 dB points."""
    order: int = setting(5, 1, 20)
    """Order of the low-pass prototype."""

    def power_gain(self, frequency_hz: np.ndarray) -> np.ndarray:
        """|H(f)|^2, same shape, 0..1."""
        offset = np.abs(np.asarray(frequency_hz) - self.center_hz) / (self.bandwidth_hz / 2)
        return 1.0 / (1.0 + offset ** (2 * self.order))


@dataclass(frozen=True)
class FaaReport:
    """Received powers under the mask in dBm, behind the filter; ratios in dB, before any compression."""

    in_band_dbm: float
    out_of_band_dbm: float
    total_dbm: float
    noise_dbm: float
    return_dbm: float
    i_over_n_db: float
    sir_db: float
    snr_db: float


def _db(power: float) -> float:
    return 10.0 * math.log10(power) if power > 0 else -math.inf


@register
@dataclass(frozen=True, kw_only=True)
class FaaMask(NamedEmitter):
    """Interference at the level of 14 CFR 91.220(b) Table 1: link budget and emitter (emitter protocol).

    `samples` gives Gaussian noise of mean power 1, flat over the receiver's band as the table is over 4200-4400 MHz;
    place it at `report().sir_db` to put the radar in the field strength of the table.

    >>> round(FaaMask(altitude_ft=200.0).report().in_band_dbm, 1)
    -70.3
    """

    scene_name: ClassVar[str] = "faa_91_220"

    altitude_ft: float = setting(200.0, 0.0, MAX_ALTITUDE_FT)
    """Altitude, 0..500, the range for which the table is defined; its levels do not change within it."""
    antenna_gain_dbi: float = setting(10.0, -20.0, 40.0)
    """Gain of the altimeter's antennas (transmit = receive), also taken out of band."""
    receiver_filter: ButterworthFilter = field(default_factory=ButterworthFilter)
    """All selectivity before the interference meets the beat signal, `ButterworthFilter`; what it lets through from
    outside 4200-4400 MHz counts as interference."""
    center_hz: float = setting(4.3e9, *BAND_HZ)
    """Radar centre frequency, in 4.2e9..4.4e9."""
    noise_figure_db: float = setting(8.0, 0.0, 30.0)
    """Noise figure; 8 dB as quoted for the first altimeter of ITU-R M.2059 Table 2."""
    tx_power_w: float = setting(0.4, 1e-6, 1e3)
    """Transmit power of the return's budget; 0.4 W of the same altimeter."""
    losses_db: float = setting(6.0, 0.0, 60.0)
    """Cables, both ways together; interference passes the receiver's half. Assumed."""
    sigma0_db: float = setting(10.5, -60.0, 40.0)
    """Reflectivity of the ground at nadir (m^2/m^2 in dB), falling with incidence as `Morchin`'s built-up land does;
    no measured value was found, so it is to be swept."""
    beamwidth_deg: float = setting(40.0, 1.0, 120.0)
    """Full beam of one antenna between its -3 dB points."""
    antenna_height_m: float = setting(2.0, 0.1, 20.0)
    """Antenna above the wheels: the range at 0 ft."""

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
        size = count + 2 * window_guard(rate_hz, 1)
        white = rng.standard_normal(size) + 1j * rng.standard_normal(size)
        # the mean output power of a filter for white input of unit power is the sum of its squared taps
        energy = float(np.sum(window_taps(rate_hz, 1) ** 2))
        return decimate_window(white, rate_hz, 1) / np.sqrt(2.0 * energy)

    def power_density_w_per_hz(self, frequency_hz: np.ndarray) -> np.ndarray:
        """Received power density behind the filter at `frequency_hz` (...)."""
        unit_db = port_density_dbm_per_mhz(
            0.0, frequency_hz=self.center_hz, gain_dbi=self.antenna_gain_dbi, cable_db=0.5 * self.losses_db
        )
        level_db = pfd_dbw_per_m2_mhz(frequency_hz) + unit_db - 90.0  # dB over 1 W/Hz
        density = 10.0 ** (level_db / 10.0) * (self.center_hz / frequency_hz) ** 2
        return density * self.receiver_filter.power_gain(frequency_hz)

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
        """Received powers inside and outside 4200-4400 MHz, I/N and SIR.

        The filter's noise bandwidth over 4200-4400 MHz sets the thermal noise k T0 B F, so that I/N compares like
        with like.
        """
        in_band = out_of_band = 0.0
        for low_mhz, high_mhz, _ in TABLE_1:
            grid_hz, step_hz = _midpoints(low_mhz * 1e6, high_mhz * 1e6)
            watts = self.power_density_w_per_hz(grid_hz).sum() * step_hz
            if low_mhz * 1e6 >= BAND_HZ[0] and high_mhz * 1e6 <= BAND_HZ[1]:
                in_band += watts
            else:
                out_of_band += watts
        grid_hz, step_hz = _midpoints(*BAND_HZ)
        noise_bandwidth_hz = float(self.receiver_filter.power_gain(grid_hz).sum() * step_hz)
        noise_factor = 10.0 ** (self.noise_figure_db / 10.0)
        noise = Boltzmann * REFERENCE_TEMPERATURE_K * noise_bandwidth_hz * noise_factor
        received = self.return_power_w()
        total = in_band + out_of_band
        return FaaReport(
            in_band_dbm=_db(in_band) + 30.0,
            out_of_band_dbm=_db(out_of_band) + 30.0,
            total_dbm=_db(total) + 30.0,
            noise_dbm=_db(noise) + 30.0,
            return_dbm=_db(received) + 30.0,
            i_over_n_db=_db(total) - _db(noise),
            sir_db=_db(received) - _db(total),
            snr_db=_db(received) - _db(noise),
        )


def _midpoints(low_hz: float, high_hz: float, step_hz: float = 10e3) -> tuple[np.ndarray, float]:
    """Midpoint rule over a band that is a whole number of steps; 10 kHz resolves filters from 0.1 MHz on."""
    count = round((high_hz - low_hz) / step_hz)
    return low_hz + (np.arange(count) + 0.5) * step_hz, step_hz
