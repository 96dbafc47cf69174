"""Windows of a live run belong to cubes of the world, follow from the places of the body, and serve it."""

import gc
import math
import threading
import weakref
from concurrent.futures import Future, ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest

from vlp16emu import Emulator
from vlp16emu.engine import Batching
from vlp16emu.engine.windows import STEP_NS
from vlp16emu.extras.live import windows
from vlp16emu.extras.live.flown import FLOWN_HEADER, FlownMotion, flown_rows
from vlp16emu.extras.live.knots import STATE, Knots
from vlp16emu.extras.live.windows import Builders, Course, Cube, CubeWindows, LiveWindows, Openers
from vlp16emu.foliage.polyline import distance_m
from vlp16emu.units import S_NS

START_NS = 1_779_267_600_000_000_000
PARTS = Batching(16, 55_296, 40)
BLOCK_NS = PARTS.parts * PARTS.block_ns


def table(path, states):
    path.write_text(FLOWN_HEADER + flown_rows(0, states))
    return path


def states_at(velocity_m_s, duration_s, *, begin_m=(0.0, 0.0, 1.5)):
    """Knots (n, 13) of a level body with a velocity."""
    states = np.zeros((round(duration_s * S_NS / STEP_NS), STATE))
    states[:, 6] = 1.0
    states[:, 7:10] = velocity_m_s
    states[:, :3] = np.array(begin_m) + np.arange(len(states))[:, None] * STEP_NS / S_NS * states[:, 7:10]
    return states


@pytest.fixture
def windows_of(monkeypatch):
    """Windows of a motion in a world that is never opened."""
    monkeypatch.setattr(windows, "caster", lambda *_: None)
    unit = SimpleNamespace(mount=SimpleNamespace(lever_arm_m=(0.0, 0.0, 0.0)))

    def of(motion, wind=None):
        parts = SimpleNamespace(world=None, units=[unit], wind=wind)
        return CubeWindows(parts, START_NS, PARTS, 1, motion, builders=ThreadPoolExecutor(1))

    return of


def names_of(of, states, blocks):
    return [of.name_of(block * PARTS.parts) for block in range(blocks)]


@pytest.mark.parametrize("speed_m_s", [0.5, 1.2, 3.0, 6.0, 15.0])
def test_a_window_serves_the_body_for_the_whole_block(windows_of, speed_m_s):
    """Up to 15 m/s the body is within the margin of its cube from the beginning of each block to its end."""
    velocity_m_s = speed_m_s * np.array([0.8, -0.6, 0.0])
    states = states_at(velocity_m_s, 60.0)
    of = windows_of(Knots(START_NS, states))
    changes = set()
    for block in range(500):
        cube, _ = of.name_of(block * PARTS.parts)
        changes.add(cube)
        for t_s in np.array([block, block + 1]) * BLOCK_NS / S_NS:
            place_m = np.array([0.0, 0.0, 1.5]) + t_s * velocity_m_s
            assert (np.abs(place_m - 16.0 * (np.array(cube) + 0.5)) <= 16.0).all()
    assert len(changes) > speed_m_s


@pytest.fixture
def asked(monkeypatch):
    """Names of the windows that are asked for, in order; each is open at once, but not those in `slow`."""
    names = SimpleNamespace(all=[], slow=set())
    futures = {}

    def future_of(name):
        names.all.append(name)
        future = futures.setdefault(name, Future())
        future.done = lambda: name not in names.slow
        return future

    names.watch = lambda of: monkeypatch.setattr(of, "_future_of", future_of)
    return names


def circle(speed_m_s, radius_m, duration_s):
    """Knots (n, 13) of a level body on a circle around the origin, counter-clockwise."""
    states = states_at((0.0, 0.0, 0.0), duration_s)
    angle = np.arange(len(states)) * STEP_NS / S_NS * speed_m_s / radius_m
    states[:, 0] = radius_m * np.cos(angle)
    states[:, 1] = radius_m * np.sin(angle)
    states[:, 7] = -speed_m_s * np.sin(angle)
    states[:, 8] = speed_m_s * np.cos(angle)
    return states


FLIGHTS = {
    "1 m/s": states_at((1.0, 0.0, 0.0), 60.0),
    "3 m/s": states_at((-2.4, 1.8, 0.0), 60.0),
    "8 m/s": states_at((6.4, 4.8, 0.2), 60.0),
    "a circle": circle(3.0, 12.0, 60.0),
}


@pytest.mark.parametrize(
    ("flight", "least_s"), [("1 m/s", 5.4), ("3 m/s", 5.4), ("a circle", 5.4), ("8 m/s", 3.4)]
)
def test_a_window_is_asked_for_seconds_before_its_use(windows_of, asked, flight, least_s):
    """Windows are asked for 6 s before their use, and later if more of them lie ahead than are kept."""
    of = windows_of(Knots(START_NS, FLIGHTS[flight]))
    asked.watch(of)
    first_s = {}
    used_s = {}
    for block in range(450):
        at_s = block * BLOCK_NS / S_NS
        used_s.setdefault(of.name_of(block * PARTS.parts), at_s)
        of.open_ahead(block * PARTS.parts, 10**6)
        for name in asked.all:
            first_s.setdefault(name, at_s)
    later = [name for name, at_s in used_s.items() if at_s > 8.0]
    assert len(later) >= 2
    assert min(used_s[name] - first_s[name] for name in later) > least_s


@pytest.mark.parametrize("wind", [None, object()], ids=["calm", "wind"])
@pytest.mark.parametrize("states", FLIGHTS.values(), ids=FLIGHTS)
def test_a_body_that_flies_on_needs_the_windows_that_are_expected(windows_of, states, wind):
    """On a straight line and on a circle, the expected windows are those of the blocks to come, in order."""
    of = windows_of(Knots(START_NS, states), wind=wind)
    for block in range(60, 300, 7):
        to_come = [of.name_of((block + further) * PARTS.parts) for further in range(58)]
        assert set(of.expected(block * PARTS.parts, 10**6)) <= set(to_come)
        assert of.expected(block * PARTS.parts, 10**6)[0] == to_come[0]


def test_a_turning_course_is_an_arc_of_its_circle():
    """Displacements of a course at 3 m/s and a quarter turn per second are those of the circle."""
    turn_rad_s = math.pi / 2
    course = Course(np.zeros(3), np.array([3.0, 0.0, 0.5]), turn_rad_s)
    radius_m = 3.0 / turn_rad_s
    quarters = np.array([0, 1, 2, 4]) * S_NS
    expected_m = [[0, 0, 0], [radius_m, radius_m, 0.5], [0, 2 * radius_m, 1.0], [0, 0, 2.0]]
    assert course.onwards_m(quarters) == pytest.approx(np.array(expected_m), abs=1e-12)
    straight = Course(np.zeros(3), np.array([3.0, 0.0, 0.5]), 0.0)
    assert straight.onwards_m(quarters)[3] == pytest.approx([12.0, 0.0, 2.0])


def test_one_window_is_opened_ahead_at_a_time(windows_of, asked):
    """While a window opens no other one is asked for, so the one in need waits for one at most."""
    of = windows_of(Knots(START_NS, FLIGHTS["8 m/s"]))
    expected = of.expected(200 * PARTS.parts, 10**6)
    asked.slow.add(expected[1])
    asked.watch(of)
    of.open_ahead(200 * PARTS.parts, 10**6)
    assert len(expected) > 3
    assert asked.all == expected[:2]


def test_no_window_is_opened_for_after_the_end(windows_of):
    """Three seconds before the end of a run only the windows of these seconds are expected."""
    of = windows_of(Knots(START_NS, FLIGHTS["8 m/s"]))
    end = 228 * PARTS.parts
    last = of.expected(200 * PARTS.parts, end)
    assert last == of.expected(200 * PARTS.parts, 10**6)[: len(last)]
    assert set(last) <= {of.name_of(block) for block in range(200 * PARTS.parts, end, PARTS.parts)}
    assert of.expected(end - 1, end) == [of.name_of(end - 1)]


def test_a_body_that_jumps_has_the_window_of_its_place(windows_of):
    """Three blocks after a jump of 100 m, the window is that of the cube where the body is."""
    states = states_at((0.0, 0.0, 0.0), 10.0)
    jump = PARTS.parts * 30
    states[jump:, :3] += (100.0, -40.0, 10.0)
    of = windows_of(Knots(START_NS, states))
    assert of.name_of(29 * PARTS.parts)[0] == Cube(0, 0, 0)
    assert of.name_of(33 * PARTS.parts)[0] == Cube(6, -3, 0)


def test_parts_of_a_block_have_its_window_and_sway_its_time(windows_of):
    """A window changes at whole blocks of 0.1 s; if trees sway, also every 64 of these."""
    motion = Knots(START_NS, states_at((4.0, 2.0, 0.0), 30.0))
    of = windows_of(motion)
    for block in range(200):
        assert len({of.name_of(block * PARTS.parts + part) for part in (0, 7, 39)}) == 1
        assert of.name_of(block * PARTS.parts)[1] == 0
    swaying = windows_of(motion, wind=object())
    assert [swaying.name_of(block * PARTS.parts)[1] for block in (0, 63, 64, 130)] == [0, 0, 1, 2]


def test_a_recorded_flight_has_the_windows_of_the_flight(windows_of, tmp_path):
    """A motion whose knots come one by one has the windows of the table of these knots."""
    rng = np.random.default_rng(3)
    states = states_at((0.0, 0.0, 0.0), 40.0)
    states[:, 7:10] = np.cumsum(rng.normal(0.0, 0.15, (len(states), 3)), axis=0)
    states[:, :3] += np.cumsum(states[:, 7:10], axis=0) * STEP_NS / S_NS
    growing = Knots(START_NS, states[:2])
    live = windows_of(growing)
    names = []
    for block in range(300):
        while growing.last_ns < block * BLOCK_NS - 150_000_000:  # later knots do not exist yet
            growing.append(states[growing.last + 1])
        names.append(live.name_of(block * PARTS.parts))
    flown = FlownMotion(table(tmp_path / "flown.csv", states), start_ns=START_NS)
    again = windows_of(flown)
    assert [again.name_of(block * PARTS.parts) for block in range(300)] == names
    assert len(set(names)) > 5


def test_a_window_is_opened_for_its_whole_cube_and_the_margin():
    """With a lever arm too, places are within 1 m of the track on the map, and no lower or higher than it."""
    rng = np.random.default_rng(1)
    track_m = Cube(-2, 1, 0).track_m(0.5)
    places_m = np.array([-24.0, 24.0, 8.0]) + rng.uniform(-16.5, 16.5, (2000, 3))
    assert distance_m(places_m[:, :2], track_m[:, :2]).max() <= 1.0
    assert track_m[:, 2].min() == -8.5
    assert track_m[:, 2].max() == 24.5


def flight_ranges_m(folder, place_m, motion):
    """Ranges of the first sequences of a body at rest over a place of a forest, live or of another motion."""
    settings = ["beam.model=none", "noise.preset=ideal", "world.near_m=6", "sensor.max_range_m=20"]
    x_m, y_m = place_m
    ground_m = Emulator("birch_walk", settings).parts.ground_m(np.array([x_m]), np.array([y_m]))
    begin_m = (x_m, y_m, float(ground_m[0]) + 1.5)
    flown = table(folder / "flown.csv", states_at((0.0, 0.0, 0.0), 0.5, begin_m=begin_m))
    row = ",".join(map(repr, begin_m))
    rows = [f"{0.1 * number:.1f},{row},0,0,0,1\n" for number in range(5)]
    poses = folder / "poses.csv"
    poses.write_text("t_s,x_m,y_m,z_m,qx,qy,qz,qw\n" + "".join(rows))
    emulator = Emulator("birch_walk", [*settings, f"motion={motion.format(flown=flown, poses=poses)}"])
    return next(emulator.returns(0.0, 0.005)).distance_m[:96, :, 0]


@pytest.mark.usefixtures("kept_woods")
def test_a_body_sees_what_one_on_a_known_path_sees(tmp_path):
    """In a forest the ranges of a flight are those of recorded poses to 0.1 mm, near and far."""
    live_m = flight_ranges_m(tmp_path, (0.0, 0.0), '{{kind="live",flown="{flown}"}}')
    known_m = flight_ranges_m(tmp_path, (0.0, 0.0), '{{kind="recorded",file="{poses}",format="csv"}}')
    assert (np.abs(live_m - known_m) < 1e-4).mean() > 0.999
    assert ((live_m > 0.0) & (live_m < 6.0)).mean() > 0.2
    assert (live_m > 6.0).mean() > 0.1


@pytest.mark.usefixtures("kept_woods")
def test_a_body_may_leave_the_region_of_its_path(tmp_path):
    """Half a kilometre from its path a flight sees, to the last bit, the forest of a path 100 m away."""
    live = '{{kind="live",flown="{flown}",path_m=%s}}'
    place_m = (400.0, -300.0)
    off_m = flight_ranges_m(tmp_path, place_m, live % "[[0,0]]")
    near_m = flight_ranges_m(tmp_path, place_m, live % "[[400,-200],[300,-300]]")
    assert off_m.tobytes() == near_m.tobytes()
    assert (off_m > 0.0).mean() > 0.5


@pytest.mark.usefixtures("kept_woods")
def test_windows_opened_before_change_no_byte(tmp_path):
    """Ranges in a window are the same to the last bit if other windows, or it, were opened long before."""
    begin_m = (-3.0, 5.0, 2.0)
    flown = table(tmp_path / "flown.csv", states_at((0.0, 0.0, 0.0), 0.5, begin_m=begin_m))
    settings = ["beam.model=none", "noise.preset=ideal", "world.near_m=6", "sensor.max_range_m=20"]
    ranges = []
    for before in ((), ((0, 0, 0), (-1, -1, 0)), ((-1, 0, 0), (-2, 0, 0), (0, 0, 0))):
        emulator = Emulator("birch_walk", [*settings, f'motion={{kind="live",flown="{flown}"}}'])
        for cube in before:
            emulator.engine.windows._future_of((Cube(*cube), 0)).result()
        ranges.append(next(emulator.returns(0.0, 0.005)).distance_m.tobytes())
    assert len(set(ranges)) == 1


@pytest.fixture
def live_windows(monkeypatch):
    """Windows of a live run in a world that is never opened, and the motion that they follow."""
    monkeypatch.setattr(windows, "caster", lambda *_: None)
    unit = SimpleNamespace(mount=SimpleNamespace(lever_arm_m=(0.0, 0.0, 0.0)))
    parts = SimpleNamespace(world=None, units=[unit], wind=None)
    states = states_at((0.0, 0.0, 0.0), 1.0, begin_m=(15.0, 0.0, 1.5))
    live = Knots(START_NS, states)
    live.elapsed_ns = 0
    live.poses = SimpleNamespace(last=SimpleNamespace(state=states_at((3.0, 0.0, 0.0), 1.0)[0]))
    return LiveWindows(parts, START_NS, PARTS, 1, live), live


def test_late_steps_are_taken_together(live_windows, asked):
    """Each of two threads takes half of the late steps, none across a block of 0.1 s; more are left out."""
    of, live = live_windows
    asked.watch(of)
    steps = of.runs(range(37, 1000), 1, 2)
    taken = []
    for late in (0, 1, 2, 4, 12, 13, 0):
        at = taken[-1].stop if taken else 37
        live.elapsed_ns = (at + late) * PARTS.block_ns
        taken.append(next(steps))
    # 40 begins a block; after the fifth, 13 steps are left out.
    assert [(run.start, run.stop) for run in taken] == [
        (37, 38), (38, 39), (39, 40), (40, 42), (42, 48), (61, 62), (62, 63),
    ]  # fmt: skip
    assert of.left_out == of.in_blocks_of(Batching(32, 46_080, 40)).left_out == 13


def test_the_windows_of_the_first_seconds_are_opened_before_the_start(live_windows, asked):
    """They are those of the last pose and of its way at its speed, though the body rests before its knots."""
    of, live = live_windows
    live.poses.last.state[:3] = 15.0, 0.0, 1.5
    asked.slow.add((Cube(1, 0, 0), 0))
    asked.watch(of)
    assert of.missing() is not None
    assert asked.all == [(Cube(0, 0, 0), 0), (Cube(1, 0, 0), 0)]
    asked.slow.clear()
    assert of.missing() is None


def test_opening_gets_less_of_the_processor_once_the_body_flies(live_windows, monkeypatch):
    """Threads that open windows have the priority of others before the first pulse, and a lower one after."""
    openers = live_windows[0].openers
    lowered = []
    monkeypatch.setattr(windows, "lower_priority", lowered.append)
    openers.prepare_thread()
    assert not lowered
    openers.begin()
    assert lowered == [threading.get_native_id()]
    openers.prepare_thread()
    openers.begin()
    assert len(lowered) == 2


@pytest.fixture
def late(monkeypatch):
    """Openers of a run by a clock of the test, in ns since the first pulse, which naps advance."""
    clock = SimpleNamespace(now_ns=0, naps=0, at_nap=lambda _: None)
    openers = Openers(lambda: clock.now_ns)

    def sleep(duration_s):
        clock.now_ns += round(duration_s * S_NS)
        clock.naps += 1
        clock.at_nap(openers)

    by_clock = SimpleNamespace(monotonic=lambda: clock.now_ns / S_NS, sleep=sleep)
    monkeypatch.setattr(windows, "time", by_clock)
    return openers, clock


def opened():
    window = Future()
    window.set_result(None)
    return window


def test_opening_gives_way_to_late_steps(late):
    """A part of a window waits until the late step has begun, and not at all while steps are in time."""
    openers, clock = late
    openers.give_way()  # before the first step
    window = opened()
    openers.goes_on(50_000_000, window)
    openers.give_way()
    assert clock.naps == 0
    clock.now_ns = 60_000_000
    clock.at_nap = lambda of: of.goes_on(80_000_000, window) if clock.naps == 3 else None
    openers.give_way()
    assert clock.naps == 3


def test_opening_goes_on_if_all_steps_are_late(late):
    """On a machine that is late on the whole, each part of a window waits for 50 ms at most."""
    openers, clock = late
    window = opened()
    openers.goes_on(0, window)
    clock.now_ns = begun_ns = 10 * S_NS
    openers.give_way()
    assert 0 < clock.now_ns - begun_ns <= 52_000_000


def test_opening_does_not_give_way_to_steps_that_wait_for_it(late):
    """Steps whose window is not open yet are late because of it: opening goes on at once."""
    openers, clock = late
    window = Future()
    openers.goes_on(0, window)
    clock.now_ns = 10 * S_NS
    openers.give_way()
    assert clock.naps == 0


def test_each_part_of_a_window_gives_way(late, monkeypatch):
    """Parts that are submitted or mapped give way first, each once, and have their results."""
    openers, _ = late
    given = []
    monkeypatch.setattr(openers, "give_way", lambda: given.append(threading.current_thread().name))
    with Builders(openers) as builders:
        assert builders.submit(divmod, 7, 2).result() == (3, 1)
        assert list(builders.map(abs, [-1, 2, -3])) == [1, 2, 3]
    assert given == ["build_0"] * 4


def test_steps_tell_openers_when_the_next_one_shall_begin(live_windows, asked):
    """Opening is in the way if two steps more than usual have passed since the last step was begun."""
    of, live = live_windows
    asked.watch(of)
    steps = of.runs(range(40, 1000), 1, 2)
    live.elapsed_ns = 37 * PARTS.block_ns  # two threads work, and a third step waits
    next(steps)
    live.elapsed_ns = 39 * PARTS.block_ns
    assert not of.openers.is_in_the_way
    live.elapsed_ns += 1
    assert of.openers.is_in_the_way
    live.elapsed_ns = 38 * PARTS.block_ns
    next(steps)
    assert not of.openers.is_in_the_way


def test_openers_keep_no_window(late):
    """The threads of a run live as long as its windows, which nothing keeps after the run."""
    openers, clock = late
    window = opened()
    kept = weakref.ref(window)
    openers.goes_on(0, window)
    clock.now_ns = 10 * S_NS
    assert openers.is_in_the_way
    del window
    gc.collect()
    assert kept() is None
    assert not openers.is_in_the_way
