"""The tracker: what it gains by integration, what it says of its own error, and when it says nothing."""

from dataclasses import replace

import numpy as np
import pytest

from radalt.core.interference.emitters.nr import NrEmitter
from radalt.core.interference.placement import Interferer
from radalt.core.interference.stream import JammerStream
from radalt.core.receiver.altimeter import Altimeter, AltimeterSettings
from radalt.core.receiver.integrator import Integrator
from radalt.core.receiver.summed_block import Entry, Measurement
from radalt.core.receiver.track import Evidence, Kalman, Track
from radalt.core.receiver.track_integrity import Integrity, _exceeds
from radalt.core.receiver.tracker import AltitudeTracker, State, Status, TrackerSettings
from radalt.core.returns.point import point_return
from radalt.core.returns.terrain import AircraftState, FlatTerrain, TerrainReturn, reflectivity
from radalt.core.waveform import Waveform
from radalt.evaluation.results.proportion import clopper_pearson

W = Waveform()
N = W.samples_per_frame
ALTIMETER = Altimeter(W, AltimeterSettings(max_altitude_m=1000.0, max_vertical_speed_m_per_s=20.0))
FAST = Altimeter(W, AltimeterSettings(max_altitude_m=1000.0, max_vertical_speed_m_per_s=150.0))
T = 0.001  # s, a frame


def noise(rng, frames: int, snr_db: float) -> np.ndarray:
    """Complex white noise under a return of unit amplitude."""
    rails = rng.standard_normal((frames, N, 2), dtype=np.float32)
    return rails.view(np.complex64)[..., 0] * np.float32(10.0 ** (-snr_db / 20.0) / np.sqrt(2.0))


def flight(rng, altitude_m, snr_db: float, speed: float = 0.0) -> np.ndarray:
    """A point return at these altitudes, one a frame, of random phase."""
    altitude_m = np.asarray(altitude_m, dtype=float)
    phase = rng.random(altitude_m.size)
    return point_return(W, altitude_m, vertical_speed_m_per_s=speed, phase_cycles=phase) + noise(
        rng, altitude_m.size, snr_db
    )


def tracked(
    frames: np.ndarray, altimeter: Altimeter = ALTIMETER, settings=None, index=None, chunk: int = 200
):
    """Outputs of one run."""
    tracker = AltitudeTracker(altimeter, settings or TrackerSettings())
    index = np.arange(len(frames)) if index is None else index
    parts = [
        tracker.process(altimeter.spectra(frames[k : k + chunk]), frame_index=index[k : k + chunk])
        for k in range(0, len(frames), chunk)
    ]
    return np.concatenate(parts)


def block_of(
    rng,
    frames: int,
    snr_db: float,
    *,
    speed: float = 0.0,
    allowed: float | None = None,
    altitude: float = 500.0,
):
    """One block with a return at its middle, and what it was made by."""
    altimeter = FAST if speed else ALTIMETER
    allowed = altimeter.settings.max_vertical_speed_m_per_s if allowed is None else allowed
    tables = Integrator(altimeter, frames, doppler=allowed > 0, max_speed_m_per_s=allowed)
    at = np.arange(frames, dtype=float)
    path = altitude + speed * (at - at.mean()) * T
    ratio = tables.normalise(altimeter.spectra(flight(rng, path, snr_db, speed)))
    return tables.integrate(ratio, at)


def test_strength_grows_as_the_square_root_of_the_frames():
    """Deflection of a sum of M looks; log(1 + x) costs 0.3 dB of the plain sum's sqrt(2 M) rho."""
    snr_db, rng = -37.0, np.random.default_rng(1)
    rho = 10.0 ** (snr_db / 10.0) * N / 2  # power over noise in one half sweep's cell
    for frames, runs in ((40, 24), (160, 8)):
        near = [
            block_of(rng, frames, snr_db).strongest(None).strength for _ in range(runs)
        ]  # the strongest of noise adds a little
        expected = 0.96 * rho * np.sqrt(2 * frames)
        assert 0.75 * expected < np.mean(near) < 1.25 * expected + 1.0


def test_frames_moved_by_their_speed_lose_nothing_of_a_fast_return():
    """150 m/s over 320 ms cross 48 m, more than two resolution cells: summed where they stand they lose 4 dB."""
    rng = np.random.default_rng(2)
    still = np.mean([block_of(rng, 320, -30.0).best().power for _ in range(2)])
    blocks = [block_of(rng, 320, -30.0, speed=150.0) for _ in range(2)]
    assert 10 * np.log10(np.mean([b.best().power for b in blocks]) / still) > -1.2
    unmoved = np.mean([b.tables.moved_sums(b._ratio, np.zeros((1, 320))).max() / 320 - 1 for b in blocks])
    assert 10 * np.log10(unmoved / still) < -3.0


def test_spectra_are_moved_by_fractions_of_a_cell_one_by_one_and_in_the_sum():
    """Reference: linear interpolation of each frame by itself; beyond the band there is nothing to move in."""
    tables = Integrator(FAST, 8, doppler=True, max_speed_m_per_s=150.0)  # the fewest frames there may be
    values = np.random.default_rng(27).exponential(size=(8, 2, 60)).astype(np.float32)
    shifts, cells = np.linspace(-3.3, 2.9, 8), np.arange(60)
    expected = np.stack(
        [
            [np.interp(cells + shift, cells, half) for half in frame]
            for shift, frame in zip(shifts, values, strict=True)
        ]
    )
    inner = slice(4, 56)
    np.testing.assert_allclose(tables.moved(values, shifts)[..., inner], expected[..., inner], atol=1e-5)
    total = tables.moved_sums(values, shifts[None])[0]
    np.testing.assert_allclose(total[..., inner], expected.sum(axis=0)[..., inner], atol=1e-4)


@pytest.mark.parametrize("doppler", [True, False])
def test_every_row_of_the_table_stands_for_its_own_speed(doppler):
    """By the cells that Doppler sets up and down beats apart, or by the speed that frames are moved by."""
    tables = Integrator(FAST, 40, doppler=doppler, max_speed_m_per_s=100.0)
    apart, moved = tables.rows[:, 1], tables.speeds[tables.rows[:, 0]]
    step = np.diff(tables.speeds).max()
    assert tables.speeds.max() + 0.5 * step == pytest.approx(100.0)  # half a step blurs a block by little
    if doppler:
        speed = W.beats_to_vertical_speed_m_per_s(apart * tables.cell_hz, 0.0)
        assert speed.max() >= 100.0 and np.abs(moved - speed).max() < 0.75 * step
    else:
        speed = moved
        assert set(apart) == {-1, 0, 1} and np.ptp(speed) == pytest.approx(2 * tables.speeds.max())
    np.testing.assert_allclose(tables.row_speed, speed, atol=1e-6)


def test_the_table_covers_the_span_and_half_a_resolution_cell_at_either_end():
    tables = Integrator(FAST, 40, doppler=True, max_speed_m_per_s=100.0)
    low, high = FAST.search_hz
    searched = tables.beat_hz[tables.first : tables.last]
    assert low <= searched[0] < low + tables.cell_hz and high - tables.cell_hz < searched[-1] <= high
    np.testing.assert_allclose(tables.altitude_span_m, [-9.99, 1009.99], atol=0.01)


def test_what_one_half_sweep_shows_alone_is_no_return():
    tables = Integrator(ALTIMETER, 40, doppler=True, max_speed_m_per_s=20.0)
    ratio = np.random.default_rng(29).exponential(size=(40, 2, tables.beat_hz.size)).astype(np.float32)
    ratio[:, 0, 150] = 30.0
    block = tables.integrate(ratio, np.arange(40.0))
    assert block.table.max() > 25.0 and block.strongest().strength < 12.0
    ratio[:, 1, 150] = 30.0
    assert tables.integrate(ratio, np.arange(40.0)).strongest().strength > 50.0


def test_differences_and_the_main_lobe_of_a_return():
    """Per frame the peak less the cell, its mean and that mean's variance; what is a cell off in one half is away."""
    tables = Integrator(ALTIMETER, 40, doppler=True, max_speed_m_per_s=20.0)
    ratio = np.random.default_rng(28).exponential(size=(40, 2, tables.beat_hz.size)).astype(np.float32)
    block, row = tables.integrate(ratio, np.arange(40.0)), int(np.abs(tables.row_speed).argmin())
    found = Measurement(500.0, 0.0, 0.1, 1.0, 40.0, np.array([120.0, 121.0]), 9.0, row)
    mean, variance = block.differences(found, 9)
    for half, cell in enumerate((120, 121)):
        apart = ratio[:, half, cell, None] - ratio[:, half, cell - 9 : cell + 10]
        np.testing.assert_allclose(mean[half], apart.mean(axis=0), atol=1e-5)
        np.testing.assert_allclose(variance[half], apart.var(axis=0, ddof=1) / 40, atol=1e-5)
    away = block.away_from(found)[row]
    one = round(tables.resolution_cells)
    assert not away[120 - tables.first - one + 1] and away[120 - tables.first - one - 2]


def test_measurement_knows_its_own_error():
    """Squared error over its claimed variance has a mean of one, in altitude and speed: 120 blocks, two strengths."""
    rng, altitude_ratio, speed_ratio = np.random.default_rng(3), [], []
    for snr_db in (-33.0, -20.0):
        for altitude in rng.uniform(100.0, 900.0, 60):
            found = block_of(rng, 40, snr_db, altitude=altitude).best()
            altitude_ratio.append((found.altitude_m - altitude) ** 2 / found.altitude_variance_m2)
            speed_ratio.append(found.speed_m_per_s**2 / found.speed_variance_m2_per_s2)
    assert 0.6 < np.mean(altitude_ratio) < 1.6
    assert 0.6 < np.mean(speed_ratio) < 1.6


def test_one_frame_of_forty_decides_nothing():
    """A frame with a clean false return among frames of noise: what a method may invent."""
    rng = np.random.default_rng(4)
    frames = noise(rng, 400, 0.0)
    frames[::40] = 30.0 * point_return(W, np.full(10, 500.0))
    assert not np.any(tracked(frames)["state"] == State.TRACK)


@pytest.mark.parametrize("rival_m", [700.0, 250.0, 480.0, 320.0])
def test_a_return_that_a_method_has_taken_away_is_a_rival_if_the_received_frames_show_it(rival_m):
    rng = np.random.default_rng(20)
    cleaned = flight(rng, np.full(400, 400.0), 0.0)
    received = cleaned + point_return(W, np.full(400, rival_m), phase_cycles=rng.random(400))
    spectra = ALTIMETER.spectra(cleaned)

    def status(beside):
        return AltitudeTracker(ALTIMETER).process(spectra, received=ALTIMETER.spectra(beside))["status"]

    assert np.any(status(cleaned) == Status.NORMAL)
    assert not np.any(status(received) == Status.NORMAL)
    assert np.all(status(np.full_like(cleaned, np.nan)) == Status.FAILURE)  # cleaned of what is no number
    # interference that hides everything says nothing against the altitude
    assert np.array_equal(status(cleaned + 1e3 * noise(rng, 400, 0.0)), status(cleaned))


def test_noise_alone_is_no_computed_data():
    outputs = tracked(noise(np.random.default_rng(5), 1200, 0.0))
    assert np.all(outputs["status"] == Status.NO_COMPUTED_DATA)
    assert np.all(np.isnan(outputs["altitude_m"]))


def test_protection_level_holds_at_its_stated_risk():
    """At a risk of 2 % a wrong bound shows: 18 runs of 15 outputs close to the limit of detection."""
    rng = np.random.default_rng(6)
    settings = TrackerSettings(risk=0.02)
    events = trials = 0
    widths = []
    for _ in range(18):
        speed = rng.uniform(-10.0, 10.0)
        path = rng.uniform(100.0, 900.0) + speed * np.arange(600) * T
        outputs = tracked(flight(rng, path, rng.uniform(-36.0, -25.0), speed), settings=settings)
        true = path[outputs["frame_index"]] + 0.5 * speed * T
        normal = outputs["status"] == Status.NORMAL
        beyond = np.abs(outputs["altitude_m"] - true) > outputs["protection_level_m"]
        events, trials = events + int(np.sum(normal & beyond)), trials + int(normal.sum())
        widths.extend(outputs["protection_level_m"][normal])
    assert trials > 150
    assert clopper_pearson(events, trials)[0] <= 0.02
    assert np.median(widths) < 5.0  # and it says something


@pytest.mark.parametrize(
    ("altitude_m", "land"),
    [
        (30.0, ("constant_gamma", "mountains")),
        (150.0, ("constant_gamma", "mountains")),
        (300.0, ("morchin", "urban_low_relief")),
    ],
)
def test_extended_ground_stays_within_its_protection_level_and_a_point_pays_nothing(altitude_m, land):
    """Ground off nadir pulls the peak up by several metres; only the return itself says whether there is any."""
    radar = TerrainReturn(FlatTerrain(0.0), W, ground=reflectivity(*land))
    rng, speed = np.random.default_rng(9), 70.0
    east = speed * T / 82_700.0  # degrees of longitude per frame at 42 degrees north
    over = [
        AircraftState(k * T, 42.0, -88.0 + east * k, altitude_m, (speed, 0.0, 0.0), 90.0) for k in range(160)
    ]
    ground = np.stack([radar(state, frame_index=k).frame for k, state in enumerate(over)])
    ground /= np.sqrt(np.mean(np.abs(ground) ** 2))
    out = tracked((ground + noise(rng, 160, 0.0)).astype(np.complex64))
    out = out[out["status"] == Status.NORMAL]
    error = out["altitude_m"] - altitude_m
    assert out.size
    assert np.all(np.abs(error) < out["protection_level_m"])
    assert altitude_m < 100.0 or np.all(error > 3.0)
    point = tracked(flight(rng, np.full(160, altitude_m), 0.0))[-1]
    assert point["protection_level_m"] < 2.6


@pytest.mark.parametrize("step_m", [50.0, -150.0, 300.0])
def test_a_step_of_the_ground_is_found_again_and_never_called_normal_meanwhile(step_m):
    path = np.where(np.arange(800) < 410, 500.0, 500.0 + step_m)
    outputs = tracked(flight(np.random.default_rng(7), path, -10.0))
    error = np.abs(outputs["altitude_m"] - path[outputs["frame_index"]])
    normal = outputs["status"] == Status.NORMAL
    assert error[normal].max() < 1.0
    assert normal[outputs["frame_index"] > 410 + 4 * 40].all()


def test_a_step_in_the_last_frames_of_a_block_is_noticed_by_the_next_output():
    path = np.where(np.arange(800) < 438, 500.0, 600.0)
    outputs = tracked(flight(np.random.default_rng(8), path, -10.0))
    wrong = (outputs["status"] == Status.NORMAL) & (
        np.abs(outputs["altitude_m"] - path[outputs["frame_index"]]) > 5.0
    )
    assert wrong.sum() <= 1 and outputs["status"][-1] == Status.NORMAL


def test_a_step_of_a_weak_return_is_contradicted_by_the_latest_frames():
    """Ten of forty frames show the new altitude: too few for a second return at -28 dB, but they are the latest."""
    path = np.where(np.arange(200) < 190, 500.0, 600.0)
    outputs = tracked(flight(np.random.default_rng(25), path, -28.0))
    assert outputs["status"][-2] == Status.NORMAL and outputs["status"][-1] == Status.NO_COMPUTED_DATA


def exponential(seed: int, frames: int = 40) -> np.ndarray:
    """Normalised spectra of noise for `FAST`."""
    rng = np.random.default_rng(seed)
    return rng.exponential(size=(frames, 2, FAST.beat_hz.size)).astype(np.float32)


def test_a_half_that_shows_the_return_in_few_frames_counts_and_one_that_shows_nothing_does_not():
    """Three frames of forty are few votes: behind a network they may be all that a half sweep has left."""
    tables = Integrator(FAST, 40, doppler=True, max_speed_m_per_s=20.0)
    ratio = exponential(36)
    ratio[:, 0, 150] = 12.0
    alone = tables.integrate(ratio, np.arange(40.0)).strongest().strength
    ratio[[5, 15, 25], 1, 150] = 60.0
    block = tables.integrate(ratio, np.arange(40.0))
    assert alone < 12.0 and block.strongest().strength == pytest.approx(block.table.max())


def started(tracker: AltitudeTracker, up: int, down: int, seed: int) -> Track:
    """A track of one block that shows a pair of cells."""
    tracker._at, tracker._before, tracker._shift_m, tracker._lead_s = np.arange(40), None, 0.0, 0.02
    block = showing(tracker, up, down, seed)
    return tracker._start(block, tracker._calibrated(block.best()), 19.5)


def showing(tracker: AltitudeTracker, up: int, down: int, seed: int, power: float = 12.0):
    """A block that shows a pair of cells, each with its neighbours."""
    ratio = exponential(seed)
    for half, cell in enumerate((up, down)):
        ratio[:, half, cell - 1 : cell + 2] += power * np.array([0.5, 1.0, 0.5], dtype=np.float32)
    return tracker.integrator.integrate(ratio, np.arange(40.0))


def test_a_pair_of_another_doppler_is_no_continuation_while_the_speed_is_unknown():
    """Up a cell higher and down a cell lower is the same altitude and 17 m/s more; four of each are another pair."""
    for apart, same in ((0, True), (1, True), (4, False)):
        tracker = AltitudeTracker(FAST)
        track = started(tracker, 150, 150, 37)
        found = tracker._continue(track, showing(tracker, 150 + apart, 150 - apart, 38), 59.5)
        assert (found is not None) is same


def test_a_track_whose_doppler_its_altitudes_contradict_twice_no_longer_holds_its_place():
    """A pair of lobes passes for 70 m/s, but its altitudes have been level for a second."""
    tracker = AltitudeTracker(FAST)
    track = started(tracker, 154, 146, 39)
    for k in range(25):
        level = replace(track.latest, altitude_variance_m2=0.01)
        track.take(level, 40.0 * k)
    for block, seen in ((40, True), (41, False)):
        assert tracker._continue(track, showing(tracker, 154, 146, block), 1039.5) is None
        assert track.seen is seen


@pytest.mark.parametrize("settled", [True, False])
def test_a_half_that_is_pulled_once_costs_a_certain_track_nothing(settled):
    """Its altitudes are level and nothing else is left that it could be: one foreign Doppler is interference's."""
    tracker = AltitudeTracker(FAST)
    track = started(tracker, 150, 150, 42)
    for k in range(25):
        assert tracker._continue(track, showing(tracker, 150, 150, 43 + k), 40.0 * k + 59.5) is not None
    speed, track.settled = track.filter.mean[1], settled
    pulled = showing(tracker, 151, 149, 70)  # 17 m/s at the same altitude
    assert tracker._integrity.alone(track)
    given = [tracker._continue(track, pulled, 1079.5 + 40.0 * k) is not None for k in range(3)]
    assert given == [settled, False, False]
    assert track.filter.mean[1] == pytest.approx(speed, abs=0.5)


def test_the_pair_that_has_shown_more_power_than_the_tracks_is_found_within_reach_span_and_speed():
    """Up four cells higher shows more power, down as well three lower; both together are a speed of seven cells."""
    evidence, everywhere = Evidence(2.0), (-20.0, 20.0)
    mean = np.full((2, 41), 5.0)
    mean[:, 20] = 0.0  # the track itself
    mean[0, 20 + 4], mean[1, 20 - 3], mean[0, 20 + 9] = -2.0, -1.0, -20.0
    evidence.add(mean, np.full((2, 41), 0.5))
    assert evidence.better_pair(8, (-9, 9), 1.0, everywhere) == (4, -3)
    assert evidence.better_pair(8, (-9, 4), 1.0, everywhere) == (4, 0)
    assert evidence.better_pair(9, (-9, 9), 1.0, everywhere) == (9, 0)
    assert evidence.better_pair(8, (-9, 4), 1.0, (-20.0, 1.0)) == (0, -3)
    assert evidence.better_pair(8, (-2, 2), 1.0, everywhere) is None
    assert evidence.better_pair(8, (-9, 9), 4.0, everywhere) is None  # within the main lobe
    evidence.recentre((4, -3))
    assert evidence.mean[0, 20] == evidence.mean[1, 20] == 0.0
    assert evidence.mean[0, 20 - 4] == 2.0 and evidence.mean[1, 20 + 3] == 1.0
    assert evidence.mean[0, 20 + 5] == -18.0 and evidence.variance[0, 20 + 5] == 1.0


def test_a_young_track_moves_from_a_lobe_to_the_pair_that_its_blocks_show_with_more_power():
    """It began with a lobe of the up half, six cells higher. Once certain, it stays whatever else has more power."""
    for settled in (False, True):
        tracker = AltitudeTracker(FAST)
        track = started(tracker, 156, 150, 37)
        lobe_m, track.settled = track.latest.altitude_m, settled
        ratio = np.random.default_rng(39).exponential(size=(40, 2, FAST.beat_hz.size)).astype(np.float32)
        ratio[:, :, 150], ratio[:, 0, 156] = 60.0, 20.0
        block = tracker.integrator.integrate(ratio, np.arange(40.0))
        found = tracker._continue(track, block, 59.5)
        rise = 0.0 if settled else -3.0 * tracker.integrator.cell_m
        assert found.altitude_m - lobe_m == pytest.approx(rise, abs=1.5)
        assert track.filter.mean[0] - lobe_m == pytest.approx(rise, abs=1.5)
        assert track.history[0][1] - lobe_m == pytest.approx(rise, abs=1.5)


@pytest.mark.parametrize(("altitudes", "moves"), [(2, True), (5, False)])
def test_a_young_track_does_not_move_to_a_pair_whose_doppler_its_altitudes_contradict(altitudes, moves):
    """Fifty metres per second, and five level altitudes. Two say nothing of a speed.

    Below 5 MHz NR at -60 dB such a pair was given as the altitude in two of 1,300 outputs at 20 to 80 m: its
    Doppler left no speed open that anything else could have, so nothing had to be ruled out.
    """
    tracker = AltitudeTracker(FAST)
    track = started(tracker, 150, 150, 37)
    found = replace(track.latest, altitude_variance_m2=9.0)
    track.history.clear()
    for k in range(altitudes):
        track.take(found, 40.0 * k)
    ratio = exponential(39)
    ratio[:, 0, 153] = ratio[:, 1, 147] = 60.0
    block = tracker.integrator.integrate(ratio, np.arange(40.0))
    track.evidence.add(*block.differences(found, tracker._reach))
    settled = tracker._settled(track, block, found)
    assert (settled is not found) is moves
    lowest, highest = tracker._integrity.open_cells(track)
    assert lowest <= highest


def test_an_altitude_that_contradicts_its_prediction_is_not_given_until_the_next_one_agrees():
    """After coasting the gate is wide: a strong pair of lobes may lie in it, farther off than its level says."""
    tracker = AltitudeTracker(FAST)
    track = started(tracker, 150, 150, 37)
    for k in range(10):
        block = showing(tracker, 150, 150, 60 + k)
        found = tracker._continue(track, block, 59.5 + 40.0 * k)
    assert tracker._undisputed(track, block, found)
    track.filter.covariance[0, 0] = 36.0
    given = []
    for k in range(2):
        block = showing(tracker, 152, 152, 80 + k)
        found = tracker._continue(track, block, 499.5 + 40.0 * k)
        given.append(tracker._undisputed(track, block, found))
    assert given == [False, True]


@pytest.mark.parametrize("missed, settled, given", [(1, True, True), (2, True, False), (1, False, False)])
def test_one_poor_block_takes_an_altitude_away_for_that_block_alone(missed, settled, given):
    """The next block shows too little to start a track; after two poor ones that is no proof."""
    tracker = AltitudeTracker(FAST)
    tracker._track = track = started(tracker, 150, 150, 37)
    for k in range(10):
        tracker._continue(track, showing(tracker, 150, 150, 60 + k), 59.5 + 40.0 * k)
    assert track.settled
    track.settled = settled
    for _ in range(missed):
        tracker._missed()
    block = showing(tracker, 150, 150, 91, power=0.4)
    found = tracker._continue(track, block, 499.5)
    track.settled = settled
    assert found.strength < tracker._integrity.search_threshold
    assert tracker._undisputed(track, block, found) is given


def test_a_track_back_from_coasting_shows_three_blocks_in_a_row():
    """Seed 730028: with a poor block among them the second and third lay on a grating lobe, and one was given."""
    tracker = AltitudeTracker(FAST)
    tracker._track = track = started(tracker, 150, 150, 37)
    for hits, left in ((1, 0), (2, 0), (3, 3)):
        track.hits, track.missed, track.settled = hits, 0, True
        tracker._missed()
        assert track.hits == left


def test_what_one_half_is_off_by_leaves_the_altitude_once_the_speed_is_known():
    """The up half is off by 4 m; the down half is right, and so is its altitude at the known speed of zero."""
    off_m, per_m = 4.0, 2.0  # m/s of Doppler per metre of the halves' mean
    found = Measurement(off_m / 2, per_m * off_m / 2, 4.0, 16.0, 10.0, np.zeros(2), 1.0, 0, 7.9)
    for covariance, left_m in ((7.9, 0.1), (0.0, 1.0)):
        kalman = Kalman(np.zeros(2), np.diag([4.0, 0.01]))
        kalman.update(replace(found, altitude_speed_covariance=covariance), 0.0, with_speed=True)
        assert kalman.mean[0] == pytest.approx(left_m, abs=0.1)


def test_a_candidate_does_not_keep_another_return_from_becoming_one():
    tracker = AltitudeTracker(FAST)
    frames = flight(np.random.default_rng(42), np.full(80, 300.0), -10.0)
    frames[40:] += 2.0 * point_return(W, np.full(40, 700.0))
    tracker.process(FAST.spectra(frames))
    found = sorted(c.latest.altitude_m for c in tracker._candidates)
    np.testing.assert_allclose(found, [300.0, 700.0], atol=2.0)


@pytest.mark.parametrize("after", [12, 15])
def test_a_step_of_half_a_cell_that_leaves_the_peak_of_the_block_is_noticed(after):
    """12 m at -26 dB: the block's peak stays at the old altitude, its last quarter has moved by more than the level."""
    path = np.where(np.arange(400) < 400 - after, 500.0, 512.0)
    outputs = tracked(flight(np.random.default_rng(43), path, -26.0))
    assert outputs["status"][-2] == Status.NORMAL and outputs["status"][-1] == Status.NO_COMPUTED_DATA


def test_a_lost_return_coasts_then_is_lost_and_no_altitude_is_given():
    rng = np.random.default_rng(9)
    frames = np.concatenate([flight(rng, np.full(400, 300.0), 0.0), noise(rng, 1280, 0.0)])
    outputs = tracked(frames)
    gone = outputs["frame_index"] >= 400
    assert np.all(outputs["status"][gone] == Status.NO_COMPUTED_DATA)
    # noise within the gate, one block in a hundred, makes it coast longer
    outputs = tracked(frames, settings=TrackerSettings(gate_pfa=1e-5))
    assert np.all(outputs["status"][gone] == Status.NO_COMPUTED_DATA)
    states = outputs["state"][gone]
    assert states[0] == State.COAST and State.LOST in states and states[-1] in (State.SEARCH, State.CONFIRM)
    ages = outputs["age_s"][gone & (outputs["state"] == State.COAST)]
    np.testing.assert_allclose(np.diff(ages), 0.04, atol=1e-9)
    assert ages[0] == pytest.approx(0.06, abs=0.002)  # half a block, and one


def test_not_finite_and_missing_frames_are_failures_and_the_track_survives():
    rng = np.random.default_rng(10)
    frames = flight(rng, np.full(800, 300.0), 0.0)
    frames[240:360] = np.nan
    outputs = tracked(frames)
    assert np.all(outputs["status"][6:9] == Status.FAILURE) and outputs["status"][9] == Status.NORMAL
    kept = np.r_[0:240, 400:800]
    outputs = tracked(frames[kept], index=kept)
    assert len(outputs) == 20  # 25 a second, whatever is missing
    assert np.all(outputs["status"][6:10] == Status.FAILURE) and outputs["status"][10] == Status.NORMAL
    assert np.all(np.diff(outputs["frame_index"]) == 40)


@pytest.mark.parametrize("back_to", [0, 1215])
def test_an_index_that_runs_backwards_starts_anew(back_to):
    """To an earlier block, or by fifteen frames within the block that is being filled."""
    frames = flight(np.random.default_rng(11), np.full(470, 300.0), 0.0)
    outputs = tracked(frames, index=np.r_[1000:1230, back_to : back_to + 240])[5:]
    confirmed = np.nonzero(outputs["status"] == Status.NORMAL)[0]
    assert 2 <= confirmed[0] <= 3 and confirmed[-1] == len(outputs) - 1


@pytest.mark.parametrize(
    ("level_db", "apart_m"), [(3.0, 100.0), (10.0, 100.0), (-3.0, 300.0), (-8.0, -100.0)]
)
def test_a_second_return_that_could_be_the_ground_is_no_computed_data(level_db, apart_m):
    """Spoofed in mid-track: the old altitude is still there, so neither is called NORMAL."""
    rng = np.random.default_rng(12)
    frames = flight(rng, np.full(1000, 500.0), 0.0)
    frames[400:] += 10.0 ** (level_db / 20.0) * point_return(W, np.full(600, 500.0 + apart_m))
    outputs = tracked(frames)
    assert np.all(outputs["status"][3:10] == Status.NORMAL)
    assert not np.any(outputs["status"][12:] == Status.NORMAL)


@pytest.mark.parametrize(("altitude_m", "apart_m"), [(30, 16), (100, 16), (800, 16), (100, 21)])
def test_another_altimeter_a_resolution_cell_from_the_ground_leaves_neither(altitude_m, apart_m):
    """Two peaks that overlap: of equal power, and of another speed, so that its phase against the ground turns."""
    rng = np.random.default_rng(0)
    path = altitude_m + 2.0 * T * np.arange(480)
    frames = flight(rng, path, 20.0, 2.0)
    frames += point_return(W, path + apart_m, vertical_speed_m_per_s=7.0, phase_cycles=rng.random())
    outputs = tracked(frames, settings=TrackerSettings(doppler=True))
    error_m = np.abs(outputs["altitude_m"] - path[outputs["frame_index"]])
    assert not np.any(error_m > outputs["protection_level_m"])


@pytest.mark.parametrize("apart_m", [80.0, -80.0])
def test_the_ground_is_not_given_up_for_a_stronger_return_near_by_while_it_is_there(apart_m):
    """13 dB, for 1.8 s: alone the stronger one would be called NORMAL, since the ground is far below it."""
    rng = np.random.default_rng(22)
    frames = flight(rng, np.full(2080, 500.0), 0.0)
    frames[280:] += 10.0 ** (13.0 / 20.0) * point_return(W, np.full(1800, 500.0 + apart_m))
    outputs = tracked(frames)
    assert np.all(outputs["status"][3:7] == Status.NORMAL)
    assert not np.any(outputs["status"][7:] == Status.NORMAL)


def test_a_method_that_takes_the_ground_away_does_not_hand_the_track_to_a_stronger_return():
    """The received frames still show the ground, 13 dB below what the method has left."""
    rng = np.random.default_rng(24)
    received = flight(rng, np.full(1600, 500.0), 0.0)
    cleaned = received.copy()
    second = 10.0 ** (13.0 / 20.0) * point_return(W, np.full(1320, 620.0))
    received[280:] += second
    cleaned[280:] = second + noise(rng, 1320, 0.0)
    tracker = AltitudeTracker(ALTIMETER)
    status = tracker.process(ALTIMETER.spectra(cleaned), received=ALTIMETER.spectra(received))["status"]
    assert np.all(status[3:7] == Status.NORMAL)
    assert not np.any(status[7:] == Status.NORMAL)


def test_an_altitude_beyond_all_that_are_possible_is_no_computed_data():
    """Half a resolution cell (10 m) beyond the span is searched; the protection level is 2.3 m there."""
    altimeter = Altimeter(W, AltimeterSettings(min_altitude_m=100.0, max_altitude_m=1000.0))
    rng = np.random.default_rng(23)
    for altitude_m, normal in ((93.0, False), (99.0, True), (999.0, True), (1007.0, False)):
        outputs = tracked(flight(rng, np.full(240, altitude_m), 0.0), altimeter)
        assert np.all(outputs["state"][:2] == State.CONFIRM)  # three blocks in a row have to agree
        assert np.all(outputs["status"][:2] == Status.NO_COMPUTED_DATA)
        assert np.all(outputs["state"][2:] == State.TRACK)
        assert np.all((outputs["status"][2:] == Status.NORMAL) == normal)


def test_side_lobes_of_a_radar_that_moves_in_from_beyond_the_span_are_no_altitude():
    """30 dB above the noise, 450 m/s by its clock: lobes of a half sweep reach the span before its lines do."""
    drift = -400.0 + 450.0 * np.arange(800) * T
    for seed in range(3):
        rng = np.random.default_rng(seed)
        line = 10.0 * point_return(W, drift, vertical_speed_m_per_s=450.0, phase_cycles=0.3)
        assert not np.any(tracked(noise(rng, 800, 10.0) + line)["status"] == Status.NORMAL)


def test_a_line_beyond_the_span_takes_nothing_from_ground_above_its_side_lobes():
    """20 dB stronger, 18 resolution cells from it: the ground is 9 dB above such side lobes."""
    rng = np.random.default_rng(30)
    line = 10.0 * point_return(W, np.full(400, -200.0), phase_cycles=rng.random(400))
    outputs = tracked(flight(rng, np.full(400, 150.0), 0.0) + line)
    assert np.all(outputs["status"][3:] == Status.NORMAL)


def test_a_weak_second_return_above_the_ground_changes_nothing():
    rng = np.random.default_rng(13)
    frames = flight(rng, np.full(600, 500.0), 0.0) + 10.0 ** (-12 / 20) * point_return(W, np.full(600, 700.0))
    outputs = tracked(frames)
    assert np.all(outputs["status"][3:] == Status.NORMAL)


def test_speed_by_doppler_and_by_altitudes():
    """A beat shift has no Doppler: the tracker takes the speed from the altitudes, and says so by its settings."""
    rng = np.random.default_rng(14)
    path = 500.0 - 20.0 * np.arange(720) * T
    shifted = np.stack([W.beat_shifted(h) for h in path]) + noise(rng, path.size, 0.0)
    for frames, doppler in ((flight(rng, path, 0.0, -20.0), True), (shifted, False)):
        outputs = tracked(frames.astype(np.complex64), FAST, TrackerSettings(doppler=doppler))
        last = outputs[-1]
        assert last["status"] == Status.NORMAL
        assert last["vertical_speed_m_per_s"] == pytest.approx(-20.0, abs=1.0)
        assert last["altitude_m"] == pytest.approx(path[-1] - 0.5 * 20.0 * T, abs=0.5)


def test_ragged_chunks_give_what_one_chunk_gives():
    rng = np.random.default_rng(15)
    frames = flight(rng, 400.0 + 5.0 * np.arange(600) * T, -25.0, 5.0)
    spectra = ALTIMETER.spectra(frames)
    whole = AltitudeTracker(ALTIMETER).process(spectra)
    tracker, parts, at = AltitudeTracker(ALTIMETER), [], 0
    while at < len(frames):
        count = int(rng.integers(1, 70))
        piece = type(spectra)(
            spectra.power[at : at + count],
            spectra.support[at : at + count],
            spectra.beat_hz,
            spectra.scale[at : at + count],
        )
        parts.append(tracker.process(piece))
        at += count
    assert np.concatenate(parts).tobytes() == whole.tobytes()  # NaN and all


def test_timing_rest_is_taken_off():
    frames = flight(np.random.default_rng(16), np.full(320, 300.0), 0.0)
    tracker = AltitudeTracker(ALTIMETER)
    outputs = tracker.process(ALTIMETER.spectra(frames), timing_offset_s=2e-8)
    assert outputs["altitude_m"][-1] == pytest.approx(300.0 - 2.998, abs=0.05)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: TrackerSettings(risk=0.5), "tracker.risk"),
        (lambda: TrackerSettings(coast_s=float("nan")), "tracker.coast_s"),
        (lambda: AltitudeTracker(ALTIMETER, TrackerSettings(output_s=0.005)), "at least 8"),
    ],
)
def test_impossible_settings_are_refused(make, said):
    with pytest.raises(ValueError, match=said):
        make()


def test_evidence_is_a_mean_with_falling_weights_and_its_variance():
    """Weights fall by 2/3 per block for a memory of two; the variance is that of a sum of independent blocks."""
    rng = np.random.default_rng(26)
    blocks, evidence = rng.standard_normal((5, 2, 2, 7)), Evidence(2.0)
    for mean, variance in blocks:
        evidence.add(mean, np.abs(variance))
    weights = (2.0 / 3.0) ** np.arange(4, -1, -1)
    weights /= weights.sum()
    np.testing.assert_allclose(evidence.mean, np.einsum("k,kij->ij", weights, blocks[:, 0]))
    np.testing.assert_allclose(evidence.variance, np.einsum("k,kij->ij", weights**2, np.abs(blocks[:, 1])))


def test_a_rival_is_open_where_its_lead_over_the_noise_is_too_small():
    """Both halves' differences count together, at every allowed difference of their cells, within the span alone."""
    evidence = Evidence(2.0)
    mean = np.full((2, 21), 5.0)
    mean[:, 10] = 0.0  # the track itself
    mean[0, 10 + 6] = mean[1, 10 + 4] = 0.5  # a rival five cells up whose halves are two cells apart
    evidence.add(mean, np.full((2, 21), 0.5))
    everywhere = (-20.0, 20.0)
    assert evidence.farthest(4.0, (-1, 1), 1.0, everywhere) == (0.0, 0.0)
    assert evidence.farthest(4.0, (-2, 2), 1.0, everywhere) == (5.0, 2.0)
    assert evidence.farthest(4.0, (-2, 2), 1.0, (-20.0, 4.0)) == (0.0, 0.0)
    assert evidence.farthest(4.0, (-2, 2), 6.0, everywhere) == (0.0, 0.0)  # within the main lobe
    assert evidence.farthest(0.9, (-2, 2), 1.0, everywhere) == (0.0, 0.0)


def test_speeds_that_no_two_cells_have_change_nothing():
    """A measurement that hardly stands out of noise tells nothing of its speed."""
    evidence = Evidence(2.0)
    evidence.add(np.full((2, 21), 5.0), np.full((2, 21), 0.5))
    evidence.mean[:, 3] = evidence.mean[:, 15] = 0.0
    within, beyond = (evidence.farthest(4.0, (-n, n), 1.0, (-20.0, 20.0)) for n in (20, 1000))
    assert within == beyond == (7.0, 12.0)


def test_a_lobe_that_wins_the_votes_alone_does_not_outdo_a_return():
    found = Measurement(500.0, 0.0, 0.1, 1.0, 40.0, np.zeros(2), 9.0, 0)
    for strength, power, outdone in ((50.0, 5.0, False), (30.0, 20.0, False), (50.0, 20.0, True)):
        assert _exceeds(Entry(strength, 525.0, (0, 0), power, 0), found, 3.0) is outdone


def test_a_track_starts_where_a_grating_lobe_wins_the_votes_but_not_the_power():
    """Up cell 150 with down cell 150, power in few frames, or 156, less in all: only more power makes a ghost of it."""
    tracker = AltitudeTracker(FAST)
    ratio = np.random.default_rng(31).exponential(size=(40, 2, FAST.beat_hz.size)).astype(np.float32)
    ratio[:, 0, 150] = 6.0
    ratio[::4, 1, 150] = 36.0
    for lobe, ghost in ((8.0, False), (14.0, True)):
        ratio[:, 1, 156] = lobe
        block = tracker.integrator.integrate(ratio, np.arange(40.0))
        found = block.measure(block.strongest(np.abs(tracker.integrator._down - 150) < 2))
        assert block.strongest().cells == (150, 156) and block.strongest().strength > found.strength
        assert tracker._is_side_lobe(block, found, ghosts=True) is ghost


def test_what_a_network_leaves_within_the_span_alone_is_no_second_return():
    """Its rest ends with the altitudes it was trained for: near the end of the span one side alone shows power."""
    rng = np.random.default_rng(33)
    tables = AltitudeTracker(ALTIMETER).integrator
    ratio = rng.exponential(size=(40, 2, ALTIMETER.beat_hz.size)).astype(np.float32)
    level = np.ones(ALTIMETER.beat_hz.size, dtype=np.float32)
    level[tables.last - 60 :], level[tables.last :] = 4.0, 0.2
    here, lobe = tables.last - 12, np.exp(-0.5 * (np.arange(-4, 5) / 2.0) ** 2)
    level[here - 4 : here + 5] += 12.0 * lobe
    for second, said in ((0.0, False), (8.0, True)):
        level[here - 24 : here - 15] += second * lobe  # 100 m below
        block = tables.integrate(ratio * level, np.arange(40.0))
        found = block.measure(block.strongest(np.abs(tables._up - here) <= 2))
        assert block.second_return(found, 30, 0.25, 0.1, 0.0) is said


def test_a_track_stays_with_the_pair_of_most_power_while_a_lobe_wins_the_votes():
    """A network leaves two ends of a sweep: the lobe of one half, 20 m off, passes for 35 m/s where 150 are allowed."""
    tracker = AltitudeTracker(FAST)
    ratio = np.random.default_rng(34).exponential(size=(40, 2, FAST.beat_hz.size)).astype(np.float32)
    ratio[:, 0, 150] = 6.0
    ratio[::4, 1, 150] = 50.0  # twice the lobe's power, in a quarter of the frames: fewer votes
    ratio[:, 1, 154] = 5.0
    block = tracker.integrator.integrate(ratio, np.arange(40.0))
    assert block.strongest().cells == (150, 154)
    weakest = block.table == block.table[tracker.integrator._valid].min()
    for allowed in (weakest, ~tracker.integrator._valid):  # less than noise gives, or nothing at all
        np.testing.assert_array_equal(block.prominent(allowed), allowed & tracker.integrator._valid)
    start = block.measure(block.strongest(np.abs(tracker.integrator._down - 150) < 2))
    tracker._at, tracker._before, tracker._shift_m, tracker._lead_s = np.arange(40), None, 0.0, 0.02
    track = tracker._start(block, tracker._calibrated(start), 19.5)
    found = tracker._continue(track, block, 59.5)
    assert np.abs(found.cells - 150.0).max() < 1.0


def test_a_poor_altitude_widens_the_level_by_its_share_and_not_for_itself():
    """Errors of one sign do not average out: equal ones stay whole; ten times as much at once has little weight."""
    found = Measurement(0.0, 0.0, 4.0, 1.0, 10.0, np.zeros(2), 1.0, 0)
    kalman = Kalman(np.zeros(2), np.diag([4.0, 1.0]), pulled=np.array([2.0, 0.0]))

    def take(variance_m2):
        kalman.predict(0.04, 5.0)
        kalman.update(replace(found, altitude_variance_m2=variance_m2), 0.02, with_speed=True)
        return kalman.pulled[0]

    for _ in range(20):
        assert take(4.0) == pytest.approx(2.0)
    assert 2.0 < take(400.0) < 2.2
    for _ in range(20):
        last = take(1.0)  # better ones since: the old ones are forgotten as fast as the filter forgets them
    assert 1.0 < last < 1.2


def test_a_base_stations_pattern_in_the_received_frames_is_no_rival():
    """5 MHz NR 60 dB above the return repeats every 20 ms: this draw has a false line of 5.5 deviations all along."""
    nr5 = NrEmitter(channel_bandwidth_hz=5e6, cell_id=402, frame_count=2, seed=43)
    stream = JammerStream(W, [Interferer(nr5, -60.0)], seed=1056364367, free_running=True, total_sir_db=None)
    stream.next_frame()
    altimeter = Altimeter(W)
    cleaned = flight(np.random.default_rng(32), np.full(200, 1000.0), 10.0)
    received = cleaned + np.stack([stream.next_frame() for _ in range(200)])
    spectra = (altimeter.spectra(x.astype(np.complex64)) for x in (cleaned, received))
    tracker = AltitudeTracker(altimeter)
    assert np.all(tracker.process(next(spectra), received=next(spectra))["status"][2:] == Status.NORMAL)


def test_the_harder_an_aircraft_may_accelerate_the_more_speeds_its_altitudes_leave_open():
    """Four level altitudes 40 ms apart: a deviation of 0.5 m per altitude, and what an acceleration adds meanwhile."""
    found = Measurement(500.0, 0.0, 0.25, 0.01, 40.0, np.zeros(2), 9.0, 0)
    for acceleration in (1.0, 400.0):
        settings = TrackerSettings(doppler=True, acceleration_m_per_s2=acceleration)
        integrity = Integrity(AltitudeTracker(FAST, settings).integrator, settings, FAST.waveform.sweep_s)
        track = Track(Kalman(np.array([500.0, 0.0]), np.eye(2)), Evidence(2.0))
        for k in range(4):
            track.take(found, 40.0 * k)
        slope_variance = 0.25 / np.sum((0.04 * (np.arange(4) - 1.5)) ** 2)
        sigma = np.sqrt(slope_variance + (acceleration * 0.04 * 2.0) ** 2 + 0.01)
        cells = int(np.ceil(integrity._noise_sigmas * sigma / integrity.integrator.speed_per_cell))
        assert integrity.open_cells(track) == (-cells, cells)


@pytest.mark.parametrize("doppler_m_per_s", [15.0, -15.0])
def test_a_doppler_that_the_altitudes_contradict_leaves_no_speed_open(doppler_m_per_s):
    """Thirty level altitudes of 0.1 m each: 15 m/s either way is no speed of theirs."""
    found = Measurement(500.0, doppler_m_per_s, 0.01, 0.0, 40.0, np.zeros(2), 9.0, 0)
    settings = TrackerSettings(doppler=True, acceleration_m_per_s2=0.01)
    integrity = Integrity(AltitudeTracker(FAST, settings).integrator, settings, FAST.waveform.sweep_s)
    track = Track(Kalman(np.array([500.0, 0.0]), np.eye(2)), Evidence(2.0))
    for k in range(30):
        track.take(found, 40.0 * k)
    least, most = integrity.open_cells(track)
    assert least > most


def test_a_filter_notices_innovations_beyond_what_it_expects():
    """Innovations of three standard deviations each make their mean square nine; those of one keep it at one."""
    found = Measurement(0.0, 0.0, 0.25, 1.0, 10.0, np.zeros(2), 1.0, 0)
    for sigmas in (1.0, 3.0):
        kalman = Kalman(np.array([100.0, 0.0]), np.diag([0.1, 0.5]))
        for _ in range(120):
            kalman.predict(0.04, 1.0)
            rest, variance = kalman.innovation(found, 0.02)
            altitude = -rest + sigmas * np.sqrt(variance)
            kalman.update(replace(found, altitude_m=altitude), 0.02, with_speed=False)
        assert kalman.nis == pytest.approx(sigmas**2, rel=1e-4)


# -- the block --------------------------------------------------------------------------------------------------------


def test_block_tracks_in_any_chunks_and_says_so_in_messages():
    import pmt
    from gnuradio import radalt
    from test_blocks import Messages, Ragged, run

    from radalt.core.scene import parse_scene

    scene = parse_scene(
        {
            "altitude": {
                "programme_m": [300.0],
                "frames": 400,
                "mode": "true_delay",
                "vertical_speed_m_per_s": -5.0,
            }
        }
    )
    path = 300.0 - 5.0 * (np.arange(360) - 180) * T
    frames = flight(np.random.default_rng(17), path, 0.0, -5.0).astype(np.complex64)
    tags = [
        (k, pmt.intern("radalt_frame"), pmt.init_f64vector(4, [float(k), k * N, 0.0, np.nan]))
        for k in range(len(frames))
    ]
    kept = []
    for seed in (None, 1, 2):
        block, seen = radalt.altitude_tracker(scene), Messages()
        source = Ragged(frames, seed, tags)
        run(source, block, also=(seen,), wires=(((block, "tracked"), (seen, "in")),))
        kept.append((block.outputs(), block.results()))
        assert [m["status"] for m in seen.seen][-1] == "normal" and len(seen.seen) == 9
        assert seen.seen[-1]["line"].startswith("NORMAL  299.")
    expected = AltitudeTracker(block.altimeter, scene.tracker_settings).process(
        block.altimeter.spectra(frames)
    )
    for outputs, results in kept:
        assert outputs.tobytes() == expected.tobytes()
        assert len(results) == len(frames) and results["valid"].all()


def test_block_takes_the_received_frames_on_a_second_input():
    from gnuradio import radalt
    from test_blocks import Ragged, run

    from radalt.core.scene import parse_scene

    rng = np.random.default_rng(21)
    cleaned = flight(rng, np.full(240, 300.0), 0.0).astype(np.complex64)
    received = cleaned + point_return(W, np.full(240, 500.0), phase_cycles=rng.random(240))
    scene, outputs = parse_scene({}), []
    for beside in (cleaned, received):
        block, straight = radalt.altitude_tracker(scene, "tcae", received=True), Ragged(beside, 2)
        run(Ragged(cleaned, 1), block, also=(straight,), wires=((straight, (block, 1)),))
        outputs.append(block.outputs())
    assert outputs[0]["status"][-1] == Status.NORMAL
    assert not np.any(outputs[1]["status"] == Status.NORMAL)  # what a method took away


def test_block_says_failure_when_the_segmenter_loses_lock():
    import pmt
    from gnuradio import radalt

    from radalt.core.scene import parse_scene

    block = radalt.altitude_tracker(parse_scene({}))
    said = []
    block.message_port_pub = lambda port, message: said.append(pmt.to_python(message))
    block._on_timing(pmt.to_pmt({"locked": True, "timing_verified": True}))
    assert not said
    for _ in range(3):  # once is enough
        block._on_timing(pmt.to_pmt({"locked": False, "timing_verified": False}))
    assert [m["status"] for m in said] == ["failure"] and np.isnan(said[0]["altitude_m"])
    assert said[0]["line"] == "FAILURE (lost)" and said[0]["timing_verified"] is False


def test_a_scene_settles_whether_speed_shows_as_doppler():
    from radalt.core.scene import parse_scene

    assert parse_scene({}).tracker_settings.doppler is False
    assert parse_scene({"altitude": {"mode": "true_delay"}}).tracker_settings.doppler is True
    assert parse_scene({"tracker": {"doppler": True, "risk": 1e-3}}).tracker_settings.risk == 1e-3


@pytest.mark.parametrize("edge", ["first", "last"])
def test_a_return_at_the_edge_of_the_span_may_seem_to_move_beyond_it(edge):
    """The noise of a block's last quarter may lie highest where no cell belongs to an altitude.

    The live view sends altitude zero where its button takes the timing anew.
    """
    rng = np.random.default_rng(20)
    for _ in range(20):
        block = block_of(rng, 40, -60.0)
        tables = block.tables
        cell = tables.first if edge == "first" else tables.last - 1
        row = int(np.abs(tables.row_speed).argmin())
        found = Measurement(500.0, 0.0, 0.1, 1.0, 40.0, np.full(2, float(cell)), 9.0, row)
        moved_m, sigma_m = block.moved_since(found)
        assert np.isfinite(moved_m) and sigma_m > 0
