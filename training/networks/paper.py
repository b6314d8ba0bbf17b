"""The paper's model to the digit, and a fully connected autoencoder it is compared with.

C. E. Thornton et al., "Temporal Convolutional Autoencoder for Interference Mitigation in FMCW Radar
Altimeters".
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from radalt.core.waveform import Waveform

__all__ = ["FullyConnected", "Paper"]

_CACHED = 8  # frames per pass through the convolutions in training, whose activations then stay in the cache


class _Dropout(nn.Module):
    """Dropout that draws places instead of a number per element, which saves a quarter of a training step.

    Places are drawn with replacement: at a probability of 0.02, 0.0198 of the elements become zero.
    """

    def __init__(self, probability: float) -> None:
        super().__init__()
        self.probability = probability

    def forward(self, x: Tensor) -> Tensor:
        """Any shape, the same back."""
        if not self.training:
            return x
        mask = torch.full_like(x, 1.0 / (1.0 - self.probability))
        places = torch.randint(x.numel(), (round(x.numel() * self.probability),), device=x.device)
        mask.view(-1)[places] = 0.0
        return x * mask


class _Gated(nn.Module):
    """``relu(F x) sigmoid(G x)`` with dilated kernels of 3 and padding 2, then dropout."""

    def __init__(self, entering: int, leaving: int, dilation: int, dropout: float) -> None:
        super().__init__()
        self.feature = nn.Conv1d(entering, leaving, 3, padding=2, dilation=dilation)
        self.gate = nn.Conv1d(entering, leaving, 3, padding=2, dilation=dilation)
        self.dropout = _Dropout(dropout)

    def forward(self, x: Tensor) -> Tensor:
        """(B, entering, L) -> (B, leaving, L + 4 - 2 dilation)."""
        if self.training:  # one convolution instead of two saves a fifth of a step
            weight = torch.cat([self.feature.weight, self.gate.weight])
            bias = torch.cat([self.feature.bias, self.gate.bias])
            both = functional.conv1d(x, weight, bias, padding=2, dilation=self.feature.dilation)
            feature, gate = both.chunk(2, dim=1)
            return self.dropout(torch.relu(feature) * torch.sigmoid(gate))
        return self.dropout(torch.relu(self.feature(x)) * torch.sigmoid(self.gate(x)))


class Paper(nn.Module):
    """17,290,282 parameters: encoder 4,336, dense 15,356,160 and 1,926,472, decoder 3,314.

    ReLU and dropout after each convolution but the last; the dense layers are linear. The paper gives no dropout
    probability; 0.02 is ours. A frame has to hold 7500 samples.
    """

    normalisation = "per_channel_peak"

    def __init__(self, waveform: Waveform, dropout: float = 0.02) -> None:
        super().__init__()
        samples = waveform.samples_per_frame
        if samples != 7500:
            raise ValueError(f"the paper's model takes frames of 7500 samples, not {samples}")
        self.encoder = nn.Sequential(
            _Gated(2, 32, 1, dropout), _Gated(32, 16, 2, dropout), _Gated(16, 8, 4, dropout)
        )
        self.compress = nn.Linear(8 * (samples - 2), 256)
        self.expand = nn.Linear(256, 8 * 937)
        self.decoder = nn.Sequential(
            nn.ConvTranspose1d(8, 16, 3, stride=2),
            nn.ReLU(),
            _Dropout(dropout),
            nn.ConvTranspose1d(16, 32, 5, stride=2, padding=2, output_padding=1),
            nn.ReLU(),
            _Dropout(dropout),
            nn.ConvTranspose1d(32, 2, 5, stride=2, padding=2, output_padding=1),
        )

    def forward(self, x: Tensor) -> Tensor:
        """(B, 2, 7500) -> (B, 2, 7500)."""
        if not (self.training and x.device.type == "cpu"):
            code = self.compress(self.encoder(x).flatten(1))
            return self.decoder(self.expand(code).reshape(-1, 8, 937))
        # a few frames at a time: a fifth faster
        features = torch.cat([self.encoder(part).flatten(1) for part in x.split(_CACHED)])
        code = self.expand(self.compress(features)).reshape(-1, 8, 937)
        return torch.cat([self.decoder(part) for part in code.split(_CACHED)])


class FullyConnected(nn.Module):
    """Dense autoencoder, 15,000 -> 256 -> 256 -> 15,000. The paper gives no layout: this one is ours."""

    normalisation = "joint_rms"

    def __init__(self, waveform: Waveform, width: int = 256) -> None:
        super().__init__()
        size = 2 * waveform.samples_per_frame
        self.layers = nn.Sequential(
            nn.Linear(size, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, size)
        )

    def forward(self, x: Tensor) -> Tensor:
        """(B, 2, N) -> (B, 2, N)."""
        return self.layers(x.flatten(1)).reshape(x.shape)
