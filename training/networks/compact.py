"""`compact`: our temporal convolutional autoencoder, and the variants it was compared with.

Three stages, all inside one feed-forward graph of an IQ frame:

1. *Modulus*. An interferer of constant envelope (rectangular QPSK, FMCW, a tone) moves only the phase of
   what is received: ``x - A x/|x|`` with ``A`` the local mean of ``|x|`` takes it away and leaves half of the
   return and its image, whatever the SIR (the locally optimum zero-memory nonlinearity). A small gated
   network decides where, from the spread of the envelope and from how much of the power lies on the sweep.
   It also levels bursts in time, and how far samples off the mean modulus (symbol edges) count.
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

from radalt.core.mitigation.any_sweep import COLUMNS, FILTER_HOPS, HOP, Layout, factors_of
from radalt.core.waveform import Waveform

from .layers import (
    BandGain,
    FourierBank,
    GatedStack,
    Given,
    RowConv,
    Same,
    Tables,
    dechirped,
    from_blocks,
    log_power,
    rechirped,
    sizes_of,
    to_blocks,
)

__all__ = ["Compact", "CompactSettings"]


_WIDE_CELLS = 75  # of the DFT: the surroundings that a gain's power is compared with


@dataclass(frozen=True)
class CompactSettings:
    """Sizes and which stages exist.

    ``reach`` bins on each side of zero beat are kept. ``spectrum_step`` cells of the frame's DFT share a gain, whose
    input is the mean over ``spectrum_smooth`` such groups (odd).
    """

    reach: int = 3
    channels: int = 32
    dilations: tuple[int, ...] = (1, 2, 4, 8, 16, 32, 1)
    modulus: bool = True
    spectrum: bool = True
    spectrum_step: int = 5
    spectrum_smooth: int = 5


def _spread(blocks: Tensor, weights: Tensor) -> Tensor:
    """(B, C, L) values of blocks -> (B, hop, L) of samples, the outermost blocks going on outside."""
    return nnf.conv1d(nnf.pad(blocks, (1, 1), mode="replicate"), weights)


class _Modulus(nn.Module):
    """Stage 1: (B, 2, N) -> (B, 2, N)."""

    def __init__(self, bins: int) -> None:
        super().__init__()
        width = 16
        self.enter = RowConv(bins + 5, width, 4, stride=2, padding=1)
        self.blocks = GatedStack(width, (1, 4))
        self.leave = nn.ConvTranspose1d(width, 3, 4, stride=2, padding=1)
        with torch.no_grad():
            self.leave.weight.mul_(0.1)
            # subtract little, level nothing, hardly prefer samples near the mean modulus
            self.leave.bias.copy_(torch.tensor([-2.0, 3.0, -4.0]))

    def forward(self, x: Tensor, beat_power: Tensor, tables: Tables) -> tuple[Tensor, Tensor, Tensor]:
        """Cleaned frame, (B, 5, L) envelope features and log powers of the beat band's cells, from the frame and the
        powers of those cells."""
        hop, columns = sizes_of(tables)
        power = (x * x).sum(1).reshape(-1, columns, hop).transpose(1, 2) + 1e-12
        modulus = torch.sqrt(power)
        halves = torch.matmul(tables.halves, modulus)  # mean modulus of half blocks, (B, 2, L)
        short = torch.matmul(tables.halves, power).mean(1, keepdim=True)
        means = torch.cat([halves.mean(1, keepdim=True), short], 1)
        means = nnf.avg_pool1d(means, 3, 1, padding=1, count_include_pad=False)
        mean, mean_power = means[:, :1], means[:, 1:]
        variance = (mean_power - mean * mean).clamp(min=0)
        share = torch.cat([variance, beat_power.sum(1, keepdim=True)], 1) / (mean_power + 1e-12)
        logs = torch.log(torch.cat([share + 1e-7, means[:, 1:] + 1e-9, short + 1e-9, beat_power + 1e-9], 1))
        level = logs[:, 2:3]
        average = level.mean(2, keepdim=True)
        over = logs[:, 2:] - average
        envelope = torch.cat([over[:, :1], logs[:, :1], over[:, 1:2], logs[:, 1:2], level - over[:, :1]], 1)
        features = torch.cat([envelope, over[:, 2:]], 1)
        h = self.enter(features, [0.25] * features.shape[1])
        control = self.leave(self.blocks(h))
        subtract, keep = (_spread(torch.sigmoid(control[:, i : i + 1]), tables.ramp) for i in (0, 1))
        prefer = _spread(torch.exp(control[:, 2:].clamp(max=12.0)), tables.ramp)
        ratio = _spread(halves, tables.local) / modulus
        off = 1 - ratio
        # a sample far off the mean modulus (a symbol's edge, another interferer) says little about the return
        factor = keep * (1 + subtract) * (1 - subtract * ratio) / (1 + prefer * (off * off))
        return x * factor.transpose(1, 2).reshape(-1, 1, hop * columns), envelope, logs[:, 4:]


class _Spectrum(nn.Module):
    """Stage 2: soft limit on the smoothed spectrum, (B, 2, N) -> (B, 2, N)."""

    def __init__(self, settings: CompactSettings) -> None:
        super().__init__()
        self.smooth, self.wide = settings.spectrum_smooth, _WIDE_CELLS // settings.spectrum_step | 1
        self.hidden = nn.Conv1d(4, 8, 3, padding=1)
        self.out = nn.Conv1d(8, 2, 3, padding=1)
        # gain = (1 + S/(c H))^-a: c starts at 4, a at 1
        self.depth = nn.Parameter(torch.tensor(1.0))
        self.offset = nn.Parameter(torch.tensor(1.4))
        with torch.no_grad():
            self.out.weight.mul_(0.05)
            self.out.bias.zero_()

    def forward(self, x: Tensor, tables: Tables) -> Tensor:
        """See the class."""
        dft = BandGain(tables)
        spectrum, power = dft.analyse(x)
        side = self.smooth // 2
        wrapped = torch.cat([power[..., -side:], power, power[..., :side]], 2)  # the band is a circle
        smooth = nnf.avg_pool1d(wrapped, self.smooth, 1) + 1e-6
        floor = 1.0 / (1.0 / smooth).mean(2, keepdim=True)  # harmonic mean: the quiet part of the band
        wide = nnf.avg_pool1d(smooth, self.wide, 1, padding=self.wide // 2, count_include_pad=False)
        level = torch.log(smooth)
        middle = level.mean(2, keepdim=True)
        over = level - torch.log(floor)
        features = torch.cat([over, torch.log(wide) - level, level - middle, over - (level - middle)], 1)
        # factors and offsets go into the weights, which are constants once exported
        hidden = torch.tanh(nnf.conv1d(features, 0.3 * self.hidden.weight, self.hidden.bias, padding=1))
        bias = self.out.bias - torch.stack([self.offset, torch.zeros_like(self.offset)])
        change = nnf.conv1d(hidden, self.out.weight, bias, padding=1)
        exponent = -self.depth * torch.exp(change[:, 1:])
        excess = torch.exp((over + change[:, :1]).clamp(max=60.0))
        gain = torch.exp(exponent * torch.log(1 + excess))
        return dft.synthesise(spectrum, gain)


class Compact(nn.Module):
    """The whole: (B, 2, N) float32 of joint unit RMS in, the same out.

    Its weights belong to no sweep; `forward` takes those of the waveform, or the tables of another sweep.
    """

    normalisation = "joint_rms"

    def __init__(self, waveform: Waveform, settings: CompactSettings | None = None) -> None:
        super().__init__()
        settings = settings or CompactSettings()
        self.settings = settings
        bins = range(-settings.reach, settings.reach + 1)
        samples, group = waveform.samples_per_frame, settings.spectrum_step
        layout = Layout(HOP, samples // HOP, group, factors_of(samples, group))
        self.tables = Tables(waveform, layout)
        self.bank = FourierBank(FILTER_HOPS * HOP, HOP, bins)
        self.modulus = _Modulus(len(bins)) if settings.modulus else None
        self.spectrum = _Spectrum(settings) if settings.spectrum else None
        c, b = settings.channels, len(bins)
        # what belongs to cells and what to whole columns apart: ONNX Runtime is fast with multiples of four channels,
        # 28 here, and with few
        cells, columns = (4 * b, 6) if settings.modulus else (3 * b, 1)
        self.enter = RowConv(cells, c, 4, stride=2, padding=1)
        self.enter_columns = RowConv(columns, c, 4, bias=False, stride=2, padding=1)
        self.position = nn.Parameter(torch.zeros(1, c, COLUMNS // 2))
        self.same = Same(c)
        self.blocks = GatedStack(c, settings.dilations)
        self.leave = nn.ConvTranspose1d(c, b, 4, stride=2, padding=1)
        with torch.no_grad():
            self.leave.weight.mul_(0.1)
            self.leave.bias.fill_(2.0)

    def forward(self, x: Tensor, tables: Tables | Given | None = None) -> Tensor:
        """Clean frames of the own sweep, or of the one that ``tables`` are of."""
        if tables is None:
            tables, position = self.tables, self.position
            analysis, synthesis = self.bank.analysis, self.bank.synthesis
        else:
            position = torch.matmul(self.position, tables.place)
            analysis, synthesis = self.bank.filters(tables.stretch)
        envelope = raw = None
        if self.modulus is not None:
            power = self.bank.power(self.bank(to_blocks(dechirped(x, tables), *sizes_of(tables)), analysis))
            x, envelope, raw = self.modulus(x, power, tables)
        if self.spectrum is not None:
            x = self.spectrum(x, tables)
        cells = self.bank(to_blocks(dechirped(x, tables), *sizes_of(tables)), analysis)
        gain = self._gain(cells, envelope, raw, position)
        return rechirped(from_blocks(self.bank.back(cells * gain, synthesis), *sizes_of(tables)), tables)

    def _gain(self, cells: Tensor, envelope: Tensor | None, raw: Tensor | None, position: Tensor) -> Tensor:
        """(B, 2 bins, L) gain of every cell, from its log power, its share and phase, and the envelope."""
        power = self.bank.power(cells)
        total = power.sum(1, keepdim=True)
        level = log_power(total)
        average = level.mean(2, keepdim=True)
        bins = self.bank.bins
        of_cells = [log_power(power) - average, cells / torch.sqrt(total + 1e-9)]
        of_columns = [level - average]
        scales, column_scales = [0.5] * bins + [1.0] * 2 * bins, [0.5]
        if envelope is not None:
            of_cells.append(raw)
            of_columns.append(envelope)
            scales += [0.25] * bins
            column_scales += [0.25] * 5
        entered = self.enter(torch.cat(of_cells, 1), scales)
        entered = entered + self.enter_columns(torch.cat(of_columns, 1), column_scales)
        placed = entered.squeeze(2) + position
        gain = torch.sigmoid(self.leave(self.blocks(self.same(placed.unsqueeze(2)))))
        return torch.cat([gain, gain], 1)
