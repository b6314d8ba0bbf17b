"""Building blocks that export to plain ONNX operators: sweep tables, filterbanks, DFT by matrices, gated
blocks."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as nnf

from radalt.core.waveform import Waveform

__all__ = ["Dechirp", "FourierBank", "GatedBlock", "MatrixDft", "log_power"]


def _constant(values: np.ndarray) -> Tensor:
    return torch.tensor(np.ascontiguousarray(values), dtype=torch.float32)


def log_power(power: Tensor) -> Tensor:
    """Natural logarithm with a floor 90 dB under unit power."""
    return torch.log(power + 1e-9)


class Dechirp(nn.Module):
    """``x conj(reference)`` and back: (B, 2, N) in, (B, 2, N) out, with the sweep as a constant of the graph.

    Both halves keep their sign, so a return has beats of ``-k tau`` on the way up and ``+k tau`` on the way
    down and the product is continuous over the apex.
    """

    def __init__(self, waveform: Waveform) -> None:
        super().__init__()
        reference = waveform.reference.astype(np.complex128)
        self.register_buffer(
            "direct", _constant(np.stack([reference.real, reference.imag])), persistent=False
        )

    def forward(self, x: Tensor) -> Tensor:
        """Towards the beat domain."""
        # (i + jq)(c - js) = (ic + qs) + j (qc - is)
        i, q = x[:, :1], x[:, 1:]
        c, s = self.direct[:1], self.direct[1:]
        return torch.cat([i * c + q * s, q * c - i * s], 1)

    def back(self, z: Tensor) -> Tensor:
        """Back to the received band."""
        re, im = z[:, :1], z[:, 1:]
        c, s = self.direct[:1], self.direct[1:]
        return torch.cat([re * c - im * s, re * s + im * c], 1)


class FourierBank(nn.Module):
    """Strided filterbank of a two-channel (I, Q) signal, started as a Hann-windowed DFT and learned from
    there.

    Parameters
    ----------
    samples, kernel, stride : int
        Length of the signal, of a filter, and hop; ``kernel - stride`` is padded, half on each side.
    bins : sequence of int
        Which DFT bins of ``kernel`` points are kept.
    """

    def __init__(self, samples: int, kernel: int, stride: int, bins: range) -> None:
        super().__init__()
        self.kernel, self.stride, self.bins = kernel, stride, len(bins)
        self.pad = (kernel - stride) // 2
        self.steps = (samples + 2 * self.pad - kernel) // stride + 1
        n = np.arange(kernel)
        window = 0.5 - 0.5 * np.cos(2 * np.pi * (n + 0.5) / kernel)
        atoms = window * np.exp(2j * np.pi * np.outer(list(bins), n - 0.5 * (kernel - 1)) / kernel)
        # real part: <atom, x>, imaginary part: its quadrature; channel order re(all bins), im(all bins)
        analysis = np.stack(
            [
                np.concatenate([atoms.real, -atoms.imag]),
                np.concatenate([atoms.imag, atoms.real]),
            ],
            1,
        )
        total = np.zeros(self.stride * (self.steps - 1) + kernel)
        for step in range(self.steps):
            total[step * stride : step * stride + kernel] += window**2
        norm = 1.0 / (kernel * total[self.pad : self.pad + samples])
        self.analysis = nn.Parameter(_constant(analysis / np.sqrt(kernel)))
        self.synthesis = nn.Parameter(_constant(analysis))
        self.register_buffer("norm", _constant(norm * np.sqrt(kernel)), persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        """(B, 2, N) -> (B, 2 bins, steps)."""
        return nnf.conv1d(x, self.analysis, stride=self.stride, padding=self.pad)

    def back(self, cells: Tensor) -> Tensor:
        """(B, 2 bins, steps) -> (B, 2, N), the inverse over the band of the kept bins."""
        return nnf.conv_transpose1d(cells, self.synthesis, stride=self.stride, padding=self.pad) * self.norm

    def power(self, cells: Tensor) -> Tensor:
        """(B, bins, steps) power of each cell."""
        return cells[:, : self.bins] ** 2 + cells[:, self.bins :] ** 2


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
            "first": _real_coded(roots[0] * scale),
            "second": _real_coded(roots[1]),
            "third_re": _real_coded(roots[2]).T[:, :c],
            "third_im": _real_coded(roots[2]).T[:, c:],
            "outer_re": outer.real,
            "outer_im": outer.imag,
            "inner_re": inner.real,
            "inner_im": inner.imag,
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
        y = torch.matmul(self.first, x.reshape(-1, 2 * a, b * c))
        re, im = y[:, :a], y[:, a:]
        turned = (re * self.outer_re - im * self.outer_im, re * self.outer_im + im * self.outer_re)
        y = torch.matmul(self.second, torch.stack(turned, 2).reshape(-1, a, 2 * b, c))
        re, im = y[:, :, :b], y[:, :, b:]
        y = torch.cat([re * self.inner_re - im * self.inner_im, re * self.inner_im + im * self.inner_re], 3)
        # two plain transposes, of long runs and of a matrix, where one of five axes takes three times as long
        y = y.transpose(1, 2).reshape(-1, a * b, 2 * c)
        planes = [
            torch.matmul(y, self.third_re).transpose(1, 2),
            torch.matmul(y, self.third_im).transpose(1, 2),
        ]
        return torch.stack(planes, 1).reshape(-1, 2, a * b * c)


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
