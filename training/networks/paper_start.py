"""A start for the paper's model: its weights set so that it is a linear estimator of the return.

From random weights the model predicts zero for some hundred thousand examples (MSE 0.5) before it learns anything.
Its architecture holds a linear estimator, though: shifted inputs keep the encoder's ReLU open, pairs of channels
(u, -u) carry signals through the decoder's, and the two dense layers are a map of rank 256. This module writes the
reduced-rank Wiener estimator of the returns into it:

- decoder: four complex bands of B/8, next to each other around B/2 (the half of the band away from the centre),
  interpolated by 8; eight channels at an eighth of the rate hold no more;
- dense: principal components of random returns, their weights ``lambda / (lambda + noise)``, and their codes in the
  decoder by least squares (conjugate gradients).

No weight is fitted to interference, but the half of the band was chosen: the paper's interferer sits at the centre.
Training goes on from there by the paper's recipe.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from radalt.core.returns import point_return
from radalt.core.waveform import Waveform

from .paper import Paper

__all__ = ["closed_form_start"]

_OPEN = 5.0  # gate bias: sigmoid 0.9933
_COMPONENTS = 320
_NOISE = 10.0  # noise power per sample, relative to the return, that the Wiener weights are made for


@torch.no_grad()
def closed_form_start(
    network: Paper, waveform: Waveform, *, examples: int = 1500, iterations: int = 20
) -> float:
    """Set the weights in place; returns the share of a return's energy that the estimator passes."""
    _start_decoder(network)
    returns = _returns(waveform, examples)
    variance, basis = _components(returns)
    codes = _least_squares(network, basis, iterations)
    decoded = network.decoder(codes.reshape(-1, 8, 937)).reshape(codes.shape[0], -1)
    weights = variance / (variance + _NOISE * 0.5)
    scale = torch.sqrt(variance)
    # rank 256 of the map, best for the energy of decoded returns
    weighted = decoded * (weights * scale)[:, None]
    values, vectors = torch.linalg.eigh((weighted @ weighted.T).double())
    chosen = vectors.flip(1)[:, :256].T.float()
    compress = (chosen / scale) @ basis
    expand = (codes * (weights * scale)[:, None]).T @ chosen.T
    _start_encoder(network, compress)
    network.expand.weight.copy_(expand)
    network.expand.bias.zero_()
    passed = network.decoder(((returns[:64] @ compress.T) @ expand.T).reshape(-1, 8, 937)).reshape(64, -1)
    return float((passed**2).sum() / (returns[:64] ** 2).sum())


def _returns(waveform: Waveform, count: int) -> Tensor:
    """(count, 2 N) random point returns, I then Q."""
    rng = np.random.default_rng(4)
    frames = point_return(
        waveform,
        rng.uniform(0.0, 1500.0, count),
        vertical_speed_m_per_s=rng.uniform(-50.0, 50.0, count),
        phase_cycles=rng.random(count),
    )
    return torch.from_numpy(np.concatenate([frames.real, frames.imag], axis=1).astype(np.float32))


def _components(returns: Tensor) -> tuple[Tensor, Tensor]:
    """Variances (r,) and principal components (r, 2 N) by the Gram matrix."""
    gram = returns @ returns.T
    values, vectors = torch.linalg.eigh(gram.double())
    values, vectors = values.flip(0)[:_COMPONENTS].float(), vectors.flip(1)[:, :_COMPONENTS].float()
    basis = (vectors.T @ returns) / torch.sqrt(values)[:, None]
    return values / returns.shape[0], basis


def _start_decoder(network: Paper) -> None:
    """Complex interpolators: kernels 3, 5, 5 of falling weight, each turned to its band's centre."""
    centres = 2 * np.pi * (0.5 + np.array([-1.5, -0.5, 0.5, 1.5]) / 8)  # radians a sample
    prototypes = (
        (np.array([0.5, 1.0, 0.5]), 4),
        (np.array([1, 4, 6, 4, 1]) / 8, 2),
        (np.array([1, 4, 6, 4, 1]) / 8, 1),
    )
    layers = [m for m in network.decoder if isinstance(m, torch.nn.ConvTranspose1d)]
    for number, (layer, (taps, step)) in enumerate(zip(layers, prototypes, strict=True)):
        offset = step * (np.arange(taps.size) - taps.size // 2)
        linear = np.zeros((8, 8, taps.size))
        for band, centre in enumerate(centres):
            kernel = taps * np.exp(1j * centre * offset)
            re, im = 2 * band, 2 * band + 1
            linear[re, re], linear[im, re] = kernel.real, -kernel.imag
            linear[re, im], linear[im, im] = kernel.imag, kernel.real
        if number == 2:  # all bands into I and Q
            linear = np.stack([linear[:, 0::2].sum(1), linear[:, 1::2].sum(1)], 1)
        weight = np.zeros(tuple(layer.weight.shape)) if number == 2 else 1e-2 * layer.weight.numpy()
        if number == 0:
            weight = np.concatenate([linear, -linear], axis=1)
        elif number == 1:
            weight[:, :16] = np.concatenate(
                [np.concatenate([linear, -linear], 1), np.concatenate([-linear, linear], 1)], 0
            )
        else:
            weight[:8], weight[8:16] = linear, -linear
        layer.weight.copy_(torch.from_numpy(weight.astype(np.float32)))
        layer.bias.zero_()


def _least_squares(network: Paper, targets: Tensor, iterations: int) -> Tensor:
    """(r, 7496) codes whose decoded frames are nearest to (r, 2 N) targets: conjugate gradients, 64 at a time."""
    return torch.cat([_conjugate_gradients(network, part, iterations) for part in targets.split(64)])


def _decode(network: Paper, codes: Tensor) -> Tensor:
    return network.decoder(codes.reshape(-1, 8, 937)).reshape(codes.shape[0], -1)


def _adjoint(network: Paper, frames: Tensor) -> Tensor:
    """Transpose of the (linear) decoder, by its gradient."""
    with torch.enable_grad():
        codes = torch.ones(frames.shape[0], 7496, requires_grad=True)
        product = (_decode(network, codes) * frames).sum()
    return torch.autograd.grad(product, codes)[0]


def _conjugate_gradients(network: Paper, targets: Tensor, iterations: int) -> Tensor:
    codes = torch.zeros(targets.shape[0], 7496)
    residual = _adjoint(network, targets)
    direction, energy = residual.clone(), (residual**2).sum(1, keepdim=True)
    for _ in range(iterations):
        image = _adjoint(network, _decode(network, direction)) + 1e-3 * direction
        step = energy / (direction * image).sum(1, keepdim=True)
        codes += step * direction
        residual = residual - step * image
        fresh = (residual**2).sum(1, keepdim=True)
        direction = residual + fresh / energy * direction
        energy = fresh
    return codes


def _start_encoder(network: Paper, compress: Tensor) -> None:
    """Channels 0 and 1 of every block carry I + 1 and Q + 1; the dense layer takes the shift away again."""
    taps = (2, 1, 1)  # output n of the last block is sample n + 2
    for block, tap in zip(network.encoder, taps, strict=True):
        for channel in (0, 1):
            block.feature.weight[channel] = 0.0
            block.feature.weight[channel, channel, tap] = 1.0
            block.feature.bias[channel] = 1.0 if block is network.encoder[0] else 0.0
            block.gate.weight[channel] = 0.0
            block.gate.bias[channel] = _OPEN
    gain = float(torch.sigmoid(torch.tensor(_OPEN)) ** 3)
    rows = compress.reshape(256, 2, -1)[:, :, 2:] / gain
    weight = network.compress.weight.view(256, 8, -1)
    weight.zero_()
    weight[:, :2] = rows
    network.compress.bias.copy_(-gain * rows.sum((1, 2)))
