"""Building blocks that export to plain ONNX operators: sweep tables, filterbanks, DFT by matrices, gated blocks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as nnf

from radalt.core.mitigation.any_sweep import Layout, tables_of
from radalt.core.waveform import Waveform

__all__ = [
    "BandGain",
    "Doubling",
    "FourierBank",
    "GatedStack",
    "Given",
    "RowConv",
    "Same",
    "Tables",
    "dechirped",
    "from_blocks",
    "log_power",
    "rechirped",
    "shifted",
    "sizes_of",
    "to_blocks",
]


def _constant(values: np.ndarray) -> Tensor:
    return torch.tensor(np.ascontiguousarray(values), dtype=torch.float32)


def log_power(power: Tensor) -> Tensor:
    """Natural logarithm with a floor 90 dB under unit power."""
    return torch.log(power + 1e-9)


def to_blocks(x: Tensor, hop: int, columns: int) -> Tensor:
    """Frames (B, 2, N) -> (B, 2 hop, columns): sample ``hop t + m`` in column t at row m, its quadrature ``hop`` below.

    Frames may have any shape of as many samples, since each reshape is an operator. In this order sums over a block,
    steps from block to block and the filterbank are matrix products, where strided convolutions over 7500 samples
    spend their time gathering.
    """
    return x.reshape(-1, 2, columns, hop).transpose(2, 3).reshape(-1, 2 * hop, columns)


def from_blocks(z: Tensor, hop: int, columns: int) -> Tensor:
    """Inverse of `to_blocks`, as `rechirped` takes it: (B, 1, 2 N)."""
    return z.reshape(-1, 2, hop, columns).transpose(2, 3).reshape(-1, 1, 2 * columns * hop)


def shifted(x: Tensor, columns: int) -> Tensor:
    """Columns shifted to the right (left if negative), filled with zeros."""
    return nnf.pad(x, (columns, -columns)) if columns else x


class Tables(nn.Module):
    """The constants of a sweep (`radalt.core.mitigation.any_sweep.tables_of`) as buffers of a network."""

    def __init__(self, waveform: Waveform, layout: Layout) -> None:
        super().__init__()
        for name, values in tables_of(waveform, layout).items():
            self.register_buffer(name, _constant(values), persistent=False)

    def state(self) -> dict[str, Tensor]:
        """All tables by name."""
        return dict(self.named_buffers())


class Given:
    """Tables as inputs of a graph: attributes by name."""

    def __init__(self, tables: Mapping[str, Tensor]) -> None:
        vars(self).update(tables)


def sizes_of(tables: Tables | Given) -> tuple[int, int]:
    """Samples per column, columns. Taken from the tables they are constants of an exported graph, unlike a frame's."""
    hop = tables.halves.shape[1]
    return hop, tables.cosine.shape[1] // hop


class _Rotation(torch.autograd.Function):
    """`rotated` as one operator of ONNX Runtime (1.17 and later), the rotary embedding of language models."""

    @staticmethod
    def forward(ctx: object, rows: Tensor, first: Tensor, cosine: Tensor, sine: Tensor) -> Tensor:
        """See `rotated`."""
        del ctx, first
        return _rotated(rows, cosine, sine)

    @staticmethod
    def symbolic(graph, rows, first, cosine, sine):  # noqa: ANN001, ANN205 - values of a graph
        """The operator, whose output is shaped as its first input."""
        return graph.op("com.microsoft::RotaryEmbedding", rows, first, cosine, sine).setType(rows.type())


def rotated(rows: Tensor, cosine: Tensor, sine: Tensor, tables: Tables | Given) -> Tensor:
    """(B, L, 2 h) rows of real, then imaginary parts times ``cosine + j sine``, each (L, h).

    A network for one sweep is exported with a single operator for it, which takes a quarter of the time of plain ones.
    CUDA has that operator for short rows only, so `any_sweep.onnx`, which runs there, has the plain ones.
    """
    if torch.onnx.is_in_onnx_export() and isinstance(tables, Tables):
        return _Rotation.apply(rows, torch.zeros(1, dtype=torch.int64), cosine, sine)
    return _rotated(rows, cosine, sine)


def _rotated(rows: Tensor, cosine: Tensor, sine: Tensor) -> Tensor:
    size = rows.shape[1:]
    swapped = rows.reshape(-1, size[0], 2, size[1] // 2)[:, :, [1, 0]].reshape(-1, *size)
    return rows * torch.cat([cosine, cosine], 1) + swapped * torch.cat([-sine, sine], 1)


def dechirped(x: Tensor, tables: Tables | Given) -> Tensor:
    """Frames (B, 2, N), or as many samples in any shape, times the conjugate sweep: (B, 1, 2 N).

    Both halves keep their sign, so a return has beats of ``-k tau`` on the way up and ``+k tau`` on the way
    down and the product is continuous over the apex.
    """
    return rotated(x.reshape(-1, 1, 2 * tables.cosine.shape[1]), tables.cosine, -tables.sine, tables)


def rechirped(x: Tensor, tables: Tables | Given) -> Tensor:
    """(B, 1, 2 N) back to the received band, with the filterbank's norm: (B, 2, N)."""
    cosine, sine = tables.cosine * tables.norm, tables.sine * tables.norm
    return rotated(x, cosine, sine, tables).reshape(-1, 2, cosine.shape[1])


class FourierBank(nn.Module):
    """Strided filterbank of a two-channel (I, Q) signal, initialised as a Hann-windowed DFT.

    It is a matrix product per block and a sum over neighbouring blocks.

    Parameters
    ----------
    kernel, hop : int
        Samples of a filter, and of a block: ``kernel`` is an odd multiple of ``hop``.
    bins : sequence of int
        DFT bins of ``kernel`` points that are kept.

    Notes
    -----
    Both calls take matrices: the parameters ``analysis`` and ``synthesis``, or `filters` for blocks of another length.
    """

    def __init__(self, kernel: int, hop: int, bins: range) -> None:
        super().__init__()
        self.hop, self.bins, self.spans = hop, len(bins), kernel // hop
        n = np.arange(kernel)
        window = 0.5 - 0.5 * np.cos(2 * np.pi * (n + 0.5) / kernel)
        atoms = window * np.exp(2j * np.pi * np.outer(list(bins), n - 0.5 * (kernel - 1)) / kernel)
        # real part: <atom, x>, imaginary part: its quadrature; channel order re(all bins), im(all bins)
        filters = np.stack(
            [np.concatenate([atoms.real, -atoms.imag]), np.concatenate([atoms.imag, atoms.real])], 1
        )
        # (2 bins, I and Q, blocks a filter spans, hop)
        parts = filters.reshape(2 * self.bins, 2, self.spans, hop)
        self.analysis = nn.Parameter(
            _constant(parts.transpose(2, 0, 1, 3).reshape(-1, 2 * hop) / np.sqrt(kernel))
        )
        self.synthesis = nn.Parameter(_constant(parts.transpose(1, 3, 2, 0).reshape(2 * hop, -1)))

    def filters(self, stretch: Tensor) -> tuple[Tensor, Tensor]:
        """Matrices of both directions for blocks of another length: (spans 2 bins, 2 h) and (2 h, spans 2 bins)."""
        spans, channels, hop = self.spans, 2 * self.bins, self.hop
        there = self.analysis.reshape(spans, channels, 2, hop).permute(1, 2, 0, 3)
        back = self.synthesis.reshape(2, hop, spans, channels).permute(3, 0, 2, 1)
        there, back = (torch.matmul(w.reshape(-1, spans * hop), stretch) for w in (there, back))
        there, back = (w.reshape(channels, 2, spans, -1) for w in (there, back))
        return there.permute(2, 0, 1, 3).flatten(2).flatten(0, 1), back.permute(1, 3, 2, 0).flatten(
            2
        ).flatten(0, 1)

    def forward(self, z: Tensor, analysis: Tensor) -> Tensor:
        """(B, 2 h, L) blocks -> (B, 2 bins, L)."""
        parts = torch.matmul(analysis, z).split(2 * self.bins, 1)
        return sum(shifted(part, self.spans // 2 - k) for k, part in enumerate(parts))

    def back(self, cells: Tensor, synthesis: Tensor) -> Tensor:
        """(B, 2 bins, L) -> (B, 2 h, L), times ``norm`` the inverse over the band of the kept bins."""
        if synthesis is not self.synthesis:  # an exported convolution needs fixed sizes of its weights
            around = torch.cat([shifted(cells, k - self.spans // 2) for k in range(self.spans)], 1)
            return torch.matmul(synthesis, around)
        # without shifting and concatenating columns: 0.99 of the graph's time
        weight = synthesis.reshape(-1, self.spans, 2 * self.bins).flip(1).transpose(1, 2)
        return nnf.conv1d(cells, weight, padding=self.spans // 2)

    def power(self, cells: Tensor) -> Tensor:
        """(B, bins, L) power of each cell."""
        squares = cells * cells
        return squares[:, : self.bins] + squares[:, self.bins :]


class BandGain:
    """Gain over frequency: DFT of ``a b c`` points, power of ``group`` cells at a time, a gain for each, inverse DFT.

    ONNX Runtime's own DFT takes 2.2 ms for 7500 points. The exported one is three matrix products and one twiddle each
    way (`radalt.core.mitigation.any_sweep.dft_tables`). Cells stay in the order (k1, k2, k3) of the products; only
    powers and gains, fewer by ``group``, are brought into the order of frequency and back. Training uses `torch.fft`;
    `export.py` checks that both give the same.
    """

    def __init__(self, tables: Tables) -> None:
        self.tables = tables
        self.group = tables.group.shape[0]
        self.factors = tuple(tables.turn_re.shape)

    def analyse(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """(B, 2, N) -> spectrum, for `synthesise`, and mean powers (B, 1, N / group) by frequency."""
        if torch.onnx.is_in_onnx_export():
            return self.analyse_matrices(x)
        spectrum = torch.fft.fft(torch.complex(x[:, 0], x[:, 1]))
        planes = torch.view_as_real(spectrum)
        power = (planes * planes).sum(2)
        return spectrum, power.reshape(x.shape[0], 1, -1, self.group).mean(3)

    def synthesise(self, spectrum: Tensor, gain: Tensor) -> Tensor:
        """Spectrum of `analyse` times gains (B, 1, N / group) -> (B, 2, N), in another shape when exported."""
        if torch.onnx.is_in_onnx_export():
            return self.synthesise_matrices(spectrum, gain)
        wide = gain[:, 0].repeat_interleave(self.group, 1)
        return torch.view_as_real(torch.fft.ifft(spectrum * wide)).transpose(1, 2)

    def _turn(self) -> tuple[Tensor, Tensor]:
        """Twiddles as rows, (a b, c)."""
        return self.tables.turn_re.flatten(0, 1), self.tables.turn_im.flatten(0, 1)

    def analyse_matrices(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """`analyse` as exported; the spectrum is (B, a b, 2 c) in the order (k1, k2, real or imaginary, k3)."""
        t, (a, b, c), groups = self.tables, self.factors, self.factors[0] // self.group
        y = torch.matmul(t.first, x.reshape(-1, 2 * a, b * c)).reshape(-1, a, 2 * b, c)
        y = torch.matmul(t.second, y).reshape(-1, a * b, 2 * c)
        spectrum = torch.matmul(rotated(y, *self._turn(), t), t.third)
        power = (spectrum * spectrum).reshape(-1, groups, self.group, 2 * b * c).sum(2)
        power = power.reshape(-1, groups, b, 2 * c).transpose(1, 2).reshape(-1, groups * b, 2 * c)
        # sums real and imaginary part's and transposes in one: (B, k3, (k2, k1 // group))
        power = torch.matmul(t.both / self.group, power.transpose(1, 2))
        return spectrum, power.reshape(-1, 1, groups * b * c)

    def synthesise_matrices(self, spectrum: Tensor, gain: Tensor) -> Tensor:
        """`synthesise` as exported, (B, 2 a, b c)."""
        t, (a, b, c), groups = self.tables, self.factors, self.factors[0] // self.group
        # (B, (k2, k1 // group), 2 c)
        gain = torch.matmul(gain.reshape(-1, c, b * groups).transpose(1, 2), t.both)
        gain = gain.reshape(-1, b, groups, 2 * c).transpose(1, 2)
        gain = gain.reshape(-1, groups, 1, 2 * b * c)  # long runs: short broadcasts are slow
        y = (spectrum.reshape(-1, groups, self.group, 2 * b * c) * gain).reshape(-1, a * b, 2 * c)
        cosine, sine = self._turn()
        y = rotated(torch.matmul(y, t.back_third), cosine, -sine, t)
        y = torch.matmul(t.back_second, y.reshape(-1, a, 2 * b, c))
        return torch.matmul(t.back_first, y.reshape(-1, 2 * a, b * c))


class GatedBlock(nn.Module):
    """Gated dilated residual block: ``h + W (tanh(F h) sigmoid(G h))``, kernel 3 (WaveNet's unit, not causal).

    Its convolutions have two dimensions, one with a single row: ONNX Runtime computes those in its blocked layout,
    nonlinearities included, in 0.78 of the time of one-dimensional ones.
    """

    def __init__(self, channels: int, dilation: int) -> None:
        super().__init__()
        shape = {"kernel_size": (1, 3), "padding": (0, dilation), "dilation": (1, dilation)}
        self.filter = nn.Conv2d(channels, channels, **shape)
        self.gate = nn.Conv2d(channels, channels, **shape)
        self.mix = nn.Conv2d(channels, channels, 1)
        with torch.no_grad():
            self.mix.weight.mul_(0.3)
            self.mix.bias.zero_()

    def forward(self, h: Tensor) -> Tensor:
        """(B, C, 1, L) -> (B, C, 1, L)."""
        return h + self.mix(torch.tanh(self.filter(h)) * torch.sigmoid(self.gate(h)))


class RowConv(nn.Conv2d):
    """Convolution of (B, C, L) to (B, C', 1, L'): see `GatedBlock`."""

    def __init__(self, entering: int, leaving: int, kernel: int, *, bias: bool = True, **shape: int) -> None:
        row = {name: (1 if name == "stride" else 0, value) for name, value in shape.items()}
        super().__init__(entering, leaving, (1, kernel), bias=bias, **row)

    def mixed(self, rows: Tensor, mixing: Sequence[Sequence[float]], weight: Tensor) -> Tensor:
        """See the class, of features ``mixing`` times rows (B, R, L), with weights (C', C, 1, kernel).

        The (C, R) factors go into the weights, which are constants once exported.
        """
        weight = torch.matmul(weight.permute(0, 2, 3, 1), weight.new_tensor(mixing)).permute(0, 3, 1, 2)
        return self._conv_forward(rows.unsqueeze(2), weight, self.bias)


class GatedStack(nn.Sequential):
    """`GatedBlock` for each dilation, (B, C, 1, L) -> (B, C, 1, L)."""

    def __init__(self, channels: int, dilations: Sequence[int]) -> None:
        super().__init__(*(GatedBlock(channels, d) for d in dilations))


class Doubling(nn.ConvTranspose1d):
    """Transposed convolution of kernel 4 and stride 2, (B, C, 1, L) -> (B, C', 2 L).

    As one convolution for the even columns and the odd ones, which ONNX Runtime computes in its blocked layout: of the
    kernel's taps ``w0..w3`` an even column takes ``w3`` of the column before and ``w1`` of its own, an odd one ``w2``
    of its own and ``w0`` of the column after.
    """

    def __init__(self, entering: int, leaving: int) -> None:
        super().__init__(entering, leaving, 4, stride=2, padding=1)

    def forward(
        self, h: Tensor, columns: int, activation: Callable[[Tensor], Tensor] | None = None
    ) -> Tensor:
        """See the class; ``columns`` is ``2 L``. When exported, an activation is computed inside the convolution."""
        taps = self.weight.transpose(0, 1).unbind(2)
        none = torch.zeros_like(taps[0])
        even, odd = torch.stack([taps[3], taps[1], none], 2), torch.stack([none, taps[2], taps[0]], 2)
        weight = torch.cat([even, odd])[:, :, None]
        out = nnf.conv2d(h, weight, torch.cat([self.bias, self.bias]), padding=(0, 1))
        out = out if activation is None else activation(out)
        out = out.reshape(-1, 2, self.out_channels, columns // 2).permute(0, 2, 3, 1)
        return out.reshape(-1, self.out_channels, columns)


class Same(nn.Module):
    """Identity; exported as a convolution, so that its output is in ONNX Runtime's blocked layout.

    Only then are the residual sums of the following blocks computed inside their convolutions, without two reorderings
    each.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.register_buffer("ones", torch.eye(channels)[:, :, None, None], persistent=False)

    def forward(self, h: Tensor) -> Tensor:
        """(B, C, 1, L) -> (B, C, 1, L)."""
        return nnf.conv2d(h, self.ones) if torch.onnx.is_in_onnx_export() else h
