"""Building blocks that export to plain ONNX operators: sweep tables, filterbanks, DFT by matrices, gated
blocks."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as nnf

from radalt.core.waveform import Waveform

__all__ = [
    "Dechirp",
    "FourierBank",
    "GatedBlock",
    "MatrixDft",
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

    def back(self, z: Tensor) -> Tensor:
        """Back to the received band: (re + j im)(c + js)."""
        return z * self.cosine - z[:, [1, 0]] * self.sine


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
        """(B, 2 bins, steps) -> (B, 2, stride, steps), the inverse over the band of the kept bins."""
        around = torch.cat([shifted(cells, k - self.spans // 2) for k in range(self.spans)], 1)
        blocks = torch.matmul(self.synthesis, around)
        return blocks.reshape(-1, 2, self.stride, self.steps) * self.norm

    def power(self, cells: Tensor) -> Tensor:
        """(B, bins, steps) power of each cell."""
        squares = cells * cells
        return squares[:, : self.bins] + squares[:, self.bins :]


class MatrixDft(nn.Module):
    """DFT of ``a b c`` points as three small matrix products and twiddles (J. W. Cooley and J. W. Tukey,
    1965).

    ONNX Runtime's own DFT takes 2.2 ms for 7500 points. Training uses `torch.fft`, which the check of the
    exported model against PyTorch holds to the same result.
    """

    def __init__(self, factors: tuple[int, int, int], *, inverse: bool = False) -> None:
        super().__init__()
        self.factors, self.inverse = factors, inverse
        a, b, c = factors
        sign = 1 if inverse else -1
        scale = 1.0 / (a * b * c) if inverse else 1.0
        roots = [np.exp(sign * 2j * np.pi * np.outer(np.arange(m), np.arange(m)) / m) for m in factors]
        outer = np.exp(sign * 2j * np.pi * np.outer(np.arange(a), np.arange(b * c)) / (a * b * c))
        inner = np.exp(sign * 2j * np.pi * np.outer(np.arange(b), np.arange(c)) / (b * c))
        tables = {
            # rows in pairs (real, imaginary) where the next step multiplies by a twiddle
            "first": _paired(_real_coded(roots[0] * scale)),
            "second": _paired(_real_coded(roots[1])),
            "third_re": _real_coded(roots[2]).T[:, :c],
            "third_im": _real_coded(roots[2]).T[:, c:],
            "outer_re": outer.real[:, None],
            "outer_im": np.stack([-outer.imag, outer.imag], 1),
            "inner_re": inner.real[:, None],
            "inner_im": np.stack([-inner.imag, inner.imag], 1),
        }
        for name, values in tables.items():
            self.register_buffer(name, _constant(values), persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        """(B, 2, N) real and imaginary planes -> the same of the (inverse) DFT, natural order."""
        if torch.onnx.is_in_onnx_export():
            return self.matrices(x)
        transform = torch.fft.ifft if self.inverse else torch.fft.fft
        return torch.view_as_real(transform(torch.complex(x[:, 0], x[:, 1]))).permute(0, 2, 1)

    def matrices(self, x: Tensor) -> Tensor:
        """The exported path: n = b c n1 + c n2 + n3, k = k1 + a (k2 + b k3)."""
        a, b, c = self.factors
        y = torch.matmul(self.first, x.reshape(-1, 2 * a, b * c)).reshape(-1, a, 2, b * c)
        y = y * self.outer_re + y[:, :, [1, 0]] * self.outer_im
        y = torch.matmul(self.second, y.reshape(-1, a, 2 * b, c)).reshape(-1, a, b, 2, c)
        y = y * self.inner_re + y[:, :, :, [1, 0]] * self.inner_im
        # two plain transposes, of long runs and of a matrix, where one of five axes takes three times as long
        y = y.reshape(-1, a, b, 2 * c).transpose(1, 2).reshape(-1, a * b, 2 * c)
        planes = [
            torch.matmul(y, self.third_re).transpose(1, 2),
            torch.matmul(y, self.third_im).transpose(1, 2),
        ]
        return torch.stack(planes, 1).reshape(-1, 2, a * b * c)


def _paired(matrix: np.ndarray) -> np.ndarray:
    """Rows (all real parts, all imaginary parts) as (real, imaginary) of the first, of the second ..."""
    return matrix.reshape(2, -1, matrix.shape[1]).transpose(1, 0, 2).reshape(matrix.shape)


def _real_coded(matrix: np.ndarray) -> np.ndarray:
    """Complex (m, m) as real (2m, 2m) acting on stacked real and imaginary parts."""
    return np.block([[matrix.real, -matrix.imag], [matrix.imag, matrix.real]])


class GatedBlock(nn.Module):
    """Gated dilated residual block: ``h + W (tanh(F h) sigmoid(G h))``, kernel 3 (WaveNet's unit, not
    causal)."""

    def __init__(self, channels: int, dilation: int) -> None:
        super().__init__()
        self.channels = channels
        self.pair = nn.Conv1d(channels, 2 * channels, 3, padding=dilation, dilation=dilation)
        self.mix = nn.Conv1d(channels, channels, 1)
        with torch.no_grad():
            self.mix.weight.mul_(0.3)
            self.mix.bias.zero_()

    def forward(self, h: Tensor) -> Tensor:
        """(B, C, L) -> (B, C, L)."""
        pair = self.pair(h)
        return h + self.mix(torch.tanh(pair[:, : self.channels]) * torch.sigmoid(pair[:, self.channels :]))
