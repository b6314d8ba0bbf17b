"""Ranges and limits of radios: one `Device` per type, by its name in a scene's ``radio.device``.

Scenes import this file, and the other radio code imports scenes: it imports only the plugins of this package.
"""

import math
from dataclasses import dataclass

from ..plugins import load_plugins


@dataclass(frozen=True, kw_only=True)
class Device:
    """A type of radio that UHD drives. Ranges are (lowest, highest), both allowed.

    - ``tuning_hz``, ``master_clock_hz``, ``rate_hz`` (float, float): centre frequencies, master clocks and sample
      rates
    - ``tx_gain_db``, ``rx_gain_db`` (float, float)
    - ``tx_antenna``, ``rx_antenna``: ports, distinct since the radar transmits and receives at once
    """

    name: str  # name in a scene
    title: str  # name in messages
    uhd_type: str  # UHD's device argument ``type``
    uhd_name: str  # UHD's name of the motherboard (``mboard_id``): a radio with another name is refused
    tuning_hz: tuple[float, float]
    master_clock_hz: tuple[float, float]
    rate_hz: tuple[float, float]
    tx_gain_db: tuple[float, float]
    rx_gain_db: tuple[float, float]
    max_tx_dbm: float  # power of a full-scale tone at the highest transmit gain, an upper bound
    max_rx_dbm: float  # highest input that does no damage
    tx_antenna: str
    rx_antenna: str
    two_channels_hz: float = 0.0  # highest master clock with two receive channels; 0 where there is one
    # samples per second that the link to the computer carries, both directions together
    link_hz: float = math.inf

    def __post_init__(self) -> None:
        for name in ("tuning_hz", "master_clock_hz", "rate_hz", "tx_gain_db", "rx_gain_db"):
            low, high = getattr(self, name)
            if not low < high:
                raise ValueError(f"{self.name}.{name} is {low:g}..{high:g}; give (lowest, highest)")

    def tx_power_dbm(self, gain_db: float) -> float:
        """Highest power of a full-scale tone at a transmit gain: a decibel less for each decibel of gain less."""
        return self.max_tx_dbm - (self.tx_gain_db[1] - gain_db)


B210 = Device(
    name="b210",
    title="B210",
    uhd_type="b200",
    uhd_name="B210",
    tuning_hz=(70e6, 6e9),
    master_clock_hz=(5e6, 61.44e6),
    rate_hz=(5e6 / 512, 61.44e6),  # the slowest clock through the longest decimation
    tx_gain_db=(0.0, 89.75),
    rx_gain_db=(0.0, 76.0),
    max_tx_dbm=20.0,  # an upper bound: some decibels less at 4.3 GHz
    max_rx_dbm=-15.0,
    tx_antenna="TX/RX",
    rx_antenna="RX2",
    two_channels_hz=30.72e6,
    link_hz=61.44e6,  # 246 MB/s of 16-bit IQ, host bandwidth of USB 3 (Ettus AN-177)
)
DEVICES: dict[str, Device] = {}


def register(new: Device) -> Device:
    """Make a radio known to scenes; returns it. Raises `ValueError` if another radio has the name."""
    if not new.name.isidentifier() or DEVICES.get(new.name, new) != new:
        raise ValueError(f"a radio's name {new.name!r} is taken or no identifier; choose another")
    DEVICES[new.name] = new
    return new


def device(name: str) -> Device:
    """A radio by its name in a scene. Raises `ValueError` for an unknown one; names those that are known."""
    if name not in DEVICES:
        raise ValueError(f"radio.device is {name!r}; allowed: {', '.join(DEVICES)}")
    return DEVICES[name]


register(B210)
load_plugins()
