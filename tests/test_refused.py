"""Settings that cannot be are refused in one line, which names the setting, its value and what is allowed."""

import dataclasses
import importlib
import pkgutil
import re

import numpy as np
import pytest
from hostile import refused

from radalt import core, method, simulate
from radalt.core.altimeter.altimeter import Altimeter, AltimeterSettings
from radalt.core.altimeter.cfar import Cfar
from radalt.core.channel.settings import ChannelSettings, DropSettings
from radalt.core.channel.simulated import SimulatedChannel
from radalt.core.deramp.profile import Profile, load_profile
from radalt.core.interference import Interferer, QpskEmitter, ToneEmitter
from radalt.core.interference.emitters.faa_91_220 import pfd_dbw_per_m2_mhz
from radalt.core.interference.emitters.fmcw import FmcwEmitter
from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.interference.emitters.pulsed_radar import PulsedRadarEmitter
from radalt.core.interference.emitters.qpsk_received import QpskReceivedEmitter
from radalt.core.interference.emitters.recording import RecordingEmitter
from radalt.core.mitigation import create
from radalt.core.mitigation.any_sweep import layout_of
from radalt.core.parsing import Settings
from radalt.core.programme import Programme
from radalt.core.returns.terrain import reflectivity, synthesise
from radalt.core.scene import Scene, parse_scene
from radalt.core.timing.segmenter import SegmenterSettings
from radalt.core.tracker.tracker import AltitudeTracker, TrackerSettings
from radalt.core.waveform import Waveform
from radalt.evaluation.results.break_point import break_point
from radalt.studies.landing.config import parse_config

W, NAN = Waveform(), float("nan")
SAW = {"shape": "sawtooth_up"}
SLOW, SHORT = Waveform(bandwidth_hz=4e6, rate_hz=5e6), Waveform(sweep_s=0.2e-3)


def altimeter(**settings):
    return Altimeter(W, AltimeterSettings(**settings))


def nr(**effects):
    return parse_scene({"interference": {"nr": effects}})


def tones(**sections):
    return parse_scene({"interference": {"tones": {}}} | sections)


def options(**methods):
    return parse_scene({"method_options": methods})


def sent(emitter, rate_hz=W.rate_hz):
    return emitter.samples(100, rate_hz, np.random.default_rng(0))


def channel(**settings):
    return SimulatedChannel(W, ChannelSettings(**settings), frames=60)


REFUSED = [
    (lambda: Waveform(bandwidth_hz=7500), "did you mean 7.5e+06"),
    (lambda: Waveform(carrier_hz=4300.0), "did you mean 4.3e+09"),
    (lambda: Waveform(bandwidth_hz=8e6), "bandwidth_hz 8e+06 exceeds the complex rate 7.5e+06"),
    (lambda: Waveform(sweep_s=1.00003e-3), "try sweep_s = 0.001"),
    (lambda: Waveform(sweep_s=1e-6), "has to be a whole even number of at least 16"),
    (lambda: Waveform(**SAW, centered=False), "has to be centred"),
    (lambda: Waveform(**SAW).beat_shifted(100.0), "a beat shift needs a triangle"),
    (lambda: Scene(waveform=Waveform(**SAW)), "a scene plays a triangle"),
    # receiver
    (lambda: altimeter(max_altitude_m=50_000.0), "altimeter.max_altitude_m 50000 exceeds 37474.1 m"),
    (lambda: altimeter().process(np.zeros((2, 100))), "frames have shape (2, 100); expected (n, 7500)"),
    (lambda: Cfar(train=1), "cfar.train 1 has to be at least 2"),
    (lambda: SegmenterSettings(lock_threshold=2.0), "lock_threshold is 2; below 10 noise locks"),
    (lambda: Programme((-3.0,)), "altitude.programme_m holds -3.0"),
    (lambda: Programme((3.0,), sync_every_frames=10, sync_frames=4), "sync_frames 4 has to be at least"),
    (lambda: AltitudeTracker(altimeter(), TrackerSettings(output_s=0.005)), "at least 8"),
    (lambda: break_point([], []), "at least one SIR"),
    # channel
    (lambda: simulate("clear", frames=2, auxiliary=True), "one receive channel"),
    (lambda: reflectivity("sea"), "constant_gamma, ulaby_dobson, morchin"),
    (lambda: reflectivity("ulaby_dobson"), "soil, grass"),
    (lambda: reflectivity(colour=3), "level_db"),
    (lambda: synthesise(W, np.ones(1), np.array([50e3]), np.zeros(1)), "do not fit"),
    (lambda: ChannelSettings(gear_db=6.0), "channel.gear_db 6 needs channel.leakage_db"),
    (lambda: DropSettings(3, 200, 100), "min_samples 200 <= max_samples 100"),
    (lambda: channel(start_offset_samples=3.5), "below the kernel's 64"),
    (lambda: channel(start_offset_samples=0, jammer_clock_ppm=1.0), "start_offset_samples 0 leaves no room"),
    (lambda: channel(drops=DropSettings(50)), "50 gaps do not fit a run of 60 frames"),
    (lambda: channel().process(np.zeros(10, np.complex64)), "blocks of 7500 samples"),
    (lambda: tones(auxiliary={"directions": [{}, {}]}), "directions has 2 entries for 1 interferers"),
    (lambda: tones(auxiliary={}, channel={"adc_bits": 12}), "convert twice; set one of them to 0"),
    # interference
    (lambda: Interferer(QpskEmitter(), sir_db=float("inf")), "sir_db is inf"),
    (lambda: sent(QpskEmitter(bandwidth_hz=9e6)), "does not fit the rate of 7.5e"),
    (lambda: sent(QpskReceivedEmitter(bandwidth_hz=8e6)), "does not fit the rate"),
    (lambda: sent(ToneEmitter(frequencies_hz=(4e6,))), "leave +/- 3.75e+06 Hz"),
    (lambda: NrEmitter(tdd="DDX"), "tdd"),
    (lambda: NrEmitter(ssb_indices=(1, 1)), "ssb_indices"),
    (lambda: sent(NrEmitter(carrier_hz=6.1e6)), "carrier_hz"),
    (lambda: sent(NrEmitter(), 7_500_001.0), "rate_hz"),
    (lambda: sent(NrEmitter(load=0.0, pdcch_load=0.0, ssb_indices=())), "ssb_indices"),
    (lambda: sent(FmcwEmitter(carrier_hz=100e6, sweep_bandwidth_hz=10e6)), "never crosses"),
    (lambda: sent(FmcwEmitter(sweep_bandwidth_hz=2e9)), "64 times"),
    (lambda: sent(PulsedRadarEmitter(carrier_hz=1e9)), "64 times"),
    (lambda: pfd_dbw_per_m2_mhz(2.9e9), "frequency_hz"),
    (lambda: RecordingEmitter(), "recording.file is missing"),
    (lambda: RecordingEmitter(file="a", rate_hz=7.5), "did you mean 7.5e+06"),
    (lambda: nr(evm="usual"), "evm is 'usual'; it has to be within 0..1 (0.08 is 8 %), or typical"),
    (lambda: nr(amplifier={"gain": 1}), "unknown key 'interference.nr.amplifier.gain'"),
    (lambda: nr(fading={"profile": "TDL-Z"}), "fading.profile 'TDL-Z' is unknown"),
    # mitigation
    (lambda: create("median", W), "unknown mitigation method 'median'; allowed: none, lms,"),
    (lambda: method("none", "nr10"), "waveform is 'nr10'; give a Waveform"),
    (lambda: create("none", W, gain=3), "none.gain is unknown; allowed: nothing"),
    (lambda: create("whitening", W, smooth_hz=3), "is unknown; did you mean 'smoothing_hz'? allowed: smooth"),
    (lambda: create("whitening", W, batch="x"), "whitening.batch is 'x'; it has to be a whole number"),
    (lambda: create("whitening", W).process(np.zeros((2, 100))), "shape (2, 100); expected (n, 7500)"),
    (lambda: create("lms", W, block=0), "lms.length 32 and lms.block 0 have to be within 1..7500"),
    (lambda: create("lms", W, wiring="both"), "is 'both'; allowed: reference_desired, reference_input"),
    (lambda: create("stft_cfar", W, fill="ar"), "stft_cfar.fill is 'ar'; allowed: zero, burg"),
    (lambda: create("tcae", W, shift_check="maybe"), "shift_check is 'maybe'; expected true or false"),
    (lambda: create("hybrid", W, other="lms"), "hybrid.other is 'lms'; one of tcae, whitening"),
    (lambda: create("qpsk_cancel", Waveform(sweep_s=0.1e-3)), "has 750 samples; it takes 1024 or more"),
    (lambda: create("ofdm_cancel", SLOW), "rate_hz is 5e+06; it has to be a multiple of 30000"),
    (lambda: create("ofdm_cancel", W, span_m=-1.0), "ofdm_cancel.span_m is -1.0; it has to be a finite"),
    (lambda: create("ofdm_cancel", SHORT), "a frame shorter than 0.3e-3 holds too few symbols"),
    (lambda: create("blanking", W, own_process="yes"), "own_process is 'yes'"),
    (lambda: layout_of(W, span_m=1e5), "an altitude of 100000 m is"),
    (lambda: options(tcae={"method": "tcae", "model": "x.onnx"}), "cannot be called 'tcae'"),
    (lambda: options(mine={"method": "fft"}), "method is 'fft'; it has to be tcae or custom"),
    (lambda: options(whitening={"waveform": 1}), "the key 'waveform', which the scene itself gives"),
    (lambda: parse_config({"method_options": {"none": ["a"]}}), "expected a mapping of its options"),
]


def declared(cls: type) -> list[type]:
    """Every settings class below this one."""
    return [cls, *(found for below in cls.__subclasses__() for found in declared(below))]


def test_every_declared_limit_is_held():
    """Below and above its limits, no number, no whole one, or not what is allowed: the line names section and field."""
    for module in pkgutil.walk_packages(core.__path__, "radalt.core."):
        importlib.import_module(module.name)
    tried = 0
    for cls in filter(dataclasses.is_dataclass, declared(Settings)):
        rest = dataclasses.asdict(load_profile("typical")) if cls is Profile else {}
        for field in dataclasses.fields(cls):
            low, high, *_ = field.metadata.get("limits") or (None, None)
            wrong = [] if low is None else [low - 1.0, 2.0 * abs(high) + 1.0, float("nan")]
            wrong += [None] * (bool(wrong) and "None" not in str(field.type)) + [0.5] * (field.type is int)
            for value in wrong + ["nothing"] * bool(field.metadata.get("among")):
                tried += 1
                with pytest.raises(ValueError, match=rf"^{cls.section}\.{field.name} is [^\n]*$"):
                    cls(**rest | {field.name: value})
    assert tried > 300


@pytest.mark.parametrize(("make", "said"), REFUSED, ids=[said for _, said in REFUSED])
def test_what_cannot_be_is_refused_in_one_line(make, said):
    with refused(ValueError, re.escape(said)):
        make()
