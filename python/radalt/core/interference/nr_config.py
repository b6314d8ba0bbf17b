"""Configuration of an NR downlink carrier in FR1 (TS 38.101-1, 38.211, 38.213, 38.214)."""

from dataclasses import dataclass

from ..parsing import Settings, setting
from . import nr_sequences as seq
from .evm import check_evm

SUBCARRIER_SPACING_HZ = 15e3  # numerology 0
# TS 38.101-1 Table 5.3.2-1. 5 MHz at 30 kHz, 11 blocks, is left out: an SS/PBCH block needs 20.
RESOURCE_BLOCKS = {
    15e3: {5e6: 25, 10e6: 52, 15e6: 79, 20e6: 106, 25e6: 133, 30e6: 160, 40e6: 216, 50e6: 270},
    30e3: {
        **{10e6: 24, 15e6: 38, 20e6: 51, 25e6: 65, 30e6: 78, 40e6: 106, 50e6: 133},
        **{60e6: 162, 70e6: 189, 80e6: 217, 90e6: 245, 100e6: 273},
    },
}
MIXED = "mixed"
MODULATIONS = (*seq.BITS_PER_SYMBOL, MIXED)
SYMBOLS_PER_SLOT = 14  # normal cyclic prefix, TS 38.211 Table 4.3.2-1
SSB_SUBCARRIERS = 240  # TS 38.211 clause 7.4.3.1
SSB_START_SYMBOLS = (2, 8)  # cases A (15 kHz) and C (30 kHz), TS 38.213 clause 4.1: {2, 8} + 14 n
SSB_INDICES = 8  # L_max, SS/PBCH blocks in a half-frame of a carrier above 3 GHz, TS 38.213 clause 4.1
DOWNLINK_SYMBOLS = {"D": 14, "S": 10, "U": 0}  # downlink symbols by kind of slot; S is the common 10 : 2 : 2
_MOST_SAMPLES = 1 << 25  # longest signal at the native rate, samples: 0.5 GB


@dataclass(frozen=True, kw_only=True)
class NrConfig(Settings, where="nr"):
    """An NR downlink carrier in FR1: normal cyclic prefix, one or two layers as received by one antenna."""

    channel_bandwidth_hz: float = 5e6
    """5e6 (25 resource blocks of 15 kHz spacing), 10e6 (52; 24 of 30 kHz) and so on to 50e6, with 30 kHz to 100e6
    (273); TS 38.101-1 Table 5.3.2-1."""
    subcarrier_spacing_hz: float = SUBCARRIER_SPACING_HZ
    """15e3 or 30e3."""
    cell_id: int = 0
    """Physical cell identity, 0..1007."""
    modulation: str = "64qam"
    """PDSCH modulation, 'qpsk', '16qam', '64qam' or '256qam'; 'mixed' draws one for each user, that is each resource
    block group (TS 38.214 Table 5.1.2.2.1-1, configuration 1) in each slot."""
    power_spread_db: float = setting(0.0, 0.0, 30.0)
    """Users' powers are drawn evenly between this many dB below the strongest and 0; a user is a resource
    block group in a slot."""
    load: float = setting(1.0, 0.0, 1.0)
    """Fraction of the resource blocks given to PDSCH in each slot; one contiguous allocation at a random place
    (type 1, not interleaved)."""
    pdcch_load: float = setting(0.5, 0.0, 1.0)
    """Fraction of the CORESET's control channel elements in use."""
    ssb_indices: tuple[int, ...] = (0,)
    """SS/PBCH blocks sent in half-frame 0, in the middle of the carrier, distinct, each 0..7; empty for none."""
    frame_count: int = setting(1, 1, 100)
    """Number of different 10 ms frames before the signal repeats."""
    seed: int = setting(0, 0, 2**63 - 1)
    """Seed of the payload bits, the allocations, the precoders and the error vectors."""
    evm: float | str = 0.0
    """Error vector magnitude of the transmitter, RMS fraction of the mean PDSCH element's amplitude, 0..1: complex
    white, drawn for every element of every radio frame, before the prefix is copied. 'typical' is half the limit of
    TS 38.104 Table 6.5.2.2-1 for the element's modulation: 8.75, 6.25, 4 and 1.75 % for QPSK to 256QAM."""
    precoding: bool = False
    """A phase, and an amplitude within 6 dB, drawn for every group of four resource blocks and slot, of PDSCH and its
    DM-RS."""
    second_layer_db: float | None = setting(None, -40.0, 20.0)
    """Power of a second layer (DM-RS port 1001) on the same elements against the first; None for one layer."""
    tdd: str = ""
    """Pattern of slots, such as 'DDDSU': downlink, special (10 downlink symbols, then a gap and uplink), uplink,
    which is not simulated; its length divides a radio frame's. Empty is downlink only."""
    csi_rs: bool = False
    """Whether the tracking reference signal (a CSI-RS of one port, density 3) is sent, in two slots of a frame."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.subcarrier_spacing_hz not in RESOURCE_BLOCKS:
            raise ValueError(
                f"subcarrier_spacing_hz {self.subcarrier_spacing_hz:g} is not supported; choose 15e3 or 30e3"
            )
        carriers = RESOURCE_BLOCKS[self.subcarrier_spacing_hz]
        if self.channel_bandwidth_hz not in carriers:
            raise ValueError(
                f"channel_bandwidth_hz {self.channel_bandwidth_hz:g} is not supported with subcarrier_spacing_hz "
                f"{self.subcarrier_spacing_hz:g}; choose one of "
                f"{', '.join(f'{hz / 1e6:g}e6' for hz in carriers)}{' (30e3: to 100e6)' * (100e6 not in carriers)}"
            )
        seq.check_cell_id(self.cell_id)
        if self.modulation not in MODULATIONS:
            raise ValueError(
                f"modulation {self.modulation!r} is unknown; choose one of {', '.join(MODULATIONS)}"
            )
        check_evm("nr", self.evm)
        if self.tdd and (set(self.tdd) - set(DOWNLINK_SYMBOLS) or self.slots_per_frame % len(self.tdd)):
            raise ValueError(
                f"tdd {self.tdd!r} has to be slots D, S and U, as many as divide the {self.slots_per_frame} of a radio "
                "frame, such as DDDSU"
            )
        self._check_ssb()
        if self.frame_count * self.sample_rate_hz / 100 > _MOST_SAMPLES:
            raise ValueError(
                f"frame_count {self.frame_count} of {self.channel_bandwidth_hz / 1e6:g} MHz take more than 0.5 GB; "
                f"use at most {int(_MOST_SAMPLES * 100 / self.sample_rate_hz)}"
            )
        if self.csi_rs and not self.trs_slots:
            raise ValueError(
                "csi_rs needs two downlink slots in a row without SS/PBCH blocks; change tdd or ssb_indices"
            )

    def _check_ssb(self) -> None:
        # a list from YAML must stay hashable
        object.__setattr__(self, "ssb_indices", tuple(self.ssb_indices))
        if len(set(self.ssb_indices)) != len(self.ssb_indices):
            raise ValueError(f"ssb_indices {self.ssb_indices} repeat an index; list each block once")
        for index in self.ssb_indices:
            if not 0 <= index < SSB_INDICES:
                raise ValueError(
                    f"ssb_indices {self.ssb_indices} hold {index}, outside 0..{SSB_INDICES - 1}; drop it"
                )
            last = SSB_START_SYMBOLS[index % 2] + 4
            if DOWNLINK_SYMBOLS[self.slot_kinds[index // 2]] < last:
                raise ValueError(
                    f"ssb_indices {self.ssb_indices} hold {index}, whose symbols tdd {self.tdd!r} does not "
                    "give to the downlink; drop it"
                )

    @property
    def resource_blocks(self) -> int:
        """Transmission bandwidth N_RB in resource blocks."""
        return RESOURCE_BLOCKS[self.subcarrier_spacing_hz][self.channel_bandwidth_hz]

    @property
    def subcarriers(self) -> int:
        """12 N_RB."""
        return 12 * self.resource_blocks

    @property
    def occupied_bandwidth_hz(self) -> float:
        """12 N_RB subcarrier spacings."""
        return self.subcarriers * self.subcarrier_spacing_hz

    @property
    def fft_length(self) -> int:
        """Smallest power of two, from 512 on, with as many subcarriers: 512 or 1024 for 5 or 10 MHz of 15 kHz."""
        return max(512, 1 << (self.subcarriers - 1).bit_length())

    @property
    def slots_per_frame(self) -> int:
        """10, or 20 with a spacing of 30 kHz."""
        return round(10 * self.subcarrier_spacing_hz / SUBCARRIER_SPACING_HZ)

    @property
    def slot_kinds(self) -> str:
        """'D', 'S' or 'U' of each slot of a radio frame."""
        return (self.tdd or "D") * (self.slots_per_frame // len(self.tdd or "D"))

    @property
    def trs_slots(self) -> tuple[int, ...]:
        """The two slots of a radio frame with the tracking reference signal, empty where there are none."""
        busy = {index // 2 for index in self.ssb_indices}
        free = [slot for slot, kind in enumerate(self.slot_kinds) if kind == "D" and slot not in busy]
        return next(((a, b) for a, b in zip(free, free[1:], strict=False) if b == a + 1), ())

    @property
    def group_blocks(self) -> int:
        """Resource block group, TS 38.214 Table 5.1.2.2.1-1, configuration 1."""
        sizes = ((36, 2), (72, 4), (144, 8), (275, 16))
        return next(size for most, size in sizes if self.resource_blocks <= most)

    @property
    def sample_rate_hz(self) -> float:
        """Native rate: 7.68e6, 15.36e6 and so on to 122.88e6."""
        return self.fft_length * self.subcarrier_spacing_hz

    @property
    def ssb_first_subcarrier(self) -> int:
        """First of the 240 subcarriers of the SS/PBCH blocks."""
        return (self.subcarriers - SSB_SUBCARRIERS) // 2
