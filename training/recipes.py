"""Named training recipes: network, data, loss, optimiser, budget."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["RECIPES", "Recipe"]


@dataclass(frozen=True)
class Recipe:
    """What `train.py` needs to know.

    Parameters
    ----------
    network, data : str
        Names in `networks.NETWORKS` and `data.CONFIGS`.
    loss : str
        ``"beat"`` or ``"sample"``.
    batch, steps : int
    rate : float
        Peak learning rate of Adam.
    schedule : str
        ``"cosine"`` (warm-up over 200 steps, cosine to 0) or ``"constant"``.
    bfloat16 : bool
        Autocast of the forward pass where the processor has it.
    """

    network: str
    data: str = "fresh"
    loss: str = "beat"
    batch: int = 32
    steps: int = 10_000
    rate: float = 2e-3
    schedule: str = "cosine"
    bfloat16: bool = False


RECIPES: dict[str, Recipe] = {
    "compact": Recipe("compact", steps=10_000),
    # comparison of architectures: same data, same number of examples
    "compare_compact": Recipe("compact", steps=1_500),
    "compare_beat_only": Recipe("beat_only", steps=1_500),
    "compare_beat_spectrum": Recipe("beat_spectrum", steps=1_500),
}
