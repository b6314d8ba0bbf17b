"""The convolution-only autoencoder of the paper's predecessor.

S. B. Brown et al., "Aircraft Radar Altimeter Interference Mitigation Through a CNN-Layer Only Denoising Autoencoder
Architecture", MILCOM 2024, arXiv:2410.03423.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from radalt.core.waveform import Waveform

__all__ = ["Convolutional"]

_CACHED = 2  # frames per FFT convolution, whose arrays then stay in the cache


def _fast_length(least: int) -> int:
    """Smallest length of at least ``least`` whose only factors are 2, 3 and 5."""
    length = least
    while True:
        rest = length
        for factor in (2, 3, 5):
            while rest % factor == 0:
                rest //= factor
        if rest == 1:
            return length
        length += 1


class _OverlapSave(torch.autograd.Function):
    """Correlation with long taps by overlap-save: y[o, n] = sum over c, k of x[c, n + k - (K - 1) // 2] w[o, c, k].

    The gradients use the spectra of the forward pass, which automatic differentiation would transform again, at twice
    the length.
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor) -> Tensor:
        """(B, C, L), (O, C, K) -> (B, O, L)."""
        (frames, entering, samples), (leaving, _, kernel) = x.shape, weight.shape
        length = _fast_length(4 * kernel)
        hop = length - kernel + 1
        blocks = -(-samples // hop)
        before = (kernel - 1) // 2
        padded = functional.pad(x, (before, blocks * hop - samples + kernel - 1 - before))
        taps = torch.fft.rfft(weight, length).permute(2, 1, 0).conj_physical().contiguous()
        out = x.new_empty(frames, leaving, blocks, hop)
        spectra = []
        for part, made in zip(padded.split(_CACHED), out.split(_CACHED), strict=True):
            spectrum = torch.fft.rfft(part.unfold(2, length, hop)).permute(3, 0, 2, 1).flatten(1, 2)
            product = (spectrum @ taps).unflatten(1, (len(part), blocks)).permute(1, 3, 2, 0)
            made.copy_(torch.fft.irfft(product, length)[..., :hop])
            spectra.append(spectrum)
        ctx.save_for_backward(taps, *spectra)
        ctx.sizes = entering, samples, kernel, length, hop, blocks, before
        return out.flatten(2)[..., :samples]

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, Tensor]:
        """Gradients of ``x``, by overlap-add, and of ``weight``."""
        taps, *spectra = ctx.saved_tensors
        entering, samples, kernel, length, hop, blocks, before = ctx.sizes
        whole = functional.pad(gradient, (0, blocks * hop - samples)).unflatten(2, (blocks, hop))
        back = taps.mT.conj_physical().contiguous()
        added = gradient.new_zeros(len(gradient), entering, (blocks + 1) * hop)
        of_taps = torch.zeros_like(taps)
        for part, made, spectrum in zip(whole.split(_CACHED), added.split(_CACHED), spectra, strict=True):
            other = torch.fft.rfft(part, length).permute(3, 0, 2, 1).flatten(1, 2)
            of_taps += spectrum.mT @ other.conj_physical()  # a lazy conjugate would be copied slice by slice
            product = (other @ back).unflatten(1, (len(part), blocks)).permute(1, 3, 2, 0)
            blocks_of = torch.fft.irfft(product, length)
            made[..., : blocks * hop].unflatten(2, (blocks, hop)).add_(blocks_of[..., :hop])
            made[..., hop:].unflatten(2, (blocks, hop))[..., : kernel - 1].add_(blocks_of[..., hop:])
        of_weight = torch.fft.irfft(of_taps.permute(2, 1, 0), length)[..., :kernel]
        return added[..., before : before + samples], of_weight


class _LongConvolution(nn.Module):
    """Convolution of stride 1 whose output is as long as its input, by FFT except in an exported graph.

    In the decoder it stands for the transposed convolution, which at stride 1 is a convolution with the taps reversed.
    """

    def __init__(self, entering: int, leaving: int, kernel: int, gain: float) -> None:
        super().__init__()
        scale = gain / math.sqrt(entering * kernel)
        self.weight = nn.Parameter(scale * torch.randn(leaving, entering, kernel))
        self.bias = nn.Parameter(torch.zeros(leaving))

    def forward(self, x: Tensor) -> Tensor:
        """(B, entering, L) -> (B, leaving, L)."""
        if torch.onnx.is_in_onnx_export():
            kernel = self.weight.shape[-1]
            before = (kernel - 1) // 2
            return functional.conv1d(functional.pad(x, (before, kernel - 1 - before)), self.weight, self.bias)
        return _OverlapSave.apply(x, self.weight) + self.bias[:, None]


def _pool(x: Tensor) -> tuple[Tensor, Tensor]:
    """Max-pooling by 2: (B, C, L) -> (B, C, L/2), and whether the larger of each pair is the first."""
    pairs = x.unflatten(-1, (-1, 2))
    return torch.maximum(pairs[..., 0], pairs[..., 1]), pairs[..., 0] >= pairs[..., 1]


class _Pool(torch.autograd.Function):
    """`_pool` with a gradient that takes one pass over the pairs."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> tuple[Tensor, Tensor]:
        """As `_pool`."""
        larger, first = _pool(x)
        ctx.save_for_backward(first)
        ctx.mark_non_differentiable(first)
        return larger, first

    @staticmethod
    def backward(ctx: Any, gradient: Tensor, _: Tensor) -> Tensor:
        """The gradient at the place of the larger one."""
        return _unpool(gradient, *ctx.saved_tensors)


def _unpool(x: Tensor, first: Tensor) -> Tensor:
    """(B, C, L/2) -> (B, C, L): each value at the place of the larger one in `_Pool`, zero next to it."""
    here = x * first
    return torch.stack([here, x - here], dim=-1).flatten(2)


class Convolutional(nn.Module):
    """IQ mixer, three convolutions with max-pooling by 2, the same mirrored, IQ unmixer.

    The mixer is a 2 x 2 convolution over the rails and two samples, so 2 x N values become N; three poolings make that
    N/8, which is 16:1. The mirrored half also gets the places of the pooled values. The text leaves open:

    - channels at the bottleneck: one, since more would not be 16:1;
    - activations: ReLU after the inner convolutions, none after the bottleneck, the last convolution and the mixers,
      whose values have both signs;
    - initial weights: as in He et al., deviation ``sqrt(2 / fan-in)``, biases of zero.

    Parameters
    ----------
    waveform : Waveform
    kernel, filters : int
        200 and 64 for long signals, kernel 300 for 1,000 samples.
    bottleneck : int
        Channels at the bottleneck.
    normalised : bool
        Batch normalisation after the inner convolutions, which the authors' network does not have.
    """

    normalisation = "joint_rms"
    export_tolerance = 1e-2  # a pair that rounding makes equal changes its place: 3.7e-3 measured

    def __init__(
        self,
        waveform: Waveform,
        *,
        kernel: int = 200,
        filters: int = 64,
        bottleneck: int = 1,
        normalised: bool = False,
    ) -> None:
        super().__init__()
        self.rest = -waveform.samples_per_frame % 8
        self.mixer = nn.Conv1d(2, 1, 2, padding=1)
        self.unmixer = nn.ConvTranspose1d(1, 2, 2)
        inside, linear = math.sqrt(2.0), 1.0
        self.encoder = nn.ModuleList(
            [
                _LongConvolution(1, filters, kernel, inside),
                _LongConvolution(filters, filters, kernel, inside),
                _LongConvolution(filters, bottleneck, kernel, linear),
            ]
        )
        self.decoder = nn.ModuleList(
            [
                _LongConvolution(bottleneck, filters, kernel, inside),
                _LongConvolution(filters, filters, kernel, inside),
                _LongConvolution(filters, 1, kernel, linear),
            ]
        )
        self.norms = nn.ModuleList(
            [nn.BatchNorm1d(filters) if normalised else nn.Identity() for _ in range(4)]
        )

    def forward(self, x: Tensor) -> Tensor:
        """(B, 2, N) -> (B, 2, N)."""
        samples = x.shape[-1]
        h = functional.pad(self.mixer(x)[..., :samples], (0, self.rest))
        places = []
        pool = _pool if torch.onnx.is_in_onnx_export() else _Pool.apply  # the class cannot be exported
        for k, convolution in enumerate(self.encoder):
            h = convolution(h)
            if k < 2:
                h = torch.relu(self.norms[k](h))
            h, place = pool(h)
            places.append(place)
        for k, convolution in enumerate(self.decoder):
            h = convolution(_unpool(h, places.pop()))
            if k < 2:
                h = torch.relu(self.norms[2 + k](h))
        return self.unmixer(h[..., :samples])[..., :samples]
