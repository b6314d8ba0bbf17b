"""Architectures that `compact` was compared with on the same data and budget."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from radalt.core.mitigation.any_sweep import filterbank_norm
from radalt.core.waveform import Waveform

from .layers import FourierBank, GatedStack, from_blocks, log_power, to_blocks

__all__ = ["Mask", "Residual"]


class Mask(nn.Module):
    """Masks on a Fourier-initialised filterbank of the received band: 75 bins, kernel 75, stride 15.

    Log-power and normalised features, a learned position bias, eight gated blocks of 48 channels, a sigmoid gain per
    bin, transposed convolution.
    """

    normalisation = "joint_rms"

    def __init__(self, waveform: Waveform, channels: int = 48) -> None:
        super().__init__()
        self.bank = FourierBank(75, 15, range(-37, 38))
        b, columns = self.bank.bins, waveform.samples_per_frame // 15
        self.columns = columns
        norm = torch.tensor(filterbank_norm(columns, 15, 5), dtype=torch.float32)
        self.register_buffer("norm", norm, persistent=False)
        self.enter = nn.Conv1d(3 * b, channels, 1)
        self.position = nn.Parameter(torch.zeros(1, channels, columns))
        self.blocks = GatedStack(channels, (1, 2, 4, 8, 1, 2, 4, 8))
        self.leave = nn.Conv1d(channels, b, 1)
        with torch.no_grad():
            self.leave.weight.mul_(0.1)
            self.leave.bias.fill_(2.0)

    def forward(self, x: Tensor) -> Tensor:
        """(B, 2, N) -> (B, 2, N)."""
        cells = self.bank(to_blocks(x, self.bank.hop, self.columns), self.bank.analysis)
        power = self.bank.power(cells)
        total = power.sum(1, keepdim=True)
        features = torch.cat([0.5 * log_power(power), cells / torch.sqrt(total + 1e-9)], 1)
        placed = (self.enter(features) + self.position).unsqueeze(2)
        gain = torch.sigmoid(self.leave(self.blocks(placed).squeeze(2)))
        blocks = self.bank.back(cells * torch.cat([gain, gain], 1), self.bank.synthesis)
        return from_blocks(blocks, self.bank.hop, self.columns).reshape(x.shape) * self.norm


class Residual(nn.Module):
    """WaveNet-like stack at a tenth of the rate that estimates the interference and subtracts it."""

    normalisation = "joint_rms"

    def __init__(self, waveform: Waveform, channels: int = 48) -> None:
        super().__init__()
        if waveform.samples_per_frame % 10:
            raise ValueError(
                f"frames of a multiple of 10 samples are needed, not {waveform.samples_per_frame}"
            )
        self.enter = nn.Conv1d(2, channels, 30, stride=10, padding=10)
        self.blocks = GatedStack(channels, (1, 2, 4, 8, 16, 32, 64))
        self.leave = nn.ConvTranspose1d(channels, 2, 30, stride=10, padding=10)
        with torch.no_grad():
            self.leave.weight.mul_(0.01)
            self.leave.bias.zero_()

    def forward(self, x: Tensor) -> Tensor:
        """(B, 2, N) -> (B, 2, N)."""
        return x - self.leave(self.blocks(self.enter(x).unsqueeze(2)).squeeze(2))
