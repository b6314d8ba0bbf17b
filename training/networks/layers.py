"""Building blocks that export to plain ONNX operators: sweep tables, filterbanks, DFT by matrices, gated
blocks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as nnf

from radalt.core.waveform import Waveform

__all__ = [
    "BandGain",
    "Dechirp",
    "FourierBank",
    "GatedStack",
    "RowConv",
    "Same",
    "from_blocks",
    "log_power",
    "shifted",
    "to_blocks",
]


def _constant(values: np.ndarray) -> Tensor:
    return torch.tensor(np.ascontiguousarray(values), dtype=torch.float32)


def log_power(power: Tensor) -> Tensor:
    """Natural logarithm with a floor 90 dB under unit power."""
    return torch.log(power + 1e-9)


def to_blocks(x: Tensor, hop: int) -> Tensor:
    """(B, 2, N) -> (B, 2, hop, N / hop): sample ``hop t + m`` at row m, column t.

    Sums over a block, steps from block to block and the filterbank are matrix products in this order, where
    strided convolutions over 7500 samples spend their time gathering.
    """
    return x.reshape(x.shape[0], 2, -1, hop).transpose(2, 3)


def from_blocks(z: Tensor) -> Tensor:
    """Inverse of `to_blocks`."""
    return z.transpose(2, 3).reshape(z.shape[0], 2, -1)


def shifted(x: Tensor, columns: int) -> Tensor:
    """Columns moved to the right (left if negative), zeros coming in."""
    return nnf.pad(x, (columns, -columns)) if columns else x


class Dechirp(nn.Module):
    """``x conj(reference)`` and back on blocks, with the sweep as a constant of the graph.

    Both halves keep their sign, so a return has beats of ``-k tau`` on the way up and ``+k tau`` on the way
    down and the product is continuous over the apex.
    """

    def __init__(self, waveform: Waveform, hop: int) -> None:
        super().__init__()
        reference = waveform.reference.astype(np.complex128)
        cosine, sine = to_blocks(torch.tensor(np.stack([reference.real, reference.imag]))[None], hop)[0]
        self.register_buffer("cosine", cosine.float().contiguous(), persistent=False)
        self.register_buffer("sine", torch.stack([sine, -sine]).float().contiguous(), persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        """Towards the beat domain: (i + jq)(c - js) = (ic + qs) + j (qc - is)."""
        return x * self.cosine + x[:, [1, 0]] * self.sine

    def back(self, z: Tensor, norm: Tensor) -> Tensor:
        """Back to the received band: (re + j im)(c + js) norm, constants that are multiplied when a model is loaded."""
        return z * (self.cosine * norm) - z[:, [1, 0]] * (self.sine * norm)


class FourierBank(nn.Module):
    """Strided filterbank of a two-channel (I, Q) signal, started as a Hann-windowed DFT and learned from
    there; a matrix product a block and a sum over neighbouring blocks.

    Parameters
    ----------
    samples, kernel, stride : int
        Length of the signal, of a filter, and hop: ``samples`` is a multiple of ``stride``, ``kernel`` an odd
        one; ``kernel - stride`` is padded, half on each side.
    bins : sequence of int
        Which DFT bins of ``kernel`` points are kept.
    """

    def __init__(self, samples: int, kernel: int, stride: int, bins: range) -> None:
        super().__init__()
        self.stride, self.bins, self.steps = stride, len(bins), samples // stride
        self.spans, pad = kernel // stride, (kernel - stride) // 2
        n = np.arange(kernel)
        window = 0.5 - 0.5 * np.cos(2 * np.pi * (n + 0.5) / kernel)
        atoms = window * np.exp(2j * np.pi * np.outer(list(bins), n - 0.5 * (kernel - 1)) / kernel)
        # real part: <atom, x>, imaginary part: its quadrature; channel order re(all bins), im(all bins)
        filters = np.stack(
            [np.concatenate([atoms.real, -atoms.imag]), np.concatenate([atoms.imag, atoms.real])], 1
        )
        total = np.zeros(samples + 2 * pad)
        for step in range(self.steps):
            total[step * stride : step * stride + kernel] += window**2
        norm = 1.0 / (kernel * total[pad : pad + samples])
        # (2 bins, I and Q, blocks a filter spans, stride)
        parts = filters.reshape(2 * self.bins, 2, self.spans, stride)
        self.analysis = nn.Parameter(
            _constant(parts.transpose(2, 0, 1, 3).reshape(-1, 2 * stride) / np.sqrt(kernel))
        )
        self.synthesis = nn.Parameter(_constant(parts.transpose(1, 3, 2, 0).reshape(2 * stride, -1)))
        self.register_buffer(
            "norm", _constant(norm.reshape(-1, stride).T * np.sqrt(kernel)), persistent=False
        )

    def forward(self, z: Tensor) -> Tensor:
        """(B, 2, stride, steps) blocks -> (B, 2 bins, steps)."""
        products = torch.matmul(self.analysis, z.reshape(-1, 2 * self.stride, self.steps))
        parts = products.split(2 * self.bins, 1)
        return sum(shifted(part, self.spans // 2 - k) for k, part in enumerate(parts))

    def back(self, cells: Tensor) -> Tensor:
        """(B, 2 bins, steps) -> (B, 2, stride, steps), times ``norm`` the inverse over the band of the kept bins."""
        around = torch.cat([shifted(cells, k - self.spans // 2) for k in range(self.spans)], 1)
        return torch.matmul(self.synthesis, around).reshape(-1, 2, self.stride, self.steps)

    def power(self, cells: Tensor) -> Tensor:
        """(B, bins, steps) power of each cell."""
        squares = cells * cells
        return squares[:, : self.bins] + squares[:, self.bins :]


class BandGain(nn.Module):
    """Gain over frequency: DFT of ``a b c`` points, power of ``step`` cells at a time, a gain for each, inverse DFT.

    ONNX Runtime's own DFT takes 2.2 ms for 7500 points. What is exported is three matrix products and one twiddle
    each way (J. W. Cooley and J. W. Tukey, 1965): with ``n = b c n1 + c n2 + n3`` and ``k = k1 + a k2 + a b k3`` the
    first twiddle depends on ``k1`` and ``n2`` alone and lies in the second product's matrices, one for each ``k1``.
    Cells stay in the order (k1, k2, k3) that the products leave them in; powers and gains, fewer by ``step``, are
    brought into the order of frequency and back instead. Training uses `torch.fft`, which the check of the exported
    model against PyTorch holds to the same result.
    """

    def __init__(self, factors: tuple[int, int, int], step: int) -> None:
        super().__init__()
        a, b, c = self.factors = factors
        if a % step:
            raise ValueError(
                f"the first factor, {a}, has to be a multiple of the {step} cells that share a gain"
            )
        self.step, self.samples = step, a * b * c
        roots = [np.exp(-2j * np.pi * np.outer(np.arange(m), np.arange(m)) / m) for m in factors]
        k1, n2 = np.arange(a)[:, None, None], np.arange(b)
        second = roots[1] * np.exp(-2j * np.pi * k1 * n2 / (a * b))  # (k1, k2, n2)
        place = np.arange(a)[:, None, None] + a * np.arange(b)[:, None]  # k1 + a k2
        twiddle = np.exp(-2j * np.pi * place * np.arange(c) / self.samples)  # (k1, k2, n3)
        third = _real_coded(roots[2])  # symmetric but for signs: rows times its transpose
        paired = np.stack([_paired(_real_coded(m)) for m in second])
        tables = {
            # rows in pairs (real, imaginary) where the next step reads pairs
            "first": _paired(_real_coded(roots[0])),
            "second": paired,
            "third": third.T,
            "turn_re": np.repeat(twiddle.real[:, :, None], 2, 2),
            "turn_im": np.stack([-twiddle.imag, twiddle.imag], 2),
            # the inverse: each step's conjugate transpose, in the opposite order
            "back_first": _paired(_real_coded(roots[0])).T / self.samples,
            "back_second": paired.transpose(0, 2, 1),
            "back_third": third,
        }
        for name, values in tables.items():
            self.register_buffer(name, _constant(values), persistent=False)

    def analyse(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """(B, 2, N) -> spectrum, to be handed to `synthesise`, and mean powers (B, 1, N / step) by frequency."""
        if torch.onnx.is_in_onnx_export():
            return self.analyse_matrices(x)
        spectrum = torch.fft.fft(torch.complex(x[:, 0], x[:, 1]))
        planes = torch.view_as_real(spectrum)
        power = (planes * planes).sum(2)
        return spectrum, power.reshape(-1, 1, self.samples // self.step, self.step).mean(3)

    def synthesise(self, spectrum: Tensor, gain: Tensor) -> Tensor:
        """Spectrum of `analyse` times gains (B, 1, N / step) -> (B, 2, N)."""
        if torch.onnx.is_in_onnx_export():
            return self.synthesise_matrices(spectrum, gain)
        wide = gain[:, 0].repeat_interleave(self.step, 1)
        return torch.view_as_real(torch.fft.ifft(spectrum * wide)).transpose(1, 2)

    def analyse_matrices(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """`analyse` as exported; the spectrum is (B, a b, 2 c) in the order (k1, k2, real or imaginary, k3)."""
        a, b, c = self.factors
        y = torch.matmul(self.first, x.reshape(-1, 2 * a, b * c)).reshape(-1, a, 2 * b, c)
        y = torch.matmul(self.second, y).reshape(-1, a, b, 2, c)
        y = y * self.turn_re + y[:, :, :, [1, 0]] * self.turn_im
        spectrum = torch.matmul(y.reshape(-1, a * b, 2 * c), self.third)
        squares = (spectrum * spectrum).reshape(-1, a // self.step, self.step, 2 * b * c)
        power = (
            squares.sum(2).reshape(-1, a // self.step, b, 2, c).sum(3) / self.step
        )  # (B, k1 // step, k2, k3)
        # two plain transposes, of long runs and of a matrix: one that moves three axes takes three times as long
        power = power.transpose(1, 2).reshape(-1, a * b // self.step, c).transpose(1, 2)
        return spectrum, power.reshape(-1, 1, self.samples // self.step)

    def synthesise_matrices(self, spectrum: Tensor, gain: Tensor) -> Tensor:
        """`synthesise` as exported."""
        a, b, c = self.factors
        groups = a // self.step
        gain = gain.reshape(-1, c, b, groups).permute(0, 3, 2, 1)  # (B, k1 // step, k2, k3)
        gain = torch.cat([gain, gain], 3).reshape(
            -1, groups, 1, 2 * b * c
        )  # long runs: short broadcasts are slow
        y = (spectrum.reshape(-1, groups, self.step, 2 * b * c) * gain).reshape(-1, a * b, 2 * c)
        y = torch.matmul(y, self.back_third).reshape(-1, a, b, 2, c)
        y = y * self.turn_re - y[:, :, :, [1, 0]] * self.turn_im
        y = torch.matmul(self.back_second, y.reshape(-1, a, 2 * b, c))
        return torch.matmul(self.back_first, y.reshape(-1, 2 * a, b * c)).reshape(-1, 2, self.samples)


def _paired(matrix: np.ndarray) -> np.ndarray:
    """Rows (all real parts, all imaginary parts) as (real, imaginary) of the first, of the second ..."""
    return matrix.reshape(2, -1, matrix.shape[1]).transpose(1, 0, 2).reshape(matrix.shape)


def _real_coded(matrix: np.ndarray) -> np.ndarray:
    """Complex (m, m) as real (2m, 2m) acting on stacked real and imaginary parts."""
    return np.block([[matrix.real, -matrix.imag], [matrix.imag, matrix.real]])


class GatedBlock(nn.Module):
    """Gated dilated residual block: ``h + W (tanh(F h) sigmoid(G h))``, kernel 3 (WaveNet's unit, not causal).

    Convolutions of two dimensions, one of them of a single row: ONNX Runtime computes those in its blocked layout, with
    the nonlinearities inside, in 0.78 of the time of one-dimensional ones.
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

    def forward(self, x: Tensor) -> Tensor:
        """See the class."""
        return super().forward(x.unsqueeze(2))


class GatedStack(nn.Sequential):
    """`GatedBlock` for each dilation, (B, C, 1, L) -> (B, C, L)."""

    def __init__(self, channels: int, dilations: Sequence[int]) -> None:
        super().__init__(*(GatedBlock(channels, d) for d in dilations))

    def forward(self, h: Tensor) -> Tensor:
        """See the class."""
        return super().forward(h).squeeze(2)


class Same(nn.Module):
    """What comes in; where it is exported, through a convolution, whose output lies in ONNX Runtime's blocked layout.

    Only there are the residual sums of the blocks that follow made inside their convolutions, without two reorderings
    each.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.register_buffer("ones", torch.eye(channels)[:, :, None, None], persistent=False)

    def forward(self, h: Tensor) -> Tensor:
        """(B, C, 1, L) -> (B, C, 1, L)."""
        return nnf.conv2d(h, self.ones) if torch.onnx.is_in_onnx_export() else h
