"""Tuned thresholds of the OFDM canceller."""

from dataclasses import dataclass


@dataclass(frozen=True)
class OfdmSettings:
    """Settings of `OfdmCancel`: unit, meaning, and source.

    A gate is a ratio to something that is measured in the same frame. [S] is from a standard, [F] follows from a
    formula. [M] was chosen by trial: 0.7 and 1.3 times the value cost at most .014 of Pd (docs/cancellation.md).
    """

    # sync
    spacings_hz: tuple[float, ...] = (15e3, 30e3)  # subcarrier spacings [S: TS 38.211 table 4.2-1]
    least_kurtosis: float = 1.5  # mean squared power over squared mean; OFDM has 2, a sweep 1 [F]
    prefix_contrast: float = 4.5  # ratio; prefix correlation over its scatter; noise stays below 4.2 [M]
    occupied: float = 0.35  # of the strongest block; less is silence between two users [M]
    in_use: float = 1e-3  # of the median subcarrier power; below is the filter's skirt [M]
    # return
    visible_ratio: float = 16.0  # beat peak over mean power, each half: 1e-4 by chance [F: exp]
    visible_cells: float = 2.0  # range cells between the halves' beats of one return [F: 10 m/s]
    mask_margin: int = 3  # subcarriers next to the return's own: sweep within a symbol, Doppler [F]
    raw_ratio: float = 8.0  # tones over noise as received: removed before decisions [M]
    found_ratio: float = 8.0  # tones over noise when cancelled: a return-aware pass [F: exp]
    return_uncertainty: float = 2.0  # error of a tone's power, over its ratio [F: Cramer-Rao]
    return_step_db: float = 6.0  # dB; grid of return powers whose likelihood is compared [M]
    return_loud: float = 0.3  # of half the distance of 256QAM, squared: a louder one is fitted [M]
    return_candidates: int = 8  # beats that are fitted [M]
    return_nats: float = 0.15  # per masked element that a fitted return gains over an unknown one [M]
    return_fit_error: float = 0.1  # of its power [M]
    # integrity, on beat spectra with two cells per range cell, normalised by their noise
    speed_cells: int = 9  # cells between the halves' beats of one return [F: 150 m/s are 8.6]
    flown_cells: int = 3  # cells by which they differ at most in flight [F: 50 m/s are 2.9]
    lobe_cells: int = 4  # cells on either side of a peak that are its main lobe [F: Hann window]
    chance: float = 0.01  # probability by noise of a pair of beats, or its weaker half [M]
    pair_margin: float = 1.2  # ratio of the best pair to any other [M]
    balance_db: float = 6.0  # dB; difference of the halves' beats: noise, masked elements [M]
    # demapper
    prior_empty: float = 0.25  # probability of silence among control elements [M]
    prior_qpsk: float = 0.45  # of QPSK (TS 38.211 clauses 7.3, 7.4) [M]
    prior_boosted: float = 0.2  # of QPSK 3 dB up: DM-RS [S: TS 38.214 table 4.1-1]
    prior_axes: float = 0.1  # of points on the axes [S: TS 38.211 clause 7.4.2.2]
    outlier: float = 1e-3  # probability of an element that is none of these [M]
    log_limit: float = 12.0  # nats; what one element may say for or against control [M]
    # loop
    noise_grid_db: tuple[float, ...] = (-28.0, -21.0, -14.0)  # dB; noise that is tried first [M]
    iterations: int = 4  # at most, with a static channel [M]
    iterations_moving: int = 6  # at most, with a channel that moves [M]
    iterations_tile: int = 4  # at most, with precoding [M]
    converged: float = 0.95  # of the noise of the iteration before: no further one [M]
    evidence: float = 0.04  # nats per element over a Gaussian of the same power: less passes [M]
    readable: float = 0.4  # nats; with less in a static channel no other one is tried [M]
    channel_error: float = 3.0  # coherent residual over noise: another channel model is tried [M]
    tile_better: float = 0.97  # of the moving channel's error, for precoding to be tried in its place [M]
    better_gain: float = 0.02  # nats by which another channel model has to win [M]
    uneven_region: float = 2.0  # times a subcarrier's noise; a region of a symbol with more has its own [M]
    # subtraction
    outlier_return: float = 3.0  # times the 0.8 quantile of what is left in the return mask [M]
    blank_ratio: float = 6.0  # times the median output power: blanked; noise has e^-4 of it [F: exp]
    # tracking
    track_again: float = 1.4  # times the noise of the frames before; more is decided once more [M]
    track_noise: float = 4.0  # the same; still more is acquired anew [M]
    channel_memory: float = 1.0  # frames whose channel estimates are averaged [M]
    cfo_interval: int = 16  # frames; in one of them the residual CFO is measured [F: drift per s]
    patience: int = 8  # searches in vain, one after the other; then one frame in as many is searched [M]
    # bursts
    burst_longest: float = 0.36  # of a frame; a longer one is demodulated [M]
    burst_power: float = 0.9  # of a frame's power, at least [F: the rest is return and noise]
    burst_loud: float = 6.0  # times the median power; noise has e^-4 of it [F: exp]
    burst_gap: int = 64  # samples; a burst may be quiet for so long by chance [F: Rayleigh]
    # cost
    most_ffts: float = (
        590.0  # FFTs; no other channel model is tried, and no return fitted, that could exceed it [M]
    )


SETTINGS = OfdmSettings()
