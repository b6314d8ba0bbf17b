"""Mitigation methods: what each can do, where it must break, and that none harms where there is nothing to mend."""

import numpy as np
import pytest
from frames import ALTIMETER, W, white

from radalt import Altimeter, AltimeterSettings, Waveform
from radalt.core.altimeter.altimeter import Reason
from radalt.core.interference import Interferer, QpskEmitter, ToneEmitter, interference_frames
from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.mitigation import METHODS, MitigationError, create
from radalt.core.returns.point import point_return

CLASSICAL = [name for name, method in METHODS.items() if not method.runs_network]


def scene(count: int, interferer: Interferer | None, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """(count, N) received frames and their altitudes, the SNR being 10 dB before dechirping."""
    rng = np.random.default_rng(seed)
    altitudes = rng.uniform(3, 1500, count)
    frames = point_return(W, altitudes, dtype=np.complex128)
    frames += np.sqrt(0.05) * (rng.standard_normal(frames.shape) + 1j * rng.standard_normal(frames.shape))
    if interferer is not None:
        frames += interference_frames([interferer], count, 7500, 7.5e6, rng)
    return frames.astype(np.complex64), altitudes


def correct(frames: np.ndarray, altitudes: np.ndarray) -> np.ndarray:
    """detected, both sweeps agree, |error| < 5 m."""
    result = ALTIMETER.process(frames)
    return result["valid"] & (np.abs(np.nan_to_num(result["altitude_m"], nan=1e9) - altitudes) < 5.0)


def pd(name: str, interferer: Interferer | None, count: int = 200, seed: int = 1) -> float:
    frames, altitudes = scene(count, interferer, seed)
    return float(correct(create(name, W).process(frames), altitudes).mean())


# -- what each method reaches -----------------------------------------------------------------------------------------
def test_no_mitigation_breaks_between_22_and_30_db():
    """Dechirping alone compresses by some 36 dB."""
    rates = {sir: pd("none", Interferer(QpskEmitter(), sir)) for sir in (-22.0, -30.0)}
    assert rates[-30.0] < 0.9 <= rates[-22.0]


@pytest.mark.parametrize("emitter", [QpskEmitter(pulse="rrc"), ToneEmitter(5)])
def test_whitening_holds_at_40_db_against_a_band_and_against_tones(emitter):
    assert pd("none", Interferer(emitter, -40.0)) < 0.3 < 0.95 <= pd("whitening", Interferer(emitter, -40.0))


def test_blanking_gains_on_a_strong_short_burst():
    interferer = Interferer(QpskEmitter(), -35.0, 0.1)
    assert pd("blanking", interferer) > pd("none", interferer) + 0.3


@pytest.mark.parametrize("name", ["none", "whitening", "blanking"])
def test_method_is_harmless_where_nothing_is_wrong(name):
    """The clean frame's altitude stays: every detection kept, the error not half as large again."""
    frames, altitudes = scene(150, None, 2)
    cleaned = create(name, W).process(frames)
    assert correct(cleaned, altitudes).all()
    rms = [np.sqrt(np.mean((ALTIMETER.process(f)["altitude_m"] - altitudes) ** 2)) for f in (frames, cleaned)]
    assert rms[1] < 1.5 * rms[0] + 0.05


def test_blanking_excises_the_burst_and_passes_the_rest_of_the_frame():
    frames, _ = scene(4, Interferer(QpskEmitter(), -30.0, 0.1, start=0.5), 3)
    cleaned = create("blanking", W).process(frames)
    burst, quiet = slice(3800, 4450), slice(200, 3000)
    assert np.mean(np.abs(cleaned[:, burst]) ** 2) < 0.02 * np.mean(np.abs(frames[:, burst]) ** 2)
    assert np.mean(np.abs(cleaned - frames)[:, quiet] ** 2) < 0.1  # of a return of power 1


# -- the time-frequency plane, before and after dechirping -------------------------------------------------------------
@pytest.mark.parametrize("name, options", [("stft_cfar", {}), ("stft_cfar", {"fill": "burg"}), ("imat", {})])
def test_excision_after_dechirping_removes_a_crossing_and_a_burst_and_nothing_else(name, options):
    """A tone crosses the beat band in 20 us; a burst is short in every bin. Without either, noise alone is cut."""
    method = create(name, W, **options)
    for interferer in (Interferer(ToneEmitter(3), -45.0), Interferer(QpskEmitter(), -35.0, 0.1)):
        frames, altitudes = scene(60, interferer, 31)
        assert correct(method.process(frames), altitudes).mean() >= 0.95
        assert correct(frames, altitudes).mean() < 0.5
    frames, altitudes = scene(60, None, 32)
    assert correct(method.process(frames), altitudes).all()


def test_a_gap_is_refilled_with_the_return_of_the_rest_of_the_sweep():
    """Another chirp, 20 dB above the return, is cut out of a third of a half sweep: zeros would leave no return."""
    altitude_m = np.linspace(50.0, 1400.0, 30)
    frames = (clean := point_return(W, altitude_m)).copy()
    frames[:, 1200:2300] += 10.0 * point_return(W, altitude_m[::-1])[:, 1200:2300]
    for name, options, least in (("imat", {}, 0.45), ("stft_cfar", {"fill": "burg"}, 0.8)):
        cleaned = create(name, W, **options).process(frames)
        assert np.mean((cleaned * clean.conj()).real[:, 1250:2250]) > least


@pytest.mark.parametrize(
    ("name", "interferer"),
    [
        # uneven over time and frequency behind whitening, which the weights use, without training
        ("time_frequency", Interferer(NrEmitter(channel_bandwidth_hz=5e6, evm="typical"), -45.0)),
        # a pole each, which the smoothed spectrum does not resolve
        ("linear_prediction", Interferer(ToneEmitter(20), -72.0)),
    ],
)
def test_weights_and_zero_phase_prediction_declare_where_whitening_does_not(name, interferer):
    assert pd("whitening", interferer, 100) < 0.85 < 0.9 <= pd(name, interferer, 100)


# -- linear prediction ------------------------------------------------------------------------------------------------
def forced(name: str, interferer: Interferer, count: int = 100, seed: int = 21) -> float:
    """Share within 5 m of the forced decision of an altimeter that knows the speed."""
    frames, altitudes = scene(count, interferer, seed)
    found = STILL.process(create(name, W).process(frames))["forced_altitude_m"]
    return float(np.mean(np.abs(found - altitudes) < 5.0))


STILL = Altimeter(W, AltimeterSettings(max_vertical_speed_m_per_s=0.0))


@pytest.mark.parametrize(
    ("name", "emitter", "sir_db"),
    [
        ("nlms_predictor", ToneEmitter(1), -57.0),
        ("linear_prediction", ToneEmitter(1), -66.0),
        ("linear_prediction", ToneEmitter(5), -66.0),
        ("linear_prediction", QpskEmitter(pulse="rrc"), -67.0),
    ],
)
def test_prediction_holds_where_the_prototypes_broke(name, emitter, sir_db):
    assert forced(name, Interferer(emitter, sir_db)) >= 0.9


def test_zero_phase_leaves_the_altitude_and_a_predictor_of_minimum_phase_does_not():
    """A band that is taken out of the middle of the sweep delays the rest: 26 m, one and a half samples."""
    frames, altitudes = scene(60, Interferer(QpskEmitter(pulse="rrc"), -30.0), 22)
    cleaned = (create(name, W).process(frames) for name in ("linear_prediction", "nlms_predictor"))
    zero, least = (np.median(STILL.process(x)["forced_altitude_m"] - altitudes) for x in cleaned)
    assert abs(zero) < 0.5 and 20 < least < 30


def test_nlms_predictor_is_the_textbook_recursion():
    """Sample by sample in float64, weights of 8 samples at a time."""
    frames, _ = scene(1, Interferer(ToneEmitter(2), -20.0), 23)
    x = frames[0][:600].astype(complex)
    method = create("nlms_predictor", W)
    peak = np.abs(frames.view(np.float32)).max()
    padded = np.concatenate([np.zeros(32), x / peak])
    floor = 1e-6 * 32 * np.mean(np.abs(np.concatenate([np.zeros(32), frames[0] / peak])) ** 2)
    weights, expected = np.zeros(32, complex), []
    for first in range(0, 600, 8):
        step = np.zeros(32, complex)
        for n in range(first, first + 8):
            past = padded[n : n + 32]
            expected.append(padded[n + 32] - past @ weights)
            step += 0.1 * past.conj() * expected[-1] / max(np.vdot(past, past).real, floor)
        weights = weights + step
    np.testing.assert_allclose(method.process(frames)[0][:600] / peak, expected, atol=1e-4)


def test_linear_prediction_divides_by_the_spectrum_of_its_model():
    """An autoregressive process of two poles: what is left is white."""
    rng = np.random.default_rng(24)
    poles = 0.9 * np.exp(2j * np.pi * np.array([0.1, -0.3]))
    coefficients = np.poly(poles)
    noise = rng.standard_normal((20, 15000)).view(complex)
    frames = np.zeros_like(noise)
    for n in range(7500):
        frames[:, n] = noise[:, n] - frames[:, max(n - 2, 0) : n][:, ::-1] @ coefficients[1 : 1 + min(n, 2)]
    frames = frames.astype(np.complex64)
    cleaned = create("linear_prediction", W).process(frames)
    gain = np.divide(*(np.mean(np.abs(np.fft.fft(x)) ** 2, axis=0) for x in (cleaned, frames)))
    wanted = np.abs(np.fft.fft(coefficients, 7500)) ** 2
    smooth = [np.convolve(np.log(v), np.ones(75) / 75, "same")[100:-100] for v in (gain, wanted)]
    assert np.ptp(smooth[0] - smooth[1]) < 0.6  # both over 20 dB


# -- block LMS: stability as theory has it ----------------------------------------------------------------------------
def lms_reference(received, desired, length: int, block: int, mu: float, normalised=False) -> np.ndarray:
    """Textbook block LMS in float64: y = w^T x, w += mu sum_n conj(x_n) e_n, weights of one frame from zero.
    Normalised, mu is divided by sum_n |x_n|^2."""
    padded = np.concatenate([np.zeros(length - 1), received]).astype(complex)
    weights = np.zeros(length, complex)
    out = np.zeros(received.size, complex)
    for first in range(0, received.size, block):
        rows = range(first, min(first + block, received.size))
        x = np.array([padded[n : n + length] for n in rows])
        out[first : first + len(rows)] = x @ weights
        error = desired[first : first + len(rows)] - x @ weights
        weights = weights + mu / (np.vdot(x, x).real if normalised else 1.0) * x.conj().T @ error
    return out


@pytest.mark.parametrize("name", ["lms", "lms_reference_input"])
def test_block_lms_is_the_textbook_recursion(name):
    frames, _ = scene(1, Interferer(QpskEmitter(), 0.0), 5)
    method = create(name, W)
    cleaned = method.process(frames)[0]
    pair = (frames[0], W.reference) if name == "lms" else (W.reference, frames[0])
    np.testing.assert_allclose(cleaned, lms_reference(*pair, method.length, 100, 1e-4), atol=1e-4)
    assert method.diverged_frames == 0


def test_nlms_divides_the_step_by_the_power_in_its_taps():
    """With the received frame as input, whose power a burst changes 30 times within the frame."""
    frames, _ = scene(1, Interferer(QpskEmitter(), -10.0, 0.3), 5)
    cleaned = create("nlms", W, wiring="reference_desired").process(frames)[0]
    expected = lms_reference(frames[0], W.reference, 96, 25, 0.8, normalised=True)
    np.testing.assert_allclose(cleaned, expected, atol=1e-3)


@pytest.mark.parametrize("power", [1.0, 4.0, 8.0, 20.0, 100.0])
def test_block_lms_diverges_where_theory_says(power):
    """Explicit Euler: stable for mu * lambda_max(X^H X) < 2, where lambda_max is at most L * block * P, which a tone
    reaches: at P = 6.25 with the paper's L = 32, block = 100, mu = 1e-4. Beyond it the method says that it diverges."""
    tone = np.sqrt(power) * np.exp(2j * np.pi * 0.11 * np.arange(7500))
    method = create("lms", W)
    out = method.process(np.tile(tone.astype(np.complex64), (3, 1)))
    stable = 1e-4 * 32 * 100 * power < 2
    assert method.status()["diverged_frames"] == method.diverged_frames == (0 if stable else 3)
    assert np.isfinite(out.view(np.float32)).all()


@pytest.mark.parametrize(("sir_db", "diverged"), [(-10.0, 0), (-26.0, 20)])
def test_block_lms_diverges_on_qpsk_where_its_spectral_density_says(sir_db, diverged):
    """lambda_max is block times the peak of the spectrum, P F_s / R_symbol for rectangular QPSK: mu 100 P 3.75 < 2.
    That is P = 53, a SIR of -17.3 dB; the bound L block P of one direction would be reached at -8 dB."""
    limit_db = -10 * np.log10(2 / (1e-4 * 100 * 7.5e6 / QpskEmitter().symbol_rate_hz))
    assert -26 < limit_db < -10
    frames, _ = scene(20, Interferer(QpskEmitter(), sir_db), 6)
    method = create("lms", W)
    method.process(frames)
    assert method.diverged_frames == diverged


@pytest.mark.parametrize("name", ["lms_reference_input", "nlms"])
@pytest.mark.parametrize("sir_db", [-15.0, -40.0])
def test_lms_with_the_reference_as_input_and_nlms_never_diverge(name, sir_db):
    """The reference's power is one, whatever is received; NLMS divides by the power."""
    frames, _ = scene(10, Interferer(QpskEmitter(), sir_db), 7)
    method = create(name, W)
    out = method.process(frames)
    assert method.diverged_frames == 0 and np.isfinite(out.view(np.float32)).all()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", CLASSICAL)
@pytest.mark.parametrize("scale", [0.0, 1e-30, 1e12, 1e30])
def test_no_level_of_input_overflows_or_warns(name, scale):
    frames, _ = scene(3, Interferer(QpskEmitter(), -10.0), 8)
    out = create(name, W).process(frames * np.float32(scale))
    assert np.isfinite(out.view(np.float32)).all()


@pytest.mark.parametrize("name", ["lms_reference_input", "nlms"])
def test_returns_beyond_the_span_are_not_declared_at_their_images(name):
    """Block updates put lines 750 m next to the return: at 1530 m it was declared at 31 m, at 1600 m at 850 m."""
    altitudes = np.array([1480.0, 1530.0, 1600.0, 1760.0, 1900.0, 2500.0])
    result = ALTIMETER.process(create(name, W).process(point_return(W, altitudes)))
    np.testing.assert_array_equal(result["valid"], altitudes < 1500)
    assert abs(result["altitude_m"][0] - 1480) < 5


# -- the shift check of networks -----------------------------------------------------------------------------------
class FakeNetwork:
    """In the place of a session: what ``rule`` makes of (n, 2, N) planes."""

    rule = staticmethod(lambda planes: planes)
    normalisation = "joint_rms"

    def __init__(self, model, threads, provider):
        says = {"layout": "iq_channels_first", "normalisation": self.normalisation, "rate_hz": "7.5e6"}
        says |= {"frame_samples": str(W.samples_per_frame), "centered": "1"}
        self.metadata = {f"radalt_{key}": value for key, value in says.items()}
        self.providers = []

    def run(self, planes):
        return np.array(self.rule(planes), dtype=np.float32)


@pytest.fixture
def fake(monkeypatch, tmp_path):
    """A `Tcae` around a rule."""

    def build(rule, **options):
        monkeypatch.setattr("radalt.core.mitigation.tcae.OnnxNetwork", FakeNetwork)
        monkeypatch.setattr("radalt.core.mitigation.tcae.try_out", lambda *arguments: None)
        monkeypatch.setattr(FakeNetwork, "rule", staticmethod(rule))
        (tmp_path / "own.onnx").write_bytes(b"fake")
        return create("tcae", W, model=tmp_path / "own.onnx", **options)

    return build


def false_return(altitude_m):
    sweep = W.beat_shifted(altitude_m)
    return lambda planes: np.tile(np.stack([sweep.real, sweep.imag]), (len(planes), 1, 1))


def pulls_by_two_cells(planes):
    """Every return comes out 40 m higher than it went in: it moves with the frame."""
    turn = W.beat_shifted(40.0) * W.reference.conj()
    out = (planes[:, 0] + 1j * planes[:, 1]) * turn
    return np.stack([out.real, out.imag], axis=1)


@pytest.mark.parametrize(
    ("normalisation", "level"),
    [
        ("joint_rms", lambda rails: np.sqrt(2.0 * np.mean(rails**2))),
        ("joint_peak", lambda rails: np.abs(rails).max()),
        ("per_channel_peak", lambda rails: np.abs(rails).max(axis=1)),
        ("none", lambda rails: rails[0, 1234] / 7.0),
    ],
)
def test_a_network_sees_the_level_that_its_file_states(fake, monkeypatch, normalisation, level):
    seen = []
    monkeypatch.setattr(FakeNetwork, "normalisation", normalisation)
    method = fake(lambda planes: seen.append(planes[0].copy()) or planes, shift_check=False, dither_db=None)
    frame = scene(1, None, 6)[0]
    frame[0, 1234] = 7.0 - 3.0j
    np.testing.assert_allclose(method.process(frame), frame, atol=1e-5)
    np.testing.assert_allclose(level(seen[-1]), 1.0, rtol=1e-5)


@pytest.mark.parametrize("scale", [1e-30, 1e-12, 1.0, 1e18, 1e30])
def test_a_network_that_changes_nothing_gives_the_frame_back_at_any_level(fake, scale):
    """Squares of float32 leave its range below 1e-19 and above 1e19; the frame itself does not."""
    frames = (scale * scene(2, None, 5)[0]).astype(np.complex64)
    out = fake(lambda planes: planes, shift_check=False, dither_db=None).process(frames)
    assert np.abs(out - frames).max() < 1e-5 * np.abs(frames).max()


@pytest.mark.parametrize("interferer", [None, Interferer(QpskEmitter(), -10.0)])
def test_shift_check_lets_returns_pass_at_any_altitude(fake, interferer):
    frames, altitudes = scene(40, interferer, 12)
    method = fake(lambda planes: planes)
    assert correct(method.process(frames), altitudes).mean() >= 0.95
    assert method.unconfirmed_frames <= 1 and method.status()["shift_check"] is True


@pytest.mark.parametrize("interferer", [None, Interferer(QpskEmitter(), -20.0)])
@pytest.mark.parametrize("altitude_m", [20.0, 700.0, 1480.0])
def test_shift_check_silences_a_network_that_invents(fake, interferer, altitude_m):
    frames, altitudes = scene(20, interferer, 13)
    frames = frames[np.abs(altitudes - altitude_m) > 30.0]
    method = fake(false_return(altitude_m))
    result = ALTIMETER.process(method.process(frames))
    assert (result["reason"] == Reason.NO_SIGNAL).all()
    assert method.unconfirmed_frames == method.status()["unconfirmed_frames"] == len(frames)
    trusting = fake(false_return(altitude_m), shift_check=False)
    assert ALTIMETER.process(trusting.process(frames))["valid"].all()
    assert trusting.status()["shift_check"] is False


def test_shift_check_silences_a_constant_error_where_the_frame_itself_shows_better(fake):
    """It moves with the frame, but without interference the altitude before the network is there to compare with."""
    frames, _ = scene(10, None, 14)
    method = fake(pulls_by_two_cells)
    assert not ALTIMETER.process(method.process(frames))["valid"].any()


def lifts_peaks(planes):
    """What is strong in the beat spectrum of either half comes out stronger: peaks of the noise, too."""
    sweep = W.reference.reshape(2, -1)
    beats = np.fft.fft((planes[:, 0] + 1j * planes[:, 1]).reshape(-1, *sweep.shape) * sweep.conj())
    out = (np.fft.ifft(beats * np.abs(beats) ** 0.5) * sweep).reshape(len(planes), -1)
    return np.stack([out.real, out.imag], axis=1)


def _found(results: np.ndarray) -> int:
    """Altitudes that are declared, or only not because another one is as likely."""
    return int(np.isin(results["reason"], (Reason.OK, Reason.AMBIGUOUS)).sum())


def test_shift_check_silences_peaks_of_the_noise_that_a_network_lifts(fake):
    """They move with the frame, as a return does, but the received frame does not show them."""
    frames, _ = scene(100, Interferer(QpskEmitter(), -15.0, 0.3), 16)
    frames -= point_return(W, scene(100, None, 16)[1])  # noise and interference are left
    fast = Altimeter(W, AltimeterSettings(max_vertical_speed_m_per_s=150.0))
    made = {c: _found(fast.process(fake(lifts_peaks, shift_check=c).process(frames))) for c in (True, False)}
    assert made[False] >= 15 > 5 >= made[True]


def test_only_the_shipped_default_is_trusted_unchecked(root, tmp_path):
    default = root / "models" / "tcae.onnx"
    copy = tmp_path / "tcae.onnx"
    copy.write_bytes(default.read_bytes())
    other = root / "models" / "cnn.onnx"
    checked = [create("tcae", W, **options).status()["shift_check"] for options in (
        {}, {"model": default}, {"model": copy}, {"model": other}, {"shift_check": True},
        {"model": other, "shift_check": False},
    )]  # fmt: skip
    assert checked == [False, False, False, True, True, False]


def smears(planes):
    """A return that fades from 1 to 0 and back 300 times a frame: lines far next to its own, together as strong."""
    return planes * (1.0 + np.cos(2 * np.pi * 300 * np.arange(planes.shape[-1]) / planes.shape[-1]))


def test_only_white_frames_that_the_network_loses_pass_as_they_came(fake):
    """Noise 25 dB above the return: a network that leaves no return is no help; QPSK is its business all the same."""
    rng = np.random.default_rng(18)
    clean, _ = scene(4, None, 18)
    arrived = {
        "white": (clean + 25.0 * white(rng, 4)).astype(np.complex64),
        "qpsk": scene(4, Interferer(QpskEmitter(), -25.0), 18)[0],
        "clean": clean,
    }
    made = {}
    for name, frames in arrived.items():
        method = fake(smears, shift_check=False, dither_db=None, skip_lost=True)
        out = method.process(frames)
        made[name] = (np.array_equal(out, frames), method.skipped_frames)
    assert made == {"white": (True, 4), "qpsk": (False, 0), "clean": (False, 0)}
    assert fake(smears, skip_lost=True).process(arrived["white"]).any()  # not silenced by the shift check
    kept = fake(smears, shift_check=False, dither_db=None)
    assert not np.array_equal(kept.process(arrived["white"]), arrived["white"])


def test_the_shipped_network_reads_a_return_in_noise_as_the_altimeter_alone():
    """No method takes white noise away; the network alone has 223 of 300 at -25 dB where the altimeter has 280."""
    rng, snr_db = np.random.default_rng(19), -25.0
    altitudes = rng.uniform(20.0, 1400.0, 150)
    frames = (point_return(W, altitudes) + 10.0 ** (-snr_db / 20.0) * white(rng, 150)).astype(np.complex64)
    alone = correct(frames, altitudes).sum()
    assert correct(create("tcae", W).process(frames), altitudes).sum() >= alone - 10
    assert correct(create("tcae", W, skip_lost=False).process(frames), altitudes).sum() < alone - 10


def test_a_gpu_that_is_not_there_is_one_line_and_the_processor(caplog):
    frames, _ = scene(2, None, 16)
    method = create("tcae", W, provider="cuda")
    # what is tested is its absence; the pinned onnxruntime has no GPU, a user's own may have
    if "CUDAExecutionProvider" in method.status()["providers"]:
        pytest.skip("this onnxruntime has the GPU")
    said = "tcae: no CUDAExecutionProvider in this onnxruntime; the network runs on the processor"
    assert caplog.messages == [said]
    np.testing.assert_array_equal(method.process(frames), create("tcae", W).process(frames))
    with pytest.raises(MitigationError, match="tcae.provider is 'tpu'; one of cpu, cuda"):
        create("tcae", W, provider="tpu")


# -- the common contract ----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", METHODS)
def test_a_frame_that_is_not_finite_does_not_touch_the_next(name):
    """That frame is invalid with its reason; the others are what they are without it."""
    frames, altitudes = scene(5, None, 9)
    spoilt = frames.copy()
    spoilt[2, 4321] = np.nan
    result = ALTIMETER.process(create(name, W).process(spoilt))
    assert Reason.NAMES[result["reason"][2]] == "not_finite"
    assert not result["valid"][2] and np.isnan(result["altitude_m"][2])
    others = [0, 1, 3, 4]
    without = ALTIMETER.process(create(name, W).process(frames[others]))
    np.testing.assert_array_equal(result["altitude_m"][others], without["altitude_m"])
    # the others pull the altitude towards their reference or training
    if name in ("none", "whitening", "blanking", "linear_prediction"):
        assert (np.abs(result["altitude_m"][others] - altitudes[others]) < 5).all()


@pytest.mark.parametrize("name", METHODS)
def test_a_batch_may_be_split_or_empty_its_input_is_left_alone_and_reset_forgets_it(name):
    frames, _ = scene(6, Interferer(QpskEmitter(), -3.0, 0.5), 10)
    before = frames.copy()
    whole, split = create(name, W), create(name, W)
    expected = whole.process(frames)
    parts = split.process(frames[:1]), split.process(frames[1:4]), split.process(frames[4])[None]
    got = np.concatenate([*parts, split.process(frames[5:])])
    assert expected.shape == frames.shape and expected.dtype == np.complex64
    if METHODS[name].runs_network:  # the runtime picks its kernels by batch
        np.testing.assert_allclose(got, expected, atol=1e-4)
    else:
        np.testing.assert_array_equal(got, expected)
    np.testing.assert_array_equal(frames, before)
    assert whole.process(frames[:0]).shape == (0, W.samples_per_frame)
    assert whole.frames == split.frames == 6
    whole.reset()
    assert (whole.frames, whole.diverged_frames) == (0, 0)
    np.testing.assert_array_equal(whole.process(frames), expected)


@pytest.mark.parametrize("name", CLASSICAL)
def test_a_block_gets_what_process_gives_whatever_a_frame_holds(name):
    plain, into = create(name, W), create(name, W)
    frames, _ = scene(5, Interferer(QpskEmitter(), -3.0), 12)
    for bad in (np.nan, np.inf, -np.inf, 1e30, 0.0):
        frames[2, 77:] = bad
        out = np.empty_like(frames)
        with np.errstate(all="ignore"):
            into.process_into(frames, out)
            np.testing.assert_array_equal(out, plain.process(frames))
    assert into.frames == plain.frames == 25


@pytest.mark.parametrize("name", METHODS)
def test_frames_drawn_anew_are_cleaned_without_memory(name):
    """What a method gives for a frame is then what it gives without the frames before."""
    emitter = NrEmitter(channel_bandwidth_hz=10e6, modulation="qpsk")
    frames = np.concatenate([scene(1, Interferer(emitter, -30.0), seed)[0] for seed in (1, 2)])
    independent, alone = create(name, W, independent=True), create(name, W)
    out = independent.process(frames)
    for frame, cleaned in zip(frames, out, strict=True):
        alone.reset()
        np.testing.assert_allclose(cleaned, alone.process(frame), atol=1e-4)
    assert independent.frames == 2


@pytest.mark.parametrize("name", CLASSICAL)
def test_methods_work_for_other_sweeps(name):
    w = Waveform(bandwidth_hz=4e6, rate_hz=5.1e6, sweep_s=0.8e-3, centered=False)
    out = create(name, w).process(point_return(w, np.array([100.0, 700.0])))
    assert out.shape == (2, 4080) and np.isfinite(out.view(np.float32)).all()


# -- what methods share -----------------------------------------------------------------------------------------------
def test_linear_prediction_leaves_the_envelope_of_a_sweep_alone():
    """Its frequencies come one after the other: a taper over the frame would shape its spectrum, and so the sweep."""
    rng = np.random.default_rng(21)
    frames = point_return(W, np.array([300.0])) + 0.01 * rng.standard_normal((1, 15000)).view(complex)
    envelope = np.abs(create("linear_prediction", W).process(frames.astype(np.complex64))[0])
    assert np.ptp(envelope[500:6500].reshape(-1, 100).mean(axis=1)) < 0.5 * np.median(envelope)


@pytest.mark.parametrize("method", ["whitening", "linear_prediction"])
def test_nothing_comes_through_at_the_seam(method):
    rng = np.random.default_rng(22)
    tone = 100.0 * np.exp(2j * np.pi * 0.1234567 * np.arange(7500)) + rng.standard_normal(15000).view(complex)
    cleaned = create(method, W).process(tone[None].astype(np.complex64))[0]
    assert np.abs(cleaned).max() < 5.0 * np.std(cleaned) and np.count_nonzero(cleaned) > 0.985 * cleaned.size
