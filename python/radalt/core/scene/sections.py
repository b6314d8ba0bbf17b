"""Sections of a scene: altitudes, the sweep over overlap, radios (docs/design.md)."""

import re
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..parsing import Settings, check_range, setting, shown
from ..programme import Programme
from ..radio.device import Device, device

_SERIAL = re.compile("[A-Za-z0-9]{0,32}")
_MOST_ATTENUATION_DB = 150.0  # largest attenuation of a set-up, dB: beyond it no signal is above the noise
_LEAST_LO_OFFSET_HZ = 1e4  # least LO offset but 0, Hz: megahertz or kilohertz written as hertz
# SIR above which no altitude notices the interference: a level that was meant to be negative
MOST_SIR_DB = 20.0


@dataclass(frozen=True, kw_only=True)
class DrawnReturns(Settings, where="altitude.drawn"):
    """Point returns that are drawn for every frame: altitude and range rate evenly within limits, and phase.

    The first frames do not depend on how many there are.
    """

    frames: int = setting(60, 1, 1_000_000)
    """Frames of the run, each with a return of its own."""
    low_m: float = setting(3.0, 0.0, 1e5)
    """Least altitude."""
    high_m: float = 1500.0
    """Greatest altitude, above the least, at most 1e5."""
    speed_m_per_s: float = setting(10.0, 0.0, 1000.0)
    """Largest range rate either way."""
    seed: int = 1
    """Seed of the returns alone: the same at every level of interference."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.low_m < self.high_m <= 1e5:
            raise ValueError(
                f"altitude.drawn.high_m is {self.high_m:g}; it has to be above low_m {self.low_m:g}, and at most 1e5"
            )

    def draw(self) -> np.ndarray:
        """(frames, 3): altitude in metres, range rate in m/s, phase in cycles."""
        drawn = np.random.default_rng([self.seed, 0xA17]).random((self.frames, 3))
        span = [self.high_m - self.low_m, 2.0 * self.speed_m_per_s, 1.0]
        return drawn * span + [self.low_m, -self.speed_m_per_s, 0.0]


@dataclass(frozen=True)
class AltitudeSpec(Settings, where="altitude"):
    """Altitudes of a run, and how they are produced."""

    programme_m: tuple[float, ...] = (1500.0, 1200.0, 900.0, 600.0, 400.0, 250.0, 150.0, 75.0, 30.0, 10.0)
    """Altitudes in the order they are flown."""
    frames: int = 15
    """Frames at each altitude (trials)."""
    mode: str = setting("synthetic", among=("synthetic", "true_delay"))
    """``synthetic`` shifts the beat in the source (works over the air), ``true_delay`` delays the return in the
    simulated channel."""
    vertical_speed_m_per_s: float = 0.0
    """Range rate, for true delays."""
    preamble_frames: int = 8
    """Frames before the first altitude, at synthetic altitude zero and with the jammer silent, for the segmenter's
    timing."""
    sync_every_frames: int = 0
    """Trials between further synchronisation sections; 0 for none."""
    sync_frames: int = 8
    """Length of a further synchronisation section."""
    hold_last: bool = False
    """Stay at the last altitude without end; for altitudes set by hand."""
    drawn: DrawnReturns | None = None
    """Point returns drawn per frame, with delay, Doppler and phase, in place of ``programme_m`` and ``frames``; the
    source plays them, so they also work over the air."""
    landing_frames: int = setting(200, 2, 100_000)
    """Frames over which the scene's ``landing`` is flown, if it has one (a time lapse of the approach)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.vertical_speed_m_per_s and self.mode == "synthetic":
            raise ValueError(
                f"altitude.vertical_speed_m_per_s {self.vertical_speed_m_per_s:g} needs mode: true_delay; "
                "a beat shift has no Doppler"
            )
        if self.drawn is not None and self.mode != "synthetic":
            raise ValueError("altitude.drawn needs mode: synthetic; the source plays the delays")
        self.programme  # noqa: B018 - checks its numbers when it is made

    @property
    def fastest_m_per_s(self) -> float:
        """Largest range rate that is flown."""
        return self.vertical_speed_m_per_s if self.drawn is None else self.drawn.speed_m_per_s

    @cached_property
    def programme(self) -> Programme:
        """The frame-by-frame programme."""
        drawn = None if self.drawn is None else self.drawn.draw().T.tolist()
        return Programme(
            altitudes_m=self.programme_m if drawn is None else tuple(drawn[0]),
            speeds_m_per_s=() if drawn is None else tuple(drawn[1]),
            phases_cycles=() if drawn is None else tuple(drawn[2]),
            frames_per_step=self.frames if drawn is None else 1,
            preamble_frames=self.preamble_frames,
            sync_every_frames=self.sync_every_frames,
            sync_frames=self.sync_frames,
            vertical_speed_m_per_s=self.vertical_speed_m_per_s,
            hold_last=self.hold_last,
        )


@dataclass(frozen=True)
class SweepSpec:
    """Points of an evaluation: every overlap at every SIR at every SNR. An empty list keeps the scene's value."""

    overlap: tuple[float, ...] = ()
    """Fractions of the sweep in which the interference is on."""
    sir_db: tuple[float, ...] = ()
    """Signal-to-interference ratios, total over all interferers."""
    snr_db: tuple[float, ...] = ()
    """Signal-to-noise ratios."""

    def __post_init__(self) -> None:
        for value in self.overlap:
            if not 0 <= value <= 1:
                raise ValueError(f"sweep.overlap holds {value:g}; overlaps have to be within 0..1")
        for value in self.sir_db:
            if value > MOST_SIR_DB:
                raise ValueError(
                    f"sweep.sir_db holds {value:g}; at most {MOST_SIR_DB:g}: did you mean {-value:g}?"
                )


@dataclass(frozen=True)
class RadioSpec(Settings, where="radio"):
    """Settings of the two radios; not used in simulation."""

    device: str = "b210"
    """Type of both radios."""
    radar_serial: str = ""
    """USB serial number (``uhd_find_devices``), letters and digits; empty takes the first device found, which the
    interlock allows without a jammer only."""
    jammer_serial: str = ""
    """USB serial number of the jammer's radio."""
    master_clock_hz: float = 30e6
    """Master clock within the device's range; with radios a multiple of the rate: four times 7.5 MS/s is 30 MHz."""
    lo_offset_hz: float = 6e6
    """LO offset out of the band, so that its leakage falls outside; at most half the device's highest clock."""
    radar_tx_gain_db: float = 0.0
    """Transmit gain, within the device's range: 0..89.75 dB for a B210."""
    radar_rx_gain_db: float = 20.0
    """Receive gain, within the device's range: 0..76 dB for a B210."""
    jammer_tx_gain_db: float = 0.0
    """Transmit gain of the jammer's radio."""
    auxiliary_rx_gain_db: float = 20.0
    """Gain of the second receive channel."""
    enclosure: str = setting("none", among=("none", "cabled", "shielded"))
    """Where the signals go; without an enclosure nothing is transmitted."""
    attenuation_db: float = 0.0
    """Attenuation in the cables between TX and RX, 0..150 dB."""
    auxiliary_attenuation_db: float = 0.0
    """Attenuation from each TX to the input of the second receive channel, 0..150 dB."""
    clock_source: str = setting("internal", among=("internal", "external", "gpsdo"))
    """Reference of the clocks."""

    def __post_init__(self) -> None:
        super().__post_init__()
        limits = self.limits
        most_offset_hz = limits.master_clock_hz[1] / 2
        check_range(
            "radio",
            self,
            radar_tx_gain_db=limits.tx_gain_db,
            jammer_tx_gain_db=limits.tx_gain_db,
            radar_rx_gain_db=limits.rx_gain_db,
            auxiliary_rx_gain_db=limits.rx_gain_db,
            attenuation_db=(0.0, _MOST_ATTENUATION_DB),
            auxiliary_attenuation_db=(0.0, _MOST_ATTENUATION_DB),
            master_clock_hz=limits.master_clock_hz,
            lo_offset_hz=(-most_offset_hz, most_offset_hz, _LEAST_LO_OFFSET_HZ),
        )
        for name in ("radar_serial", "jammer_serial"):
            if not _SERIAL.fullmatch(getattr(self, name)):
                # a serial is part of a device address, in which a comma separates arguments
                raise ValueError(
                    f"radio.{name} is {shown(getattr(self, name))}; a serial is at most 32 letters and digits"
                )

    @property
    def limits(self) -> Device:
        """Ranges and limits of the radios."""
        return device(self.device)
