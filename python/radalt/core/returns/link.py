"""Transmitter, losses and receiver of the radar over terrain."""

from dataclasses import dataclass

from scipy.constants import Boltzmann

from ..parsing import check_range


@dataclass(frozen=True)
class RadarLink:
    """Transmitter, losses and receiver.

    Defaults: the first altimeter of Rec. ITU-R M.2059-0 Table 2 as quoted by MathWorks' *FMCW Radar Altimeter
    Simulation* (0.4 W, noise figure 8 dB, 40 degree beam); the losses are an assumption (3 dB of cable each way).

    Parameters
    ----------
    transmit_w : float
        Transmit power, > 0.
    losses_db : float
        All losses between transmitter and receiver input other than spreading, 0..60.
    noise_figure_db : float
        Receiver noise figure, 0..40, at 290 K.
    """

    transmit_w: float = 0.4
    losses_db: float = 6.0
    noise_figure_db: float = 8.0

    def __post_init__(self) -> None:
        check_range("link", self, transmit_w=(1e-9, 1e4), losses_db=(0.0, 60.0), noise_figure_db=(0.0, 40.0))

    def noise_w(self, bandwidth_hz: float) -> float:
        """Thermal noise ``k T F B`` in watts."""
        return Boltzmann * 290.0 * bandwidth_hz * 10.0 ** (self.noise_figure_db / 10.0)
