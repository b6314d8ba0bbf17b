"""Every setting of the QPSK receiver, with its unit and where it comes from."""

from dataclasses import dataclass


@dataclass(frozen=True)
class QpskSettings:
    """Settings of the QPSK receiver; rates are in symbols per sample.

    Values whose comment names no source are in the middle of a range, 30 % lower to 30 % higher, in which no case of
    QPSK changed.
    """

    # -- symbol timing
    # slowest symbols: fewer than 150 per frame do not determine an equaliser of 32 taps
    min_symbol_rate: float = 0.02
    # power of a timing line over the median of its surroundings: noise exceeds 28 in one frame of 10^5 (exp(-28 ln 2)
    # in each of 3,600 bins)
    min_line_contrast: float = 28.0
    # bins over which that median is taken
    line_floor_bins: int = 125
    # bins in which a line's peak lies: twice the main lobe of the Hann window
    line_bins: int = 4
    # slowest line that is taken, relative to the strongest in power: harmonics of the symbol rate can be stronger
    harmonic_power: float = 0.3

    # -- equaliser and decisions
    # taps of the equaliser
    taps: int = 32
    # taps per symbol: above 2, so that the spectrum beyond half the symbol rate is seen (fractionally spaced)
    taps_per_symbol: float = 2.2
    # diagonal loading of its equations, of the mean power: float32 resolves 1e-6
    tap_loading: float = 1e-5
    # symbols that its weights are fitted to, at most: 25 per tap; and samples that a median is taken of: 4 % of it
    training_symbols: int = 800
    # iterations of the constant-modulus start, at most
    cma_iterations: int = 24
    # change of its outputs, of their power, at which it has converged
    cma_converged: float = 1e-3
    # symbols over which power is averaged to find where a burst begins and ends
    burst_symbols: int = 8
    # power over that while it sends, above which a burst is on: 7 dB
    burst_power: float = 0.2
    # symbols over which the carrier's phase is averaged: a block resolves 0.5 kHz per sample rate of 7.5 MHz
    carrier_symbols: int = 50
    # largest EVM squared of symbols that are decided; symbols at random have 0.36, an EVM of 17.5 % (TS 38.104, QPSK)
    # 0.03
    max_evm_squared: float = 0.08
    # largest correlation of a decision with one of the three before it: data has 1/sqrt(K), a tone 1
    max_correlation: float = 0.3

    # -- pulse
    # samples that a pulse lasts, channel and filters included: 7 symbols of 0.4 MHz, 17 of 1 MHz; even
    pulse_samples: int = 128
    # diagonal loading of its equations, of the symbols' power: outside their band there is nothing to be fitted to
    pulse_loading: float = 1e-4
    # iterations of the fit of pulse and drift, at most: each leaves some -10 dB of the error
    pulse_iterations: int = 6

    # -- subtraction
    # power of a sample over the median of what is left, above which it is blanked: symbols cut at the ends of a burst
    outlier_power: float = 6.0

    # -- tracking
    # drift of the pulse over half a frame, of its power, above which timing or carrier are wrong
    max_drift: float = 0.02
    # part of the residual that a correction of the pulse has to explain: less is noise, and waits for the next frame
    min_correction: float = 0.02
    # frames in which a pulse that fits is not corrected, at most; one more after each that needed no correction
    max_unchanged: int = 7
    # share of a frame's correction that is kept: the mean over frames has less noise
    smoothing: float = 0.3
    # residual power over the least of the frames before, beyond which the emitter has changed
    max_residual: float = 8.0


DEFAULTS = QpskSettings()
