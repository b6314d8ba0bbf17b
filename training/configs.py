"""Distributions of training examples, and their named sets. `data.py` draws the examples."""

from __future__ import annotations

from dataclasses import dataclass, replace

__all__ = ["CONFIGS", "SceneConfig"]


@dataclass(frozen=True)
class SceneConfig:
    """Distributions of an example.

    Attributes
    ----------
    sir_db : (low, high)
        Signal-to-interference ratio of all interferers together, uniform in decibels, averaged over the frame.
    snr_db : (low, high)
        Per-sample signal-to-noise ratio before dechirping, uniform in decibels.
    altitude_m : (low, high)
    max_vertical_speed_m_per_s : float
        Range rate uniform within plus or minus this.
    kinds : tuple of (name, weight)
        Interferer families: ``tones``, ``qpsk_rectangular``, ``qpsk_shaped``, ``nr5``, ``nr10``, ``radar`` (another
        FMCW altimeter).
    counts : tuple of float
        Probability of 0, 1, 2, ... interferers at once.
    full_overlap : float
        Probability of full overlap of an interferer; otherwise the overlap is uniform in 0.02..1.
    multipath, extended : float
        Probability of a few discrete echoes, and of an extended ground return.
    impaired : float
        Probability that an interferer has a fractional sample delay and a frequency offset (another clock).
    converter : float
        Probability that the frame went through a converter of 1, 2, 3, 4, 6 or 8 bits that clips at one to four
        times the frame's RMS.
    empty : float
        Probability of a frame without a return. Its target is the noise: a network may remove interference only, and
        nothing may look like a return afterwards.
    beyond : float
        Probability that the return lies beyond the span, from 60 m above it to four times as high. Its target is the
        noise, as for the altimeter. No example has a return in the 60 m between, three range cells.
    second : float
        Probability of a second return 0 to 15 dB weaker, at an altitude of its own.
    received : float
        Probability that an interferer is as received: with multipath (half of it moving at up to 30 km/h),
        the receiver's filter, and a clock of its own within 2 ppm.
    own_noise : float
        Probability that an interferer has white noise of its own, 3 to 20 dB below it, as off-air recordings do; no
        method can remove it.
    typical : float
        Probability that a QPSK or NR interferer has the error vectors of a typical transmitter (`TYPICAL_EVM`).
    front_end : float
        Probability that the frame went through an amplifier that saturates at one to four times its RMS, and a
        converter of 8, 10 or 12 bits.
    envelope : float
        Standard deviation of a band-limited Gaussian envelope of the return, 10 % of the bandwidth wide, around one.
    levels_db : tuple of (name, low, high)
        SIR of each interferer by its kind, uniform in decibels, instead of ``sir_db`` of all together.
    persistent : int
        Consecutive examples that share continuous interferers.
    any_sweep : bool
        Whether every batch has its own sweep (`sweep_of`); bandwidths of interferers scale with its rate, those of NR
        also with half of it and four times.
    recordings : tuple of str
        SigMF files; a third of the interferers are cut from them. See `split_recordings`.
    size, validation : int
        Examples of a finite set and of its validation part; 0 for endless fresh data.
    seed : int
    """

    sir_db: tuple[float, float] = (-50.0, 5.0)
    snr_db: tuple[float, float] = (5.0, 20.0)
    altitude_m: tuple[float, float] = (0.0, 1500.0)
    max_vertical_speed_m_per_s: float = 50.0
    kinds: tuple[tuple[str, float], ...] = (
        ("tones", 1.0),
        ("qpsk_rectangular", 1.3),
        ("qpsk_shaped", 1.0),
        ("nr5", 1.0),
        ("nr10", 0.4),
    )
    counts: tuple[float, ...] = (0.06, 0.66, 0.2, 0.08)
    full_overlap: float = 0.35
    multipath: float = 0.15
    extended: float = 0.15
    impaired: float = 0.2
    converter: float = 0.0
    empty: float = 0.0
    beyond: float = 0.0
    second: float = 0.0
    received: float = 0.0
    own_noise: float = 0.0
    typical: float = 0.0
    front_end: float = 0.0
    envelope: float = 0.0
    levels_db: tuple[tuple[str, float, float], ...] = ()
    persistent: int = 1
    any_sweep: bool = False
    recordings: tuple[str, ...] = ()
    size: int = 0
    validation: int = 0
    seed: int = 1


CONFIGS: dict[str, SceneConfig] = {
    "fresh": SceneConfig(),
    # second part of `compact`: down to where the classical methods break, more mixtures and more 10 MHz NR
    "deep": SceneConfig(
        sir_db=(-62.0, 2.0),
        kinds=(
            ("tones", 1.0),
            ("qpsk_rectangular", 1.2),
            ("qpsk_shaped", 1.2),
            ("nr5", 1.2),
            ("nr10", 0.8),
        ),
        counts=(0.05, 0.6, 0.18, 0.17),
        seed=2,
    ),
    # third part of `compact`: half of the interferers with a clock of their own, more of several at once, coarse
    # converters
    "received": SceneConfig(
        sir_db=(-58.0, 2.0),
        snr_db=(0.0, 25.0),
        kinds=(
            ("tones", 0.8),
            ("qpsk_rectangular", 1.4),
            ("qpsk_shaped", 1.0),
            ("nr5", 1.2),
            ("nr10", 0.9),
        ),
        counts=(0.05, 0.52, 0.18, 0.25),
        full_overlap=0.5,
        impaired=0.5,
        converter=0.06,
        seed=3,
    ),
    # the paper: QPSK bursts and tones at -20..0 dB, 50,000 + 10,000 examples
    "paper": SceneConfig(
        sir_db=(-20.0, 0.0),
        kinds=(("qpsk_rectangular", 1.0), ("tones", 1.0)),
        counts=(0.1, 0.6, 0.3),
        multipath=0.0,
        extended=0.0,
        impaired=0.0,
        size=50_000,
        validation=10_000,
        seed=20,
    ),
}
# the paper's predecessor (arXiv:2410.03423): 10,000 examples, SNR -25 to 30 dB, tones and QPSK each with its own range
CONFIGS["predecessor"] = replace(
    CONFIGS["paper"],
    sir_db=SceneConfig.sir_db,
    snr_db=(-25.0, 30.0),
    max_vertical_speed_m_per_s=0.0,
    envelope=0.3,
    levels_db=(("qpsk_rectangular", -20.0, 0.0), ("tones", -20.0, 20.0)),
    size=10_000,
    validation=1_000,
    seed=21,
)
# fourth part of `compact`: the distributions of the third, held-out examples
CONFIGS["lean"] = replace(CONFIGS["received"], seed=5)
# fifth part: more NR, above all of 10 MHz, and more of several at once
CONFIGS["crowded"] = replace(
    CONFIGS["received"],
    kinds=(
        ("tones", 0.7),
        ("qpsk_rectangular", 1.3),
        ("qpsk_shaped", 0.9),
        ("nr5", 1.3),
        ("nr10", 1.8),
    ),
    counts=(0.04, 0.5, 0.16, 0.3),
    seed=6,
)
# sixth part: SNR up to 45 dB, twice as much extended ground, three times as many frames without interference
CONFIGS["ground"] = replace(
    CONFIGS["crowded"], snr_db=(0.0, 45.0), counts=(0.12, 0.46, 0.14, 0.28), extended=0.3, seed=7
)
# seventh part: interferers with white noise of their own, and as received
CONFIGS["noisy"] = replace(CONFIGS["ground"], received=0.15, own_noise=0.25, seed=9)
# `compact` for any sweep, after its sixth part: sweeps of all kinds, frames without a return or with two, other radars,
# interference as received
CONFIGS["any_sweep"] = replace(
    CONFIGS["ground"],
    kinds=(*CONFIGS["ground"].kinds, ("radar", 0.7)),
    empty=0.2,
    second=0.08,
    received=0.4,
    front_end=0.25,
    persistent=2,
    any_sweep=True,
    seed=8,
)
# eighth part, and the same for any sweep: typical transmitters, returns beyond the span
CONFIGS["typical"] = replace(CONFIGS["noisy"], typical=0.7, beyond=0.05, seed=10)
CONFIGS["any_sweep_typical"] = replace(CONFIGS["any_sweep"], typical=0.7, beyond=0.05, seed=11)
