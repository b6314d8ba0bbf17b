"""The altimeter next to a textbook one that shares no code with it."""

import numpy as np
import pytest
from frames import W, white
from scipy.stats import binomtest

from radalt import Altimeter, AltimeterSettings, load_scene
from radalt.bench.textbook import THRESHOLD, textbook_altitudes
from radalt.core.altimeter.altimeter import Reason
from radalt.core.interference.placement import interference_frames
from radalt.core.mitigation import create
from radalt.core.returns.point import point_return
from radalt.evaluation.results.proportion import clopper_pearson

FRAMES = 160


def frames_of(scene_name: str, sir_db: float, snr_db: float = 10.0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng([41, *scene_name.encode()])
    altitudes, speeds = rng.uniform(3, 1500, FRAMES), rng.uniform(-10, 10, FRAMES)
    frames = point_return(W, altitudes, vertical_speed_m_per_s=speeds, dtype=np.complex128)
    if scene_name != "none":
        scene = load_scene(scene_name).at(overlap=1.0, sir_db=sir_db)
        total = {"total_sir_db": scene.total_sir_db}
        frames += interference_frames(scene.interference, FRAMES, 7500, 7.5e6, rng, **total)
    frames += 10 ** (-snr_db / 20) * white(rng, FRAMES)
    return frames.astype(np.complex64), altitudes


def textbook(frames: np.ndarray, speed: float) -> tuple[np.ndarray, np.ndarray]:
    sweep = {"bandwidth_hz": 7.5e6, "rate_hz": 7.5e6, "carrier_hz": 4.3e9}
    return textbook_altitudes(frames, **sweep, speed_m_per_s=speed, max_altitude_m=1500.0)


@pytest.mark.parametrize(
    ("method", "scene", "sir_db"),
    [
        ("none", "paper_qpsk", -28.0),
        ("none", "tones", -26.0),
        ("whitening", "mixture", -38.0),
        ("whitening", "nr5", -36.0),
    ],
)
def test_forced_decisions_are_not_behind_the_textbook(method, scene, sir_db):
    """Paired on the same frames: what it finds and we do not is within 2.5 standard deviations of chance."""
    frames, altitudes = frames_of(scene, sir_db)
    cleaned = create(method, W).process(frames)
    for speed in (0.0, 20.0, 150.0):
        altimeter = Altimeter(W, AltimeterSettings(max_vertical_speed_m_per_s=speed))
        error = np.abs(altimeter.process(cleaned)["forced_altitude_m"] - altitudes)
        reference = np.abs(textbook(cleaned, speed)[0] - altitudes)
        ours, theirs = error < 5.0, reference < 5.0
        only_theirs, only_ours = np.sum(theirs & ~ours), np.sum(ours & ~theirs)
        assert only_theirs - only_ours <= 2.5 * np.sqrt(only_theirs + only_ours + 1.0)
        both = ours & theirs
        excess = error[both] ** 2 - reference[both] ** 2
        assert excess.mean() <= 2.5 * excess.std() / np.sqrt(both.sum())


@pytest.mark.parametrize(
    ("method", "scene", "sir_db"), [("none", "qpsk_shaped", -28.0), ("whitening", "mixture", -35.0)]
)
def test_what_a_textbook_cfar_declares_ours_declares(method, scene, sir_db):
    """Paired, at one bound of false alarms; a return that whitening leaves in pieces colours the band by itself."""
    frames, altitudes = frames_of(scene, sir_db)
    cleaned = create(method, W).process(frames)
    for speed, threshold in THRESHOLD.items():
        result = Altimeter(W, AltimeterSettings(max_vertical_speed_m_per_s=speed)).process(cleaned)
        reference, ratio = textbook(cleaned, speed)
        # held against one threshold each; the test of likelihood comes after it
        found = result["valid"] | (result["reason"] == Reason.AMBIGUOUS)
        ours = found & (np.abs(result["forced_altitude_m"] - altitudes) < 5.0)
        theirs = (ratio > threshold) & (np.abs(reference - altitudes) < 5.0)
        only_ours, only_theirs = int(np.sum(ours & ~theirs)), int(np.sum(theirs & ~ours))
        both = only_ours + only_theirs
        # McNemar's exact test
        assert only_ours >= only_theirs or binomtest(only_theirs, both).pvalue > 0.02


def test_the_textbooks_threshold_is_our_bound_in_white_noise():
    rng = np.random.default_rng(23)
    noise = white(rng, 600).astype(np.complex64)
    ratio = np.concatenate([textbook(some, 0.0)[1] for some in np.split(noise, 40)])
    still = Altimeter(W, AltimeterSettings(max_vertical_speed_m_per_s=0.0))
    low, high = clopper_pearson(int(np.sum(ratio > THRESHOLD[0.0])), 600)
    assert low <= still.false_alarms_per_frame <= high


def test_without_noise_the_textbook_measures_every_altitude():
    altitudes = np.linspace(20.0, 1450.0, 40)
    frames = point_return(W, altitudes)
    assert np.abs(textbook(frames, 0.0)[0] - altitudes).max() < 0.5


@pytest.mark.parametrize("method", ["whitening", "nlms", "tcae"])
def test_false_altitudes_in_noise_alone_stay_within_the_bound(method):
    """False altitudes of a method: the lower end of the interval lies within the design's bound."""
    noise = white(np.random.default_rng(29), 600).astype(np.complex64)
    cleaned = create(method, W).process(noise)
    for speed in THRESHOLD:
        altimeter = Altimeter(W, AltimeterSettings(max_vertical_speed_m_per_s=speed))
        false = sum(int(altimeter.process(some)["valid"].sum()) for some in np.split(cleaned, 12))
        assert clopper_pearson(false, 600)[0] <= altimeter.false_alarms_per_frame < 0.02
