"""Training losses: what the altimeter sees, and plain samples."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from radalt.core.waveform import Waveform

__all__ = ["BeatLoss", "sample_loss"]


class BeatLoss(nn.Module):
    """Mean log of the normalised error of the beat spectra after the best complex scale.

    For each half sweep it is ``1 - |<y, s>|^2 / (|y|^2 |s|^2)``, with ``y`` and ``s`` the beat cells (2 kHz) of output
    and clean return over the beats of 0 to 1500 m and ``margin`` cells on each side: one minus the squared coherence.
    Scale and phase do not matter, and every decibel of signal to error counts the same.

    Parameters
    ----------
    waveform : Waveform
    max_altitude_m : float
    margin : int
        Cells on each side. With frames without a return in the data, they have to include those from which the
        altimeter takes its noise level, or the network removes them.
    floor : float
        Error share below which the loss falls no further.
    faint : float
        Coherence below which the loss rises no further: minus the log of the coherence is added, so that a return
        hardly above the residual counts by decibels, too. 0 adds nothing.
    """

    def __init__(
        self,
        waveform: Waveform,
        *,
        max_altitude_m: float = 1500.0,
        margin: int = 15,
        floor: float = 1e-3,
        faint: float = 0.0,
    ) -> None:
        super().__init__()
        self.half, self.floor, self.faint = waveform.samples_per_half, floor, faint
        cell_hz = 1.0 / waveform.half_sweep_s
        top = int(np.ceil(float(waveform.altitude_to_beat_hz(max_altitude_m)) / cell_hz)) + margin
        beats = np.arange(-margin, top + 1)
        self.register_buffer("cells", torch.tensor(np.stack([-beats, beats]) % self.half), persistent=False)
        conjugate = torch.tensor(np.conj(waveform.reference).reshape(2, self.half))
        self.register_buffer("conjugate", conjugate, persistent=False)

    def beats(self, frames: Tensor) -> Tensor:
        """(B, 2, N) planes -> (B, 2 halves, cells) complex."""
        x = torch.complex(frames[:, 0], frames[:, 1]).reshape(-1, 2, self.half)
        spectrum = torch.fft.fft(x * self.conjugate)
        index = self.cells.expand(spectrum.shape[0], -1, -1)
        return torch.gather(spectrum, 2, index)

    def error(self, output: Tensor, clean: Tensor) -> Tensor:
        """(B, 2) error share of each half sweep, 0..1."""
        y, s = self.beats(output), self.beats(clean)
        cross = (y.conj() * s).sum(2).abs() ** 2
        energy = (y.abs() ** 2).sum(2) * (s.abs() ** 2).sum(2)
        return (1 - cross / (energy + 1e-12)).clamp(min=0)

    def forward(self, output: Tensor, clean: Tensor) -> Tensor:
        """Scalar, in nepers of power."""
        error = self.error(output, clean)
        loss = torch.log(error + self.floor)
        if self.faint:
            loss = loss - torch.log(1 - error + self.faint)
        return loss.mean()


def sample_loss(output: Tensor, clean: Tensor) -> Tensor:
    """Mean squared error of the samples, as the paper trains."""
    return torch.mean((output - clean) ** 2)
