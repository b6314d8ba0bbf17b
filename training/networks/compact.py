"""`compact`: our temporal convolutional autoencoder, and the variants it was compared with.

Three stages in one feed-forward graph of an IQ frame:

1. *Modulus*. An interferer of constant envelope (rectangular QPSK, FMCW, a tone) moves only the phase of
   the received signal: ``x - A x/|x|`` with ``A`` the local mean of ``|x|`` removes it and leaves half of the
   return and its image, at any SIR (the locally optimum zero-memory nonlinearity). A small gated
   network decides where, from the spread of the envelope and from how much of the power lies on the sweep.
   It also levels bursts in time, and weights samples off the mean modulus (symbol edges).
2. *Spectrum*. A DFT of the frame, a learned soft limit on the smoothed power spectrum, the inverse DFT:
   stationary interference narrower than the sweep.
3. *Beat-domain autoencoder*. Multiplication by the conjugate sweep, a strided filterbank over the beat band
   (encoder), gated dilated residual blocks on log powers and phases (bottleneck), a gain for each
   time-frequency cell, transposed convolution and the sweep again (decoder).

At initialisation the network is the identity over the beat band.
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
    Doubling,
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


_WIDE_CELLS = 75  # DFT cells around a gain, with whose mean its power is compared


@dataclass(frozen=True)
class CompactSettings:
    """Sizes and stages.

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
    """(B, C, L) values of blocks -> (B, hop, L) of samples; the outermost blocks continue outside."""
    return nnf.conv1d(nnf.pad(blocks, (1, 1), mode="replicate"), weights)


class _Modulus(nn.Module):
    """Stage 1: (B, 2, N) -> (B, 2, N)."""

    def __init__(self, bins: int) -> None:
        super().__init__()
        width = 16
        self.enter = RowConv(bins + 5, width, 4, stride=2, padding=1)
        self.blocks = GatedStack(width, (1, 4))
        self.leave = Doubling(width, 3)
        with torch.no_grad():
            self.leave.weight.mul_(0.1)
            # subtract little, level nothing, hardly prefer samples near the mean modulus
            self.leave.bias.copy_(torch.tensor([-2.0, 3.0, -4.0]))

    def mixing(self) -> list[list[float]]:
        """(bins + 5, bins + 5) features from the rows of logarithms that `forward` returns, one below the other.

        Five of the envelope, then log powers of the beat band's cells over the frame's mean level, which is the last
        row less the third. These sums are part of the weights of the layer that takes the features: to slice, subtract
        and concatenate rows takes as long as a convolution.
        """
        count = self.enter.in_channels
        of_rows = [[float(row == column) for column in range(count)] for row in range(count)]
        spread, share, level, short = of_rows[:4]
        mean = [last - over for last, over in zip(of_rows[-1], level, strict=True)]
        return [level, spread, short, share, mean, *of_rows[4:-1]]

    def forward(
        self, x: Tensor, blocks: Tensor, beat_power: Tensor, tables: Tables
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Cleaned frame, (B, bins + 4, L) logarithms and (B, 1, L) log power, of which `mixing` makes features.

        From the frame, its dechirped blocks, whose samples have the same modulus, and the powers of the beat band's
        cells.
        """
        hop, columns = sizes_of(tables)
        power = (blocks * blocks).reshape(-1, 2, hop, columns).sum(1) + 1e-12
        modulus = torch.sqrt(power)
        halves = torch.matmul(tables.halves, modulus)  # mean modulus of half blocks, (B, 2, L)
        short = torch.matmul(tables.halves.mean(0, keepdim=True), power)
        means = torch.cat([halves.mean(1, keepdim=True), short], 1)
        means = nnf.avg_pool1d(means, 3, 1, padding=1, count_include_pad=False)
        mean, mean_power = means[:, :1], means[:, 1:]
        variance = (mean_power - mean * mean).clamp(min=0)
        share = torch.cat([variance, beat_power.sum(1, keepdim=True)], 1) / (mean_power + 1e-12)
        logs = torch.log(torch.cat([share + 1e-7, torch.cat([mean_power, short, beat_power], 1) + 1e-9], 1))
        level = logs[:, 2:3]
        over = logs.new_tensor([0.0, 0.0] + [1.0] * (self.enter.in_channels - 3))[:, None]  # the mean level
        logs = logs - over * level.mean(2, keepdim=True)
        mixing = [[0.25 * value for value in row] for row in self.mixing()]
        h = self.enter.mixed(torch.cat([logs, level], 1), mixing, self.enter.weight)
        control = self.leave(self.blocks(h), columns)
        subtract, keep = (_spread(torch.sigmoid(control[:, i : i + 1]), tables.ramp) for i in (0, 1))
        prefer = _spread(torch.exp(control[:, 2:].clamp(max=12.0)), tables.ramp)
        ratio = _spread(halves, tables.local) / modulus
        off = 1 - ratio
        # a sample far off the mean modulus (a symbol edge, another interferer) has little of the return
        factor = keep * (1 + subtract) * (1 - subtract * ratio) / (1 + prefer * (off * off))
        return x * factor.transpose(1, 2).reshape(-1, 1, hop * columns), logs, level


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
    """The network: (B, 2, N) float32 of joint unit RMS in, (B, 2, N) out.

    Its weights do not depend on the sweep; `forward` uses the tables of the waveform, or those of another sweep.
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
        # weights of the features of cells, and of those of columns
        cells, columns = (4 * b, 6) if settings.modulus else (3 * b, 1)
        self.enter = RowConv(cells, c, 4, stride=2, padding=1)
        self.enter_columns = RowConv(columns, c, 4, bias=False, stride=2, padding=1)
        self.position = nn.Parameter(torch.zeros(1, c, COLUMNS // 2))
        self.same = Same(c)
        self.blocks = GatedStack(c, settings.dilations)
        self.leave = Doubling(c, b)
        with torch.no_grad():
            self.leave.weight.mul_(0.1)
            self.leave.bias.fill_(2.0)

    def forward(self, x: Tensor, tables: Tables | Given | None = None) -> Tensor:
        """Clean frames of its own sweep, or of that of ``tables``."""
        if tables is None:
            tables, position = self.tables, self.position
            analysis, synthesis = self.bank.analysis, self.bank.synthesis
        else:
            position = torch.matmul(self.position, tables.place)
            analysis, synthesis = self.bank.filters(tables.stretch)
        logs = level = None
        if self.modulus is not None:
            blocks = to_blocks(dechirped(x, tables), *sizes_of(tables))
            power = self.bank.power(self.bank(blocks, analysis))
            x, logs, level = self.modulus(x, blocks, power, tables)
        if self.spectrum is not None:
            x = self.spectrum(x, tables)
        cells = self.bank(to_blocks(dechirped(x, tables), *sizes_of(tables)), analysis)
        gain = self._gain(cells, logs, level, position, sizes_of(tables)[1])
        return rechirped(from_blocks(self.bank.back(cells * gain, synthesis), *sizes_of(tables)), tables)

    def _gain(
        self, cells: Tensor, logs: Tensor | None, level: Tensor | None, position: Tensor, columns: int
    ) -> Tensor:
        """(B, 2 bins, L) gains of cells from their log power, share and phase, and the modulus stage's logarithms."""
        power = self.bank.power(cells)
        total = power.sum(1, keepdim=True)
        log_total = log_power(total)
        average = log_total.mean(2, keepdim=True)
        rows = [log_power(power) - average, cells / torch.sqrt(total + 1e-9)]
        few = [log_total - average]
        if logs is not None:
            rows.append(logs)
            few.append(level)
        # separate convolutions: ONNX Runtime is fast with multiples of sixteen channels, 32 here, and with few
        mixing, split = self._mixing(), -len(few)
        weight = torch.cat([self.enter.weight, self.enter_columns.weight], 1)
        entered = self.enter.mixed(torch.cat(rows, 1), [row[:split] for row in mixing], weight)
        few_mixing = [row[split:] for row in mixing]
        entered = entered + self.enter_columns.mixed(torch.cat(few, 1), few_mixing, weight)
        placed = entered.squeeze(2) + position
        gain = self.leave(self.blocks(self.same(placed.unsqueeze(2))), columns, torch.sigmoid)
        return torch.cat([gain, gain], 1)

    def _mixing(self) -> list[list[float]]:
        """(features, rows) matrix of `_gain`: features of cells, then of columns, from its rows, those of columns last.

        Features are scaled to about one: log powers by a half, shares by one, the modulus' logarithms by a quarter.
        """
        bins = self.bank.bins
        scales = [0.5] * bins + [1.0] * 2 * bins
        logs = [] if self.modulus is None else self.modulus.mixing()
        width = len(scales) + len(logs) + 1
        column = [0.0] * width
        column[len(scales) + len(logs) - 1 if logs else -1] = 0.5
        shares = [[scale * (row == k) for k in range(width)] for row, scale in enumerate(scales)]

        def placed(row: list[float]) -> list[float]:
            return [0.0] * len(scales) + [0.25 * v for v in row[:-1]] + [0.0] + [0.25 * v for v in row[-1:]]

        raw = [[a + b for a, b in zip(row, logs[4], strict=True)] for row in logs[5:]]
        return [*shares, *map(placed, raw), column, *map(placed, logs[:5])]
