"""Transmitter, losses and receiver of the radar over terrain."""

from dataclasses import dataclass

from scipy.constants import Boltzmann

from ..parsing import Settings, setting


@dataclass(frozen=True)
class RadarLink(Settings, where="link"):
    """Transmitter, losses and receiver.

    Defaults: the first altimeter of Rec. ITU-R M.2059-0 Table 2 as quoted by MathWorks' *FMCW Radar Altimeter
    Simulation* (0.4 W, noise figure 8 dB, 40 degree beam); the losses are an assumption (3 dB of cable each way).
    """

    transmit_w: float = setting(0.4, 1e-9, 1e4)
    """Transmit power."""
    losses_db: float = setting(6.0, 0.0, 60.0)
    """All losses between transmitter and receiver input other than spreading."""
    noise_figure_db: float = setting(8.0, 0.0, 40.0)
    """Receiver noise figure, at 290 K."""

    def noise_w(self, bandwidth_hz: float) -> float:
        """Thermal noise ``k T F B`` in watts."""
        return Boltzmann * 290.0 * bandwidth_hz * 10.0 ** (self.noise_figure_db / 10.0)
