"""Samples of GNU Radio's transmitters: interference that is independent of this package's emitters.

DVB-T, DVB-T2, ATSC and DVB-S2 are the flowgraphs of gr-dtv's examples, OFDM is gr-digital's packet transmitter. Each
transmits random transport packets or bytes, drawn from a seed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from math import pi
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from gnuradio import gr

_LIMIT_S = 300.0  # longest run of a transmitter, s
_TS_PACKET = 188  # transport packet, bytes, ISO/IEC 13818-1
_SYNC = 0x47  # its first byte
_ATSC_SYMBOL_HZ = Fraction(4_500_000 * 684, 286)  # 10.76 MHz, ATSC A/53 Part 2
_ATSC_CHANNEL_HZ = 6e6  # channel bandwidth, ATSC A/53
# samples skipped until filters and interleavers are filled with data; the longest is ATSC's of 52 segments
_RAMP = 60_000


@dataclass(frozen=True)
class Transmitter:
    """One transmitter."""

    title: str
    rate_hz: float  # rate of the samples from `transmit`
    # ``(seed) -> [blocks]``, from a source to a block with complex output
    chain: "Callable[[int], list[gr.basic_block]]"
    made_at_hz: Fraction | None = None  # rate of the chain's output, if it differs


def transmit(name: str, seconds: float, seed: int) -> np.ndarray:
    """(n,) complex128 of ``seconds`` of a transmitter of `TRANSMITTERS` at its rate, mean power 1."""
    from gnuradio import blocks, gr

    from .flowgraph.run import run_to_end

    one = TRANSMITTERS[name]
    made_hz = one.made_at_hz or Fraction(one.rate_hz)
    wanted = round(seconds * one.rate_hz)
    count = -(-wanted * made_hz // Fraction(one.rate_hz)) + 2 * _RAMP
    top = gr.top_block()
    sink = blocks.vector_sink_c(1, int(count))
    chain = [*one.chain(seed), blocks.head(gr.sizeof_gr_complex, int(count)), sink]
    top.connect(*chain)
    run_to_end(top, time_limit_s=_LIMIT_S)
    samples = np.array(sink.data(), dtype=np.complex128)[_RAMP:]
    if one.made_at_hz is not None:
        from scipy import signal

        ratio = Fraction(one.rate_hz) / one.made_at_hz
        samples = signal.resample_poly(samples, ratio.numerator, ratio.denominator)
    samples = samples[:wanted]
    return samples / np.sqrt(np.mean(np.abs(samples) ** 2))


def _transport_stream(seed: int) -> "gr.basic_block":
    """Random transport packets without end."""
    from gnuradio import blocks

    packets = np.random.default_rng(seed).integers(0, 256, (2_000, _TS_PACKET), dtype=np.uint8)
    packets[:, 0] = _SYNC
    return blocks.vector_source_b(packets.ravel().tolist(), True)


def _dvbt(seed: int) -> "list[gr.basic_block]":
    """ETSI EN 300 744: 2k, 64QAM, rate 2/3, guard 1/32, as in gr-dtv's dvbt_tx_2k.grc."""
    from gnuradio import digital, dtv, gr

    carriers, length, guard = 1512, 2048, 64
    mode = dtv.MOD_64QAM, dtv.NH
    return [
        _transport_stream(seed),
        dtv.dvbt_energy_dispersal(1),
        dtv.dvbt_reed_solomon_enc(2, 8, 0x11D, 255, 239, 8, 51, 8),
        dtv.dvbt_convolutional_interleaver(136, 12, 17),
        dtv.dvbt_inner_coder(1, carriers, *mode, dtv.C2_3),
        dtv.dvbt_bit_inner_interleaver(carriers, *mode, dtv.T2k),
        dtv.dvbt_symbol_inner_interleaver(carriers, dtv.T2k, 1),
        dtv.dvbt_map(carriers, *mode, dtv.T2k, 1),
        dtv.dvbt_reference_signals(
            gr.sizeof_gr_complex, carriers, length, *mode, dtv.C2_3, dtv.C2_3, dtv.GI_1_32, dtv.T2k, 1, 0
        ),
        digital.ofdm_cyclic_prefixer(length, length + guard, 0, ""),
    ]


def _dvbt2(seed: int) -> "list[gr.basic_block]":
    """ETSI EN 302 755: 2k, 16QAM, rate 3/5, guard 1/8, as in gr-dtv's vv010-2kfft.grc."""
    from gnuradio import digital, dtv

    length, symbols, code = 2048, 983, dtv.C3_5
    frame = dtv.CARRIERS_NORMAL, dtv.FFTSIZE_2K
    shape = dtv.PILOT_PP2, dtv.GI_1_8, symbols, dtv.PAPR_OFF, dtv.VERSION_111, dtv.PREAMBLE_T2_SISO
    return [
        *_base_band_frames(seed, dtv.STANDARD_DVBT2, code, dtv.RO_0_35),
        dtv.dvbt2_interleaver_bb(dtv.FECFRAME_NORMAL, code, dtv.MOD_16QAM),
        dtv.dvbt2_modulator_bc(dtv.FECFRAME_NORMAL, dtv.MOD_16QAM, dtv.ROTATION_ON),
        dtv.dvbt2_cellinterleaver_cc(dtv.FECFRAME_NORMAL, dtv.MOD_16QAM, 93, 3),
        dtv.dvbt2_framemapper_cc(
            *(dtv.FECFRAME_NORMAL, code, dtv.MOD_16QAM, dtv.ROTATION_ON, 93, 3, *frame, dtv.GI_1_8),
            *(
                dtv.L1_MOD_QPSK,
                dtv.PILOT_PP2,
                2,
                symbols,
                dtv.PAPR_OFF,
                dtv.VERSION_111,
                dtv.PREAMBLE_T2_SISO,
            ),
            *(dtv.INPUTMODE_NORMAL, dtv.RESERVED_OFF, dtv.L1_SCRAMBLED_OFF, dtv.INBAND_OFF),
        ),
        dtv.dvbt2_freqinterleaver_cc(*frame, *shape),
        dtv.dvbt2_pilotgenerator_cc(
            *frame, *shape, dtv.MISO_TX1, dtv.EQUALIZATION_OFF, dtv.BANDWIDTH_7_0_MHZ, length
        ),
        digital.ofdm_cyclic_prefixer(length, length + length // 8, 0, ""),
        dtv.dvbt2_p1insertion_cc(
            dtv.CARRIERS_NORMAL,
            dtv.FFTSIZE_2K,
            dtv.GI_1_8,
            symbols,
            dtv.PREAMBLE_T2_SISO,
            dtv.SHOWLEVELS_OFF,
            3.3,
        ),
    ]


def _base_band_frames(seed: int, standard: int, code: int, rolloff: int) -> "list[gr.basic_block]":
    """Coded base-band frames of the second generation of DVB."""
    from gnuradio import dtv

    kind = standard, dtv.FECFRAME_NORMAL, code
    return [
        _transport_stream(seed),
        dtv.dvb_bbheader_bb(*kind, rolloff, dtv.INPUTMODE_NORMAL, dtv.INBAND_OFF, 168, 4_000_000),
        dtv.dvb_bbscrambler_bb(*kind),
        dtv.dvb_bch_bb(*kind),
        dtv.dvb_ldpc_bb(*kind, dtv.MOD_OTHER),
    ]


def _atsc(seed: int) -> "list[gr.basic_block]":
    """ATSC A/53: 8-VSB with its pilot, as in gr-dtv's file_atsc_tx.grc."""
    from gnuradio import blocks, dtv, filter, gr
    from gnuradio.filter import firdes

    symbol_hz = float(_ATSC_SYMBOL_HZ)
    pilot_hz = (_ATSC_CHANNEL_HZ - symbol_hz / 2) / 2
    taps = firdes.root_raised_cosine(0.11, symbol_hz, symbol_hz / 2, 0.1152, 200)
    return [
        _transport_stream(seed),
        dtv.atsc_pad(),
        dtv.atsc_randomizer(),
        dtv.atsc_rs_encoder(),
        dtv.atsc_interleaver(),
        dtv.atsc_trellis_encoder(),
        dtv.atsc_field_sync_mux(),
        blocks.vector_to_stream(gr.sizeof_char, 1024),
        blocks.keep_m_in_n(gr.sizeof_char, 832, 1024, 4),
        dtv.dvbs2_modulator_bc(dtv.FECFRAME_NORMAL, dtv.C1_4, dtv.MOD_8VSB, dtv.INTERPOLATION_OFF),
        blocks.rotator_cc(2 * pi * (pilot_hz - _ATSC_CHANNEL_HZ / 2) / symbol_hz),
        filter.fft_filter_ccc(1, taps),
    ]


def _dvbs2(seed: int) -> "list[gr.basic_block]":
    """ETSI EN 302 307: QPSK, rate 1/2, roll-off 0.2, pilots, two samples a symbol, as in gr-dtv's dvbs2_tx.grc."""
    from gnuradio import dtv, filter
    from gnuradio.filter import firdes

    kind = dtv.FECFRAME_NORMAL, dtv.C1_2, dtv.MOD_QPSK
    return [
        *_base_band_frames(seed, dtv.STANDARD_DVBS2, dtv.C1_2, dtv.RO_0_20),
        dtv.dvbs2_interleaver_bb(*kind),
        dtv.dvbs2_modulator_bc(*kind, dtv.INTERPOLATION_ON),
        dtv.dvbs2_physical_cc(*kind, dtv.PILOTS_ON, 0),
        filter.fft_filter_ccc(1, firdes.root_raised_cosine(0.9, 2.0, 1.0, 0.2, 100)),
    ]


def _ofdm(seed: int) -> "list[gr.basic_block]":
    """gr-digital's `ofdm_tx`: 64 carriers, 48 of them data (QPSK, header BPSK), prefix of 16, in packets."""
    from gnuradio import blocks, digital, gr

    octets, packet = np.random.default_rng(seed).integers(0, 256, 96_000, dtype=np.uint8), 96
    return [
        blocks.vector_source_b(octets.tolist(), True),
        blocks.stream_to_tagged_stream(gr.sizeof_char, 1, packet, "packet_length"),
        digital.ofdm_tx(
            packet_length_tag_key="packet_length", bps_header=1, bps_payload=2, scramble_bits=True
        ),
    ]


TRANSMITTERS = {
    "dvbt": Transmitter("DVB-T, 2k, 64QAM, in a 7 MHz channel", 8e6, _dvbt),
    "dvbt2": Transmitter("DVB-T2, 2k, 16QAM, in a 7 MHz channel", 8e6, _dvbt2),
    "atsc": Transmitter("ATSC, 8-VSB", 10e6, _atsc, made_at_hz=_ATSC_SYMBOL_HZ),
    "dvbs2": Transmitter("DVB-S2, QPSK, 5 MBd", 10e6, _dvbs2),
    "ofdm": Transmitter("OFDM packets of 64 carriers over 10 MHz", 10e6, _ofdm),
}
