"""Tracking: what one frame says of an emitter serves the next, which needs no search."""

from dataclasses import dataclass, replace

import numpy as np

from .arrays import power
from .cfo import phase_course
from .channel_estimation import ChannelStart, fourth_powers
from .common_phase import axes_phases
from .equaliser import ElementGrid, timing_ramp
from .iterative_receiver import IterativeReceiver, KnownReturn, Reception
from .numerology import Numerology
from .settings import OfdmSettings

_BLOCK = 50  # subcarriers whose fourth powers are summed before their sign is judged


@dataclass
class TrackingState:
    """An emitter as the frame before left it; times in samples of the next frame."""

    numerology: Numerology
    first_long: float  # middle of a long prefix
    cfo: float  # in subcarriers
    channel: np.ndarray  # (1, K) complex64
    used: np.ndarray  # (K,) bool
    noise: np.ndarray  # (1, K) float32, least over the symbols: without regions that have more
    model: str
    relative_noise: float  # of the receptions before, averaged
    course: tuple[float, float] | None  # phase at the first sample, and its rate: `phase_course`
    level: float = 1.0  # amplitude by which frames are divided, so that the channel's scale stays
    return_power: float = 0.0  # of the return in its elements, by an earlier frame
    tones: bool = False  # whether tones were removed before
    age: int = 0  # frames since it was acquired

    def skipped(self, samples: int) -> None:
        """A frame passed that was not demodulated."""
        self.first_long = (self.first_long - samples) % self.numerology.cycle
        if self.course is not None:
            self.course = advanced(self.course, self.cfo, samples, self.numerology)


def advanced(
    course: tuple[float, float], cfo: float, samples: int, numerology: Numerology
) -> tuple[float, float]:
    """Course of the phases in the next frame: removing the CFO begins anew there, with phase 0."""
    return course[0] + course[1] * samples + 2 * np.pi * cfo * samples / numerology.useful, course[1]


def grid_of(frame: np.ndarray, state: TrackingState) -> ElementGrid:
    """Elements of an (N,) frame at the times that the state predicts."""
    times, cycle = state.numerology.times(state.first_long, frame.size)
    held, starts = state.numerology.windows(times, frame.size)
    return ElementGrid(
        frame, state.numerology, state.cfo, starts, starts - times[held], cycle[held] - cycle[held[0]]
    )


def tracked(
    grid: ElementGrid,
    free: np.ndarray,
    state: TrackingState,
    receiver: IterativeReceiver,
    known: KnownReturn | None,
    settings: OfdmSettings,
) -> Reception | None:
    """Reception of a frame with the state's static channel, None where the emitter has changed.

    Fourth powers over the known channel give the symbols' phases up to a quarter turn, which no constellation notices.
    """
    fourth = fourth_powers(grid.raw * grid.ramp, power(state.channel), free & state.used)
    fourth *= (state.channel.conj() / np.maximum(np.abs(state.channel), np.float32(1e-9))) ** 4
    edge = np.arange(0, fourth.shape[1], _BLOCK)
    blocks = -np.add.reduceat(fourth, edge, axis=1)
    angle = axes_phases(blocks) / 4
    middles = grid.starts + grid.numerology.useful / 2
    if state.course is not None:
        predicted = state.course[0] + state.course[1] * middles
        angle = np.where(np.cos(4 * (angle - predicted)) < 0, angle + np.pi / 4, angle)
        line = phase_course(angle, middles, grid.numerology.spacing)
        if line is not None:  # a straight line has less noise than each phase
            angle = line[0] + line[1] * middles
    phase = np.exp(-1j * angle).astype(np.complex64)[:, None]
    # timing against the channel: what is left of the fourth powers' phase over frequency
    c = blocks * np.exp(-4j * angle)[:, None]
    c = (c * np.sign(c.real)).sum(axis=0)
    delay = block_delay(c, edge, grid.numerology)
    grid.ramp = grid.ramp * timing_ramp(np.full(1, delay), grid.numerology)
    state.first_long += delay
    noise = np.broadcast_to(state.noise, grid.raw.shape)
    start = ChannelStart(state.channel, state.used, phase, "static", noise)
    found = receiver.loop(grid, free, start, 0, known=known, memory=settings.channel_memory * len(grid))
    if found.relative_noise > settings.track_again * state.relative_noise:
        found = receiver.loop(grid, free, found, 1, known=known)
    if found.relative_noise > settings.track_noise * state.relative_noise or found.gain < settings.evidence:
        return None
    return replace(found, return_power=found.return_power or state.return_power)


def block_delay(coherence: np.ndarray, edge: np.ndarray, numerology: Numerology) -> float:
    """Delay in samples from the sums (blocks,) of fourth powers, phases taken out, of blocks that begin at ``edge``."""
    size = np.abs(coherence)
    angle = np.angle(coherence) / 4
    at = edge - (edge * size).sum() / max(size.sum(), 1e-9)
    slope = (size * at * angle).sum() / max((size * at * at).sum(), 1e-9)
    return float(-slope * numerology.useful / (2 * np.pi))


def next_state(
    found: Reception, grid: ElementGrid, first_long: float, samples: int, before: TrackingState | None
) -> TrackingState:
    """State after a frame of so many samples."""
    num = grid.numerology
    channel = found.channel if len(found.channel) == 1 else found.channel.mean(axis=0)[None]
    phases = -np.angle(found.phase[:, 0])
    middles = grid.starts + num.useful / 2
    course = phase_course(phases, middles, num.spacing)
    if course is not None:
        course = advanced(course, grid.cfo, samples, num)
    relative = found.relative_noise
    if before is not None:
        relative = 0.8 * before.relative_noise + 0.2 * relative
    return TrackingState(
        num,
        (first_long - samples) % num.cycle,
        grid.cfo,
        channel,
        found.used,
        found.noise.min(axis=0)[None],
        found.model,
        relative,
        course,
        before.level if before else 1.0,
        found.return_power,
        before.tones if before else False,
        before.age + 1 if before else 0,
    )
