"""Named training recipes: network, data, loss, optimiser, budget."""

from __future__ import annotations

from dataclasses import dataclass, replace

from radalt.core.waveform import Waveform

__all__ = ["RECIPES", "Recipe"]


@dataclass(frozen=True)
class Recipe:
    """A recipe for `train.py`.

    Attributes
    ----------
    network, data : str
        Names in `networks.NETWORKS` and `configs.CONFIGS`.
    loss : str
        ``"beat"`` or ``"sample"``.
    batch, steps : int
    rate : float
        Peak learning rate of Adam.
    schedule : str
        ``"cosine"`` (warm-up over 200 steps, cosine to 0) or ``"constant"``.
    bfloat16 : bool
        Autocast of the forward pass if the processor supports it.
    start_from : str
        Recipe whose checkpoint the network starts from; empty for random weights.
    dropped_blocks : tuple of int
        Gated blocks of that checkpoint's network that this one does not have.
    margin, faint, floor
        As in `losses.BeatLoss`.
    samples : int
        Samples per frame, at the default bandwidth and rate; they set the sweep's duration.
    stop : int
        Step after which training ends, although the schedule is for ``steps``; 0 for ``steps``.
    """

    network: str
    data: str = "fresh"
    loss: str = "beat"
    batch: int = 32
    steps: int = 10_000
    rate: float = 2e-3
    schedule: str = "cosine"
    bfloat16: bool = False
    start_from: str = ""
    dropped_blocks: tuple[int, ...] = ()
    margin: int = 15
    faint: float = 0.0
    floor: float = 1e-3
    samples: int = 7_500
    stop: int = 0

    @property
    def waveform(self) -> Waveform:
        """The sweep it trains on."""
        return replace(Waveform(), sweep_s=self.samples / Waveform().rate_hz)


_PAPER = {
    "loss": "sample",
    "batch": 128,
    "steps": 58_594,
    "rate": 1e-3,
    "schedule": "constant",
    "bfloat16": True,
}
# the predecessor's first step: 1,000 samples, 10,000 examples, kernel 300
_SHORT = {
    "loss": "sample",
    "data": "predecessor",
    "batch": 16,
    "steps": 2_000,
    "rate": 1e-3,
    "schedule": "constant",
    "samples": 1_000,
}
RECIPES: dict[str, Recipe] = {
    # the shipped model in seven parts: 2,750 steps of a schedule of 10,000; SIR down to -62 dB; interferers as
    # received; the smaller network (training/networks/__init__.py); more NR and mixtures; SNR up to 45 dB;
    # interferers with white noise of their own
    "compact_first": Recipe("compact_wide", steps=10_000, stop=2_750),
    "compact_deep": Recipe("compact_wide", data="deep", steps=5_000, rate=1.5e-3, start_from="compact_first"),
    "compact_received": Recipe(
        "compact_wide", data="received", steps=5_250, rate=1e-3, start_from="compact_deep"
    ),
    "compact_lean": Recipe(
        "compact", data="lean", steps=9_000, rate=1e-3, start_from="compact_received", dropped_blocks=(2, 4)
    ),
    "compact_crowded": Recipe("compact", data="crowded", steps=6_000, rate=1e-3, start_from="compact_lean"),
    "compact_ground": Recipe("compact", data="ground", steps=4_500, rate=1e-3, start_from="compact_crowded"),
    "compact": Recipe(
        "compact", data="noisy", batch=64, steps=8_000, rate=1e-3, faint=0.02, start_from="compact_ground"
    ),
    # for any sweep, and for frames without a return
    "any_sweep": Recipe(
        "compact", data="any_sweep", steps=5_000, rate=1e-3, start_from="compact_ground", margin=26
    ),
    # both continued from their shipped weights (--start): typical transmitters, returns beyond the span treated as
    # noise, and a floor of the loss below their error on clean frames
    "compact_typical": Recipe(
        "compact",
        data="typical",
        batch=64,
        steps=4_000,
        rate=5e-4,
        faint=0.02,
        floor=1e-5,
        start_from="compact",
    ),
    "any_sweep_typical": Recipe(
        "compact",
        data="any_sweep_typical",
        steps=4_000,
        rate=5e-4,
        margin=26,
        floor=1e-5,
        start_from="any_sweep",
    ),
    # the paper's recipe, 150 epochs of 50,000, Adam 1e-3, from random weights, for all three of its networks
    "paper": Recipe("paper", data="paper", **_PAPER),
    "fc": Recipe("fc", data="paper", **_PAPER),
    "cnn": Recipe("cnn", data="paper", **_PAPER),
    # with batch normalisation, without which it stays on the plateau at this rate (see cnn_short below)
    "cnn_normalised": Recipe("cnn_normalised", data="paper", **_PAPER),
    # experiments: why the convolutions stay on the plateau
    "cnn_short": Recipe("cnn_300", **_SHORT),
    "cnn_short_rate_1e-4": Recipe("cnn_300", **(_SHORT | {"rate": 1e-4})),
    "cnn_short_rate_1e-5": Recipe("cnn_300", **(_SHORT | {"rate": 1e-5})),
    "cnn_short_normalised": Recipe("cnn_300_normalised", **_SHORT),
    "cnn_short_wide": Recipe("cnn_300_wide", **_SHORT),
    # experiments: whether the paper's network leaves the plateau at 0.5; two thirds of an epoch, from random weights
    "plateau_paper": Recipe("paper", data="paper", stop=260, **_PAPER),
    "plateau_dropout_0": Recipe("paper_dropout_0", data="paper", stop=260, **_PAPER),
    "plateau_dropout_30": Recipe("paper_dropout_30", data="paper", stop=260, **_PAPER),
    "plateau_rate_1e-4": Recipe("paper", data="paper", stop=260, **(_PAPER | {"rate": 1e-4})),
    "plateau_warm_up": Recipe("paper", data="paper", stop=260, **(_PAPER | {"schedule": "cosine"})),
    # comparison of architectures: same data, same number of examples, same loss
    "compare_compact_wide": Recipe("compact_wide", steps=700),
    "compare_beat_spectrum": Recipe("beat_spectrum", steps=700),
    "compare_beat_only": Recipe("beat_only", steps=700),
    "compare_mask": Recipe("mask", steps=700),
    "compare_residual": Recipe("residual", steps=700),
}
