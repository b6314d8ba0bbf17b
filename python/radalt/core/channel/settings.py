"""Settings of the simulated channel."""

from dataclasses import dataclass

from ..interference.multipath import FadingChannel
from ..parsing import Settings, setting

_MOST_DELAY = 1e6  # longest delay, samples: 8 MB of delay line
# Longest path of leakage or gear, metres of altitude: longer than any aircraft's installation.
_MOST_LEAKAGE_M = 100.0


@dataclass(frozen=True)
class DropSettings:
    """Samples lost between the radio and the host."""

    count: int = 0
    """Number of gaps in the run, spread at random; 0 for none."""
    min_samples: int = 100
    """Least length of a gap, drawn uniformly up to the greatest."""
    max_samples: int = 5000
    """Greatest length of a gap."""
    tagged: bool = True
    """Mark the first sample after a gap with ``rx_time``, as UHD does."""

    def __post_init__(self) -> None:
        if not 0 <= self.count <= 100_000 or not 1 <= self.min_samples <= self.max_samples <= 10**9:
            raise ValueError(
                f"drops: count {self.count} has to be 0 or above, at most 100000, and 1 <= min_samples "
                f"{self.min_samples} <= max_samples {self.max_samples} <= 1e9"
            )


@dataclass(frozen=True)
class ChannelSettings(Settings, where="channel"):
    """Impairments of the simulated channel, each off by default."""

    snr_db: float | None = 10.0
    """Signal-to-noise ratio of the return over the whole complex band, before dechirping; None for no noise."""
    start_offset_samples: float | None = setting(None, 0.0, _MOST_DELAY)
    """Hardware latency between transmitter and receiver, fraction included; None draws it from the seed."""
    gain_db: float = 0.0
    """Gain of return and interference together."""
    jammer_delay_samples: float = setting(0.0, 0.0, _MOST_DELAY)
    """Extra delay of the jammer against the radar."""
    jammer_clock_ppm: float = setting(0.0, -100.0, 100.0)
    """Clock of the jammer against the radar's."""
    jammer_lo_offset_hz: float = 0.0
    """LO of the jammer against the radar's."""
    dc_offset: float = setting(0.0, -1e6, 1e6)
    """Amplitude of the receiver's DC offset, relative to the return."""
    iq_gain_db: float = 0.0
    """Gain imbalance of the receiver's I and Q."""
    iq_phase_deg: float = 0.0
    """Phase error of the receiver's I and Q."""
    adc_bits: int = setting(0, 0, 16)
    """Converter resolution (B210: 12); 0 for none."""
    full_scale: float = setting(4.0, 1e-6, 1e6)
    """Amplitude per rail at which the converter clips, relative to the return."""
    leakage_db: float | None = None
    """Power of the direct transmitter leakage, relative to the return; only with true delays. Outside the trials
    (preamble, synchronisation) there is no return, as with terminated antennas."""
    leakage_m: float = setting(0.0, 0.0, _MOST_LEAKAGE_M)
    """Path of the leakage, in metres of altitude."""
    gear_db: float | None = None
    """Power of a second static echo, such as the landing gear's, relative to the return; with ``leakage_db`` only."""
    gear_m: float = setting(4.5, 0.0, _MOST_LEAKAGE_M)
    """Distance of the gear below the antennas."""
    drops: DropSettings = DropSettings()
    """Lost samples."""
    return_multipath: FadingChannel | None = None
    """Tapped delay line of the return; its gains are constant within a frame (Doppler below 500 Hz for 1 ms frames)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.gear_db is not None and self.leakage_db is None:
            raise ValueError(
                f"channel.gear_db {self.gear_db:g} needs channel.leakage_db, on which timing is taken"
            )
