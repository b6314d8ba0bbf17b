"""The tracker's parts, each alone: integrator, gate, updater (filter, evidence), initiator, deleter, integrity."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from frames import W

from radalt import Altimeter, AltimeterSettings
from radalt.core.tracker.deleter import Deleter
from radalt.core.tracker.gate import Gate
from radalt.core.tracker.initiator import Initiator
from radalt.core.tracker.integrator import Integrator
from radalt.core.tracker.rivals import is_side_lobe, second_return
from radalt.core.tracker.scan import Scan
from radalt.core.tracker.summed_block import Block, Measurement
from radalt.core.tracker.track import Evidence, Kalman, Track
from radalt.core.tracker.track_integrity import Integrity
from radalt.core.tracker.tracker_settings import TrackerSettings
from radalt.core.tracker.updater import Updater

ALTIMETER = Altimeter(W, AltimeterSettings(max_altitude_m=1000.0, max_vertical_speed_m_per_s=20.0))
FAST = Altimeter(W, AltimeterSettings(max_altitude_m=1000.0, max_vertical_speed_m_per_s=150.0))


def parts_of(settings: TrackerSettings = TrackerSettings()) -> SimpleNamespace:  # noqa: B008 - frozen
    """The parts of a tracker behind `FAST`, put together as the tracker does."""
    tables = Integrator(FAST, 40, doppler=True, max_speed_m_per_s=settings.max_vertical_speed_m_per_s)
    gate = Gate(tables, settings.gate_pfa)
    integrity = Integrity(gate, settings)
    updater = Updater(gate, integrity)
    deleter = Deleter(gate, settings, integrity.search_threshold)
    made = {"tables": tables, "gate": gate, "integrity": integrity, "updater": updater, "deleter": deleter}
    return SimpleNamespace(**made, initiator=Initiator(gate, updater, deleter, settings))


def test_what_one_half_sweep_shows_alone_is_no_return():
    tables = Integrator(ALTIMETER, 40, doppler=True, max_speed_m_per_s=20.0)
    ratio = np.random.default_rng(29).exponential(size=(40, 2, tables.beat_hz.size)).astype(np.float32)
    ratio[:, 0, 150] = 30.0
    block = Block(tables, ratio, np.arange(40.0))
    assert block.table.max() > 25.0 and block.strongest().strength < 12.0
    ratio[:, 1, 150] = 30.0
    assert Block(tables, ratio, np.arange(40.0)).strongest().strength > 50.0


def exponential(seed: int, frames: int = 40) -> np.ndarray:
    """Normalised spectra of noise for `FAST`."""
    rng = np.random.default_rng(seed)
    return rng.exponential(size=(frames, 2, FAST.beat_hz.size)).astype(np.float32)


def test_frames_moved_one_by_one_add_up_to_the_sum_of_moved_frames():
    tables, ratio = parts_of().tables, exponential(41)
    shifts = 0.4 * np.arange(-20.0, 20.0)
    one_by_one = tables.moved(ratio, shifts).sum(axis=0)
    inside = slice(10, -10)
    total = tables.moved_sums(ratio, shifts[None])[0]
    np.testing.assert_allclose(one_by_one[:, inside], total[:, inside], rtol=1e-4)


def test_evidence_knows_which_side_of_a_return_has_power_and_the_farthest_rival_and_moves_with_the_track():
    evidence = Evidence(2.0, np.abs([np.arange(-8.0, 9.0, 2.0)] * 2), 0.001 * np.arange(18.0).reshape(2, 9))
    assert evidence.asymmetry(1.0) == 0.0
    evidence.mean[:, 5:] -= 1.0  # extended ground: more power beyond
    assert evidence.asymmetry(1.0) == pytest.approx(1.0 / 4.0)
    evidence.mean[:, -1] = 0.0
    assert evidence.farthest(4.0, (0, 0), 1.5, (-9.0, 9.0)) == (4.0, 0.0)
    assert evidence.farthest(4.0, (-99, 99), 1.5, (-9.0, 9.0)) == (4.0, 4.0)  # there are no more cells
    evidence.recentre((1, -2))
    assert not evidence.mean[:, 4].any()
    np.testing.assert_allclose(evidence.variance[:, 4], [0.010, 0.022])  # twice their own: of a difference


def scan_of(parts: SimpleNamespace, ratio: np.ndarray, middle: float = 19.5) -> Scan:
    """A block of forty frames, 20 ms before its output."""
    return Scan(Block(parts.tables, ratio, np.arange(40.0)), middle, lead_s=0.02)


def showing(parts, up: int, down: int, seed: int, middle: float = 19.5, power: float = 12.0) -> Scan:
    """A block that shows a point's peak at a pair of cells."""
    ratio, around = exponential(seed), np.arange(-4, 5)
    for half, cell in enumerate((up, down)):
        shape = np.interp(around, *parts.tables.point_shape).astype(np.float32)
        ratio[:, half, cell + around] += power * shape
    return scan_of(parts, ratio, middle)


def started(up: int, down: int, seed: int) -> tuple[SimpleNamespace, Track]:
    """Parts, and a track of one block that shows a pair of cells."""
    parts = parts_of()
    scan = showing(parts, up, down, seed)
    return parts, parts.initiator.start(scan, scan.corrected(scan.block.best()))


def level_track(blocks: int) -> tuple[SimpleNamespace, Track, Scan, object]:
    """Parts, a track of level flight after ``blocks`` more blocks, the last scan, and what it measured."""
    parts, track = started(150, 150, 37)
    for k in range(blocks):
        scan = showing(parts, 150, 150, 60 + k, 59.5 + 40.0 * k)
        found = parts.updater.update(track, scan)
    return parts, track, scan, found


def test_a_pair_of_another_doppler_is_no_continuation_while_the_speed_is_unknown():
    """Up a cell higher and down a cell lower is the same altitude and 17 m/s more; four of each are another pair."""
    for apart, same in ((0, True), (1, True), (4, False)):
        parts, track = started(150, 150, 37)
        found = parts.updater.update(track, showing(parts, 150 + apart, 150 - apart, 38, 59.5))
        assert (found is not None) is same


def test_a_track_whose_doppler_its_altitudes_contradict_twice_no_longer_holds_its_place():
    """A pair of lobes passes for 70 m/s, but its altitudes have been level for a second."""
    parts, track = started(154, 146, 39)
    for k in range(25):
        level = replace(track.latest, altitude_variance_m2=0.01)
        track.append(level, 40.0 * k)
    for block, seen in ((40, True), (41, False)):
        assert parts.updater.update(track, showing(parts, 154, 146, block, 1039.5)) is None
        assert track.seen is seen


@pytest.mark.parametrize("resolved", [True, False])
def test_a_half_that_is_pulled_once_costs_a_certain_track_nothing(resolved):
    """Its altitudes are level and nothing else is left that it could be: one foreign Doppler is interference's."""
    parts, track = started(150, 150, 42)
    for k in range(25):
        assert parts.updater.update(track, showing(parts, 150, 150, 43 + k, 40.0 * k + 59.5)) is not None
    assert abs(track.doppler_m_per_s) < 1.0  # a mean over ten blocks
    speed, track.resolved = track.filter.mean[1], resolved
    # 17 m/s at the same altitude
    pulled = [showing(parts, 151, 149, 70, 1079.5 + 40.0 * k) for k in range(3)]
    assert parts.integrity.alone(track)
    given = [parts.updater.update(track, scan) is not None for scan in pulled]
    assert given == [resolved, False, False]
    assert track.filter.mean[1] == pytest.approx(speed, abs=0.5)


def test_a_young_track_moves_from_a_lobe_to_the_pair_that_its_blocks_show_with_more_power():
    """It began with a lobe of the up half, six cells higher. Once certain, it stays whatever else has more power."""
    for resolved in (False, True):
        parts, track = started(156, 150, 37)
        lobe_m, track.resolved = track.latest.altitude_m, resolved
        ratio = exponential(39)
        ratio[:, :, 150], ratio[:, 0, 156] = 60.0, 20.0
        found = parts.updater.update(track, scan_of(parts, ratio, 59.5))
        rise = 0.0 if resolved else -3.0 * parts.tables.cell_m
        assert found.altitude_m - lobe_m == pytest.approx(rise, abs=1.5)
        assert track.filter.mean[0] - lobe_m == pytest.approx(rise, abs=1.5)
        assert track.history[0][1] - lobe_m == pytest.approx(rise, abs=1.5)


@pytest.mark.parametrize(("altitudes", "moves"), [(2, True), (5, False)])
def test_a_young_track_does_not_move_to_a_pair_whose_doppler_its_altitudes_contradict(altitudes, moves):
    """Fifty metres per second, and five level altitudes. Two say nothing of a speed."""
    parts, track = started(150, 150, 37)
    found = replace(track.latest, altitude_variance_m2=9.0)
    track.history.clear()
    for k in range(altitudes):
        track.append(found, 40.0 * k)
    ratio = exponential(39)
    ratio[:, 0, 153] = ratio[:, 1, 147] = 60.0
    scan = scan_of(parts, ratio)
    track.evidence.add(*scan.block.differences(found, parts.updater.reach))
    assert (parts.updater.resolve(track, scan, found) is not found) is moves
    lowest, highest = parts.integrity.open_cells(track)
    assert lowest <= highest


def test_an_altitude_that_contradicts_its_prediction_is_not_given_until_the_next_one_agrees():
    """After coasting the gate is wide: a strong pair of lobes may lie in it, farther off than its level says."""
    parts, track, scan, found = level_track(10)
    assert parts.integrity.undisputed(track, scan, found)
    track.filter.covariance[0, 0] = 36.0
    given = []
    for k in range(2):
        scan = showing(parts, 152, 152, 80 + k, 499.5 + 40.0 * k)
        found = parts.updater.update(track, scan)
        given.append(parts.integrity.undisputed(track, scan, found))
    assert given == [False, True]


@pytest.mark.parametrize(("cell", "power", "given"), [(240, 0.0, True), (240, 9.0, False), (115, 9.0, False)])
def test_no_altitude_is_given_with_a_return_nearly_as_strong_far_above_or_below(cell, power, given):
    parts, track = started(150, 150, 37)
    for k in range(11):
        ratio = showing(parts, 150, 150, 60 + k).block.ratio
        ratio[:, :, cell - 1 : cell + 2] += power * np.array([0.5, 1.0, 0.5], dtype=np.float32)
        scan = scan_of(parts, ratio, 59.5 + 40.0 * k)
        found = parts.updater.update(track, scan)
    assert parts.integrity.undisputed(track, scan, found) is given


@pytest.mark.parametrize("late", [0.0, 8.0])
def test_a_step_in_the_last_quarter_contradicts_and_interference_in_a_part_of_the_band_does_not(late):
    parts, track, scan, found = level_track(11)
    ratio = scan.block.ratio
    if late:  # little of the return is left
        ratio[30:], ratio[30:, :, 240] = showing(parts, 150, 150, 91, power=1.5).block.ratio[30:], late
    assert parts.integrity.undisputed(track, scan_of(parts, ratio, scan.middle), found) is (not late)
    ratio[:, :, 250:] *= 20.0
    assert scan_of(parts, ratio).block.contradicted(found) is bool(late)


@pytest.mark.parametrize("missed, resolved, given", [(1, True, True), (2, True, False), (1, False, False)])
def test_one_poor_block_takes_an_altitude_away_for_that_block_alone(missed, resolved, given):
    """The next block shows too little to start a track; after two poor ones that is no proof."""
    parts, track, _, _ = level_track(10)
    assert track.resolved
    track.resolved = resolved
    for _ in range(missed):
        assert not parts.deleter.missed(track)
    scan = showing(parts, 150, 150, 91, 499.5, power=0.35)
    found = parts.updater.update(track, scan)
    track.resolved = resolved
    assert found.strength < parts.integrity.search_threshold
    assert parts.integrity.undisputed(track, scan, found) is given


def test_a_track_back_from_coasting_shows_three_blocks_in_a_row():
    """Seed 730028: with a poor block among them the second and third lay on a grating lobe, and one was given."""
    parts, track = started(150, 150, 37)
    for hits, left in ((1, 0), (2, 0), (3, 3)):
        track.hits, track.missed, track.resolved = hits, 0, True
        parts.deleter.missed(track)
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
    """The second return is stronger and comes a block later; both have a cell of their own."""
    parts = parts_of()
    for _ in range(2):  # one return is one candidate
        parts.initiator.search(showing(parts, 150, 150, 42), [])
    both = exponential(43)
    both[:, :, 150], both[:, :, 240] = 12.0, 24.0
    scan = scan_of(parts, both, 59.5)
    parts.initiator.update(scan, [])
    parts.initiator.search(scan, [])
    cells = sorted(float(c.latest.cells.mean()) for c in parts.initiator.candidates)
    np.testing.assert_allclose(cells, [150.0, 240.0], atol=0.2)
    assert parts.initiator.confirmed() is None  # three blocks in a row have to agree


@pytest.mark.parametrize("left", [12.0, 0.0])
def test_a_certain_track_that_has_ended_is_remembered_until_its_place_is_vacant_twice(left):
    """The successor's return is four times as strong and 150 m above; its own lobes lie on both sides alike."""
    (_, young), (parts, track) = started(150, 150, 42), started(150, 150, 42)
    parts.deleter.end(young)
    assert parts.deleter.predecessor is None  # it was never certain
    track.resolved = True
    parts.deleter.end(track)
    for seed, vacant in ((51, False), (52, not left)):
        ratio = exponential(seed)
        for cell, power in ((180, 48.0), (150, left)):
            ratio[:, :, cell - 1 : cell + 2] += power * np.array([0.5, 1.0, 0.5], dtype=np.float32)
        parts.deleter.watch(None, scan_of(parts, ratio))
        assert (parts.deleter.predecessor is None) is vacant


@pytest.mark.parametrize(("sigma_m", "inside", "outside"), [(0.5, 3, 4), (8.0, 8, 10), (100.0, 13, 14)])
def test_a_place_is_as_wide_as_its_prediction_from_half_a_resolution_cell_to_three(sigma_m, inside, outside):
    """Cells of a quarter of a resolution cell; the peak that stands there reaches a cell beyond its own."""
    for apart, occupied in ((inside, True), (outside, False)):
        parts, track = started(150, 150, 42)
        track.resolved, track.filter.covariance = True, np.diag([sigma_m**2, 1e-4])
        parts.deleter.end(track)
        ratio = exponential(51)
        for cell, power in ((190, 48.0), (150 + apart, 12.0)):
            ratio[:, :, cell - 1 : cell + 2] += power * np.array([0.5, 1.0, 0.5], dtype=np.float32)
        parts.deleter.watch(None, scan_of(parts, ratio))
        assert (track.vacant == 0) is occupied


def test_received_frames_show_a_return_by_strength_and_not_by_power_alone():
    """One frame of forty holds as much power there as a return in all of them: interference, of unknown shape."""
    parts = parts_of()
    steady, least = showing(parts, 150, 150, 54, power=50.0).block, parts.integrity.received_threshold
    once = exponential(55)
    once[7, :, 146:155] += 2000.0 * np.interp(np.arange(-4, 5), *parts.tables.point_shape).astype(np.float32)
    found = steady.best()
    assert steady.shows(found, least) and scan_of(parts, once).block.power_at(found) > 40.0
    assert not scan_of(parts, once).block.shows(found, least)


def test_a_gate_is_centred_on_the_prediction_at_the_middle_of_the_block():
    """At 100 m/s the middle of a block, 20 ms before its output, lies 2 m lower."""
    parts, track = started(150, 150, 42)
    altitude_m = track.filter.mean[0]
    track.filter.mean[1], track.filter.covariance = 100.0, np.diag([0.01, 0.01])
    track.latest = replace(track.latest, altitude_variance_m2=0.01)
    for off_m, inside in ((-2.0, True), (-2.4, True), (-1.2, False), (-3.0, False)):
        found = replace(track.latest, altitude_m=altitude_m + off_m)
        assert parts.gate.near(track, found, 0.02) is inside
    scan = showing(parts, 150, 150, 44)
    open_m = parts.tables.altitude_m[parts.gate.mask(track, scan)]
    assert open_m.size == 0  # no row of 100 m/s is within the latest Doppler's gate
    track.filter.mean[1] = 0.0
    open_m = parts.tables.altitude_m[parts.gate.mask(track, scan)]
    assert open_m.size and np.abs(open_m - altitude_m).max() <= 4.0 * 0.02**0.5 + 0.51 * parts.tables.cell_m

    scan.residual_m = 30.0  # frames so late that every altitude seems higher
    moved_m = parts.tables.altitude_m[parts.gate.mask(track, scan)]
    assert moved_m.mean() - open_m.mean() == pytest.approx(30.0, abs=parts.tables.cell_m)


def test_a_track_starts_where_a_grating_lobe_wins_the_votes_but_not_the_power():
    """Up cell 150 with down cell 150, power in few frames, or 156, less in all: only more power makes a ghost of it."""
    parts = parts_of()
    ratio = exponential(31)
    ratio[:, 0, 150] = 6.0
    ratio[::4, 1, 150] = 36.0
    for lobe, ghost in ((8.0, False), (14.0, True)):
        ratio[:, 1, 156] = lobe
        block = Block(parts.tables, ratio, np.arange(40.0))
        found = block.measure(block.strongest(np.abs(parts.tables.down_cell - 150) < 2))
        assert block.strongest().cells == (150, 156) and block.strongest().strength > found.strength
        assert is_side_lobe(block, found, mixed=True) is ghost


def test_what_a_network_leaves_within_the_span_alone_is_no_second_return():
    """Its rest ends with the altitudes it was trained for: near the end of the span one side alone shows power."""
    rng = np.random.default_rng(33)
    tables = Integrator(ALTIMETER, 40, doppler=True, max_speed_m_per_s=20.0)
    ratio = rng.exponential(size=(40, 2, ALTIMETER.beat_hz.size)).astype(np.float32)
    level = np.ones(ALTIMETER.beat_hz.size, dtype=np.float32)
    level[tables.last - 60 :], level[tables.last :] = 4.0, 0.2
    here, lobe = tables.last - 12, np.exp(-0.5 * (np.arange(-4, 5) / 2.0) ** 2)
    level[here - 4 : here + 5] += 12.0 * lobe
    for second, said in ((0.0, False), (8.0, True)):
        level[here - 24 : here - 15] += second * lobe  # 100 m below
        block = Block(tables, ratio * level, np.arange(40.0))
        found = block.measure(block.strongest(np.abs(tables.up_cell - here) <= 2))
        assert second_return(block, found, 30, 0.25, 0.1) is said


@pytest.mark.parametrize(("step", "counts"), [(12, False), (-12, True), (-4, True), (-3, False)])
def test_a_return_eight_decibels_weaker_near_by_counts_below_and_not_above(step, counts):
    """The nearest ground is the altitude, from nine tenths of a resolution cell (here four cells) on."""
    parts = parts_of()
    ratio = showing(parts, 150, 150, 35, power=40.0).block.ratio
    ratio[:, :, 149 + step : 152 + step] += 0.16 * 40.0 * np.array([0.5, 1.0, 0.5], dtype=np.float32)
    block = scan_of(parts, ratio).block
    assert second_return(block, block.best(), 24, 10**-0.6, 10**-1.0) is counts


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_return_at_the_highest_speed_allowed_is_found_either_way(sign):
    tables = Integrator(FAST, 40, doppler=True, max_speed_m_per_s=150.0)
    apart = sign * int(150.0 / tables.speed_per_cell)
    ratio, (up, down) = exponential(46), (150 + apart // 2, 150 + apart // 2 - apart)
    ratio[:, 0, up], ratio[:, 1, down] = 12.0, 12.0
    found = Block(tables, ratio, np.arange(40.0)).strongest()
    assert found.cells == (up, down) and found.strength > 20.0
    assert np.abs(tables.speeds).max() <= 150.0
    # frames are moved by nearly the speed that the pair of cells shows
    off = tables.speeds[tables.rows[:, 0]] - tables.rows[:, 1] * tables.speed_per_cell
    assert np.abs(off).max() <= np.diff(tables.speeds).max()


def test_a_speed_just_beyond_the_allowed_is_one_by_its_error():
    """By 1 m/s: with a standard deviation of 2 m/s it may be the return's, with 0.05 m/s not."""
    parts, track = started(150, 150, 37)
    for sigma, allowed in ((2.0, True), (0.05, False)):
        beyond = parts.tables.max_speed + 1.0
        found = replace(track.latest, speed_m_per_s=beyond, speed_variance_m2_per_s2=sigma**2)
        assert bool(parts.gate.allowed_speed(found)) is allowed
        least, most = parts.integrity.open_cells(track, found)
        assert (least <= 0 <= most) is allowed


def test_a_doppler_of_the_other_sign_within_its_error_is_no_exchange_of_i_and_q():
    parts, track, scan, found = level_track(11)
    slope, _ = track.speed_by_altitudes(1e-3, track.latest.altitude_variance_m2)
    track.doppler_m_per_s = -slope
    assert parts.integrity.undisputed(track, scan, found)


def test_a_track_stays_with_the_pair_of_most_power_while_a_lobe_wins_the_votes():
    """A network leaves two ends of a sweep: the lobe of one half, 20 m off, passes for 35 m/s where 150 are allowed."""
    parts = parts_of()
    ratio = exponential(34)
    ratio[:, 0, 150] = 6.0
    ratio[::4, 1, 150] = 50.0  # twice the lobe's power, in a quarter of the frames: fewer votes
    ratio[:, 1, 154] = 5.0
    block = Block(parts.tables, ratio, np.arange(40.0))
    assert block.strongest().cells == (150, 154)
    start = block.measure(block.strongest(np.abs(parts.tables.down_cell - 150) < 2))
    scan = Scan(block, 59.5, lead_s=0.02)
    track = parts.initiator.start(scan, scan.corrected(start))
    found = parts.updater.update(track, scan)
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


def test_a_return_that_fades_does_not_fluctuate_in_altitude_and_one_that_moves_does():
    parts, found = parts_of(), []
    for power, step in ((48.0, 0), (12.0, 2)):  # in every other frame
        shown = [showing(parts, 150 + k, 150 + k, 47, power=p) for k, p in ((0, 12.0), (step, power))]
        ratio, other = (scan.block.ratio for scan in shown)
        ratio[::2] = other[::2]
        found.append(scan_of(parts, ratio).block.best())
    assert found[0].fluctuation_m2 < 0.1 * found[1].fluctuation_m2


def test_the_deviation_of_a_shape_is_a_mean_over_the_blocks():
    """A second return three cells behind the ground in every block."""
    (parts, track), shown = started(150, 150, 42), []
    for k in range(20):
        ratio = showing(parts, 150, 150, 60 + k).block.ratio
        ratio[:, :, 153] += 8.0
        scan = scan_of(parts, ratio, 59.5 + 40.0 * k)
        shown.append(scan.block.shape_deviation(parts.updater.update(track, scan)))
    assert 0.0 < min(shown) < track.deviation < max(shown)


@pytest.mark.parametrize("lobe", [0.0, 0.9])
def test_doppler_counts_once_no_grating_lobe_can_pass_for_it(lobe):
    """Two resolution cells from the return in one half sweep: the deviation of the speed is 1.8 m/s without it."""
    parts = parts_of()
    ratio = showing(parts, 150, 150, 44).block.ratio
    ratio[:, 1, 155:162] += lobe * ratio[:, 1, 147:154]
    scan = scan_of(parts, ratio)
    track = parts.initiator.start(scan, scan.corrected(scan.block.best()))
    assert parts.updater.update(track, scan_of(parts, ratio, 59.5))
    assert bool(np.sqrt(track.filter.covariance[1, 1]) > 50.0) is (lobe > 0.0)


def test_the_level_for_spread_ground_falls_by_a_tenth_per_block_that_shows_none():
    parts, track = started(150, 150, 42)
    track.edge_m = 3.0
    for k in range(3):
        ratio = showing(parts, 150, 150, 60 + k).block.ratio
        assert parts.updater.update(track, scan_of(parts, ratio, 59.5 + 40.0 * k))
        assert track.edge_m == pytest.approx(3.0 * 0.9 ** (k + 1))
    assert parts.integrity.protection_m(track) > 1.0 + 3.0 * 0.9**3
    levels = []
    for blocks in (30, 36):  # after 1.4 s without such ground the level is a point's
        track.edge_m = 3.0 * 0.9**blocks
        levels.append(parts.integrity.protection_m(track))
    assert levels[0] > levels[1] + 1.0


@pytest.mark.parametrize("doppler_m_per_s", [15.0, -15.0])
def test_a_doppler_that_the_altitudes_contradict_leaves_no_speed_open(doppler_m_per_s):
    """Thirty level altitudes of 0.1 m each: 15 m/s either way is no speed of theirs."""
    found = Measurement(500.0, doppler_m_per_s, 0.01, 0.0, 40.0, np.zeros(2), 9.0, 0)
    settings = TrackerSettings(doppler=True, acceleration_m_per_s2=0.01)
    integrity = parts_of(settings).integrity
    track = Track(Kalman(np.array([500.0, 0.0]), np.eye(2)), Evidence(2.0))
    for k in range(30):
        track.append(found, 40.0 * k)
    least, most = integrity.open_cells(track)
    assert least > most


def test_a_filter_notices_innovations_beyond_what_it_expects():
    """Innovations of three standard deviations each, within the gate, have a mean square of nine and end the track."""
    found, scan = Measurement(0.0, 0.0, 0.25, 1.0, 10.0, np.zeros(2), 1.0, 0), SimpleNamespace(ground=None)
    for sigmas in (1.0, 2.5, 3.0):
        kalman = Kalman(np.array([100.0, 0.0]), np.diag([0.1, 0.5]))
        for _ in range(120):
            kalman.predict(0.04, 1.0)
            rest, variance = kalman.innovation(found, 0.02)
            last = replace(found, altitude_m=-rest + sigmas * np.sqrt(variance))
            kalman.update(last, 0.02, with_speed=False)
        assert kalman.nis == pytest.approx(sigmas**2, rel=1e-4)
        assert parts_of().deleter.inconsistent(Track(kalman, Evidence(2.0)), scan) is (sigmas > 2.5)
