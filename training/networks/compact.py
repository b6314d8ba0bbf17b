"""`compact`: our temporal convolutional autoencoder, and the variants it was compared with.

Three stages, all inside one feed-forward graph of an IQ frame:

1. *Modulus*. An interferer of constant envelope (rectangular QPSK, FMCW, a tone) moves only the phase of
   what is received: ``x - A x/|x|`` with ``A`` the local mean of ``|x|`` takes it away and leaves half of the
   return and its image, whatever the SIR (the locally optimum zero-memory nonlinearity). A small gated
   network decides where, from the spread of the envelope and from how much of the power lies on the sweep.
   It also levels bursts in time.
2. *Spectrum*. A DFT of the frame, a learned soft limit on the smoothed power spectrum, the inverse DFT:
   stationary interference narrower than the sweep.
3. *Beat-domain autoencoder*. Multiplication by the conjugate sweep, a strided filterbank over the beat band
   (encoder), gated dilated residual blocks on log powers and phases (bottleneck), a gain for each
   time-frequency cell, transposed convolution and the sweep again (decoder).

Everything starts as the identity over the beat band and learns what to take away.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as nnf

from radalt.core.waveform import Waveform

from .layers import Dechirp, FourierBank, GatedBlock, MatrixDft, log_power

__all__ = ["Compact", "CompactSettings"]


@dataclass(frozen=True)
class CompactSettings:
    """Sizes and which stages exist.

    ``hop`` has to divide the frame, ``kernel`` is three hops, ``reach`` bins on each side of zero beat are
    kept.
    """

    hop: int = 30
    kernel: int = 90
    reach: int = 3
    channels: int = 32
    dilations: tuple[int, ...] = (1, 2, 4, 8, 16, 32, 1)
    modulus: bool = True
    spectrum: bool = True


def _ramp(hop: int) -> Tensor:
    """(hop, 1, 3) weights of linear interpolation from block values to samples, as a convolution."""
    position = (torch.arange(hop) + 0.5) / hop - 0.5
    before, after = (-position).clamp(min=0), position.clamp(min=0)
    return torch.stack([before, 1 - before - after, after], 1)[:, None]


def _interpolate(blocks: Tensor, ramp: Tensor, samples: int) -> Tensor:
    """(B, 1, L) -> (B, 1, samples = L hop)."""
    padded = torch.cat([blocks[..., :1], blocks, blocks[..., -1:]], 2)
    return nnf.conv1d(padded, ramp).transpose(1, 2).reshape(-1, 1, samples)


class _Modulus(nn.Module):
    """Stage 1: (B, 2, N) -> (B, 2, N)."""

    def __init__(self, settings: CompactSettings, bins: int, samples: int) -> None:
        super().__init__()
        self.samples = samples
        self.hop, self.kernel = settings.hop, settings.kernel
        width = 16
        self.enter = nn.Conv1d(bins + 5, width, 4, stride=2, padding=1)
        self.blocks = nn.Sequential(*(GatedBlock(width, d) for d in (1, 4)))
        self.leave = nn.ConvTranspose1d(width, 2, 4, stride=2, padding=1)
        with torch.no_grad():
            self.leave.weight.mul_(0.1)
            self.leave.bias.copy_(torch.tensor([-2.0, 3.0]))  # subtract little, level nothing
        self.fine = self.hop // 2  # spacing of the local amplitude
        self.register_buffer("ramp", _ramp(self.hop), persistent=False)
        self.register_buffer("fine_ramp", _ramp(self.fine), persistent=False)

    def _pool(self, x: Tensor) -> Tensor:
        """Mean over a kernel about each block."""
        pad = (self.kernel - self.hop) // 2
        return nnf.avg_pool1d(x, self.kernel, self.hop, padding=pad, count_include_pad=False)

    def forward(self, x: Tensor, beat_power: Tensor) -> tuple[Tensor, Tensor]:
        """Cleaned frame and (B, 5, L) envelope features, from the frame and its beat-band cell powers."""
        squares = x * x
        power = squares[:, :1] + squares[:, 1:]
        modulus = torch.sqrt(power + 1e-12)
        mean, mean_power = self._pool(modulus), self._pool(power)
        level = log_power(mean_power)
        spread = log_power((mean_power - mean * mean).clamp(min=0) / (mean_power + 1e-12) + 1e-7)
        # short blocks see the edges of bursts
        short = log_power(nnf.avg_pool1d(power, self.hop, self.hop))
        on_sweep = log_power(beat_power.sum(1, keepdim=True) / (mean_power + 1e-12) + 1e-6)
        average = level.mean(2, keepdim=True)
        envelope = torch.cat(
            [level - average, spread, short - average, on_sweep, level - (level - average)], 1
        )
        h = self.enter(torch.cat([envelope, log_power(beat_power) - average], 1) * 0.25)
        control = torch.sigmoid(self.leave(self.blocks(h)))
        subtract, keep = (_interpolate(control[:, i : i + 1], self.ramp, self.samples) for i in (0, 1))
        # local amplitude, sharper than the feature: three halves of a hop
        local = nnf.avg_pool1d(modulus, 3 * self.fine, self.fine, padding=self.fine, count_include_pad=False)
        local = _interpolate(local, self.fine_ramp, self.samples)
        return x * (keep * (1 + subtract) * (1 - subtract * local / modulus)), envelope


class _Spectrum(nn.Module):
    """Stage 2: soft limit on the smoothed spectrum, (B, 2, N) -> (B, 2, N)."""

    def __init__(self, samples: int, smooth: int = 25, step: int = 5) -> None:
        super().__init__()
        self.samples, self.smooth, self.step = samples, smooth, step
        factors = _factors(samples)
        self.forward_dft = MatrixDft(factors)
        self.inverse_dft = MatrixDft(factors, inverse=True)
        self.hidden = nn.Conv1d(4, 8, 3, padding=1)
        self.out = nn.Conv1d(8, 2, 3, padding=1)
        self.register_buffer("repeat", torch.ones(step, 1, 1), persistent=False)
        # gain = (1 + S/(c H))^-a: c starts at 4, a at 1
        self.depth = nn.Parameter(torch.tensor(1.0))
        self.offset = nn.Parameter(torch.tensor(1.4))
        with torch.no_grad():
            self.out.weight.mul_(0.05)
            self.out.bias.zero_()

    def forward(self, x: Tensor) -> Tensor:
        """See the class."""
        spectrum = self.forward_dft(x)
        squares = spectrum * spectrum
        power = squares[:, :1] + squares[:, 1:]
        half = (self.smooth - self.step) // 2
        wrapped = torch.cat([power[..., -half:], power, power[..., :half]], 2)
        smooth = nnf.avg_pool1d(wrapped, self.smooth, self.step) + 1e-6
        floor = 1.0 / (1.0 / smooth).mean(2, keepdim=True)  # harmonic mean: the quiet part of the band
        wide = nnf.avg_pool1d(smooth, 15, 1, padding=7, count_include_pad=False)
        level = torch.log(smooth)
        middle = level.mean(2, keepdim=True)
        over = level - torch.log(floor)
        features = torch.cat([over, torch.log(wide) - level, level - middle, over - (level - middle)], 1)
        change = self.out(torch.tanh(self.hidden(0.3 * features)))
        exponent = self.depth * torch.exp(change[:, 1:])
        gain = torch.exp(-exponent * nnf.softplus(over - self.offset + change[:, :1]))
        gain = nnf.conv1d(gain, self.repeat).transpose(1, 2).reshape(-1, 1, self.samples)
        return self.inverse_dft(spectrum * gain)


def _factors(samples: int) -> tuple[int, int, int]:
    """Three whole factors with the smallest sum: the cheapest `MatrixDft`. (12, 25, 25) for 7500."""
    divisors = [d for d in range(1, samples + 1) if samples % d == 0]
    triples = [
        (a, b, samples // (a * b)) for a in divisors for b in divisors if samples % (a * b) == 0 and a <= b
    ]
    return min((t for t in triples if t[1] <= t[2]), key=sum)


class Compact(nn.Module):
    """The whole: (B, 2, N) float32 of joint unit RMS in, the same out."""

    normalisation = "joint_rms"

    def __init__(self, waveform: Waveform, settings: CompactSettings | None = None) -> None:
        super().__init__()
        settings = settings or CompactSettings()
        self.settings = settings
        samples = waveform.samples_per_frame
        bins = range(-settings.reach, settings.reach + 1)
        self.dechirp = Dechirp(waveform)
        self.bank = FourierBank(samples, settings.kernel, settings.hop, bins)
        self.modulus = _Modulus(settings, len(bins), samples) if settings.modulus else None
        self.spectrum = _Spectrum(samples) if settings.spectrum else None
        c, b = settings.channels, len(bins)
        entering = 3 * b + 1 + (5 + b if settings.modulus else 0)
        self.enter = nn.Conv1d(entering, c, 4, stride=2, padding=1)
        self.position = nn.Parameter(torch.zeros(1, c, self.bank.steps // 2))
        self.blocks = nn.Sequential(*(GatedBlock(c, d) for d in settings.dilations))
        self.leave = nn.ConvTranspose1d(c, b, 4, stride=2, padding=1)
        with torch.no_grad():
            self.leave.weight.mul_(0.1)
            self.leave.bias.fill_(2.0)

    def forward(self, x: Tensor) -> Tensor:
        """Clean frames."""
        extra: list[Tensor] = []
        if self.modulus is not None:
            raw_power = self.bank.power(self.bank(self.dechirp(x)))
            x, envelope = self.modulus(x, raw_power)
            extra = [0.25 * envelope, 0.25 * log_power(raw_power)]
        if self.spectrum is not None:
            x = self.spectrum(x)
        cells = self.bank(self.dechirp(x))
        return self.dechirp.back(self.bank.back(cells * self._gain(cells, extra)))

    def _gain(self, cells: Tensor, extra: list[Tensor]) -> Tensor:
        """(B, 2 bins, L) gain of every cell, from its log power, its share and phase, and the envelope."""
        power = self.bank.power(cells)
        total = power.sum(1, keepdim=True)
        level = log_power(total)
        average = level.mean(2, keepdim=True)
        share = cells / torch.sqrt(total + 1e-9)
        features = [0.5 * (log_power(power) - average), share, 0.5 * (level - average)]
        h = self.enter(torch.cat(features + extra, 1)) + self.position
        gain = torch.sigmoid(self.leave(self.blocks(h)))
        return torch.cat([gain, gain], 1)
