"""Settings of the simulated channel."""

from dataclasses import dataclass

from ..interference.multipath import FadingChannel
from ..parsing import check_range

_MOST_DELAY = 1e6  # longest delay, samples: 8 MB of delay line
# Longest path of leakage or gear, metres of altitude: longer than any aircraft's installation.
_MOST_LEAKAGE_M = 100.0


@dataclass(frozen=True)
class DropSettings:
    """Samples lost between the radio and the host.

    Parameters
    ----------
    count : int
        Number of gaps in the run, spread at random; 0 for none.
    min_samples, max_samples : int
        Length of a gap, drawn uniformly.
    tagged : bool
        Mark the first sample after a gap with ``rx_time``, as UHD does.
    """

    count: int = 0
    min_samples: int = 100
    max_samples: int = 5000
    tagged: bool = True

    def __post_init__(self) -> None:
        if not 0 <= self.count <= 100_000 or not 1 <= self.min_samples <= self.max_samples <= 10**9:
            raise ValueError(
                f"drops: count {self.count} has to be 0 or above, at most 100000, and 1 <= min_samples "
                f"{self.min_samples} <= max_samples {self.max_samples} <= 1e9"
            )


@dataclass(frozen=True)
class ChannelSettings:
    """Impairments of the simulated channel, each off by default.

    Parameters
    ----------
    snr_db : float or None
        Signal-to-noise ratio of the return over the whole complex band, before dechirping; None for no noise.
    start_offset_samples : float or None
        Hardware latency between transmitter and receiver, fraction included; None draws it from the seed.
    gain_db : float
        Gain of return and interference together.
    jammer_delay_samples : float
        Extra delay of the jammer against the radar.
    jammer_clock_ppm, jammer_lo_offset_hz : float
        The jammer runs from its own clock and LO.
    dc_offset : float
        Amplitude of the receiver's DC offset, relative to the return.
    iq_gain_db, iq_phase_deg : float
        IQ imbalance of the receiver.
    adc_bits : int
        Converter resolution (B210: 12); 0 for none.
    full_scale : float
        Amplitude per rail at which the converter clips, relative to the return.
    leakage_db : float or None
        Power of the direct transmitter leakage, relative to the return; only with true delays. Outside the trials
        (preamble, synchronisation) there is no return, as with terminated antennas.
    leakage_m : float
        Path of the leakage, in metres of altitude.
    gear_db : float or None
        Power of a second static echo, such as the landing gear's, relative to the return; with ``leakage_db`` only.
    gear_m : float
        Distance of the gear below the antennas.
    drops : DropSettings
        Lost samples.
    return_multipath : FadingChannel or None
        Tapped delay line of the return; its gains are constant within a frame (Doppler below 500 Hz for 1 ms frames).
    """

    snr_db: float | None = 10.0
    start_offset_samples: float | None = None
    gain_db: float = 0.0
    jammer_delay_samples: float = 0.0
    jammer_clock_ppm: float = 0.0
    jammer_lo_offset_hz: float = 0.0
    dc_offset: float = 0.0
    iq_gain_db: float = 0.0
    iq_phase_deg: float = 0.0
    adc_bits: int = 0
    full_scale: float = 4.0
    leakage_db: float | None = None
    leakage_m: float = 0.0
    gear_db: float | None = None
    gear_m: float = 4.5
    drops: DropSettings = DropSettings()
    return_multipath: FadingChannel | None = None

    def __post_init__(self) -> None:
        check_range(
            "channel",
            self,
            adc_bits=(0, 16),
            full_scale=(1e-6, 1e6),
            dc_offset=(-1e6, 1e6),
            start_offset_samples=(0.0, _MOST_DELAY),
            jammer_delay_samples=(0.0, _MOST_DELAY),
            jammer_clock_ppm=(-100.0, 100.0),
            leakage_m=(0.0, _MOST_LEAKAGE_M),
            gear_m=(0.0, _MOST_LEAKAGE_M),
        )
        if self.gear_db is not None and self.leakage_db is None:
            raise ValueError(
                f"channel.gear_db {self.gear_db:g} needs channel.leakage_db, on which timing is taken"
            )
