"""Windows of a live run belong to cubes of the world, follow from the places of the body, and serve it."""

from types import SimpleNamespace

import numpy as np
import pytest

from vlp16emu import Emulator
from vlp16emu.engine import Batching
from vlp16emu.extras.live import windows
from vlp16emu.extras.live.flown import FLOWN_HEADER, FlownMotion, flown_rows
from vlp16emu.extras.live.knots import STATE, STEP_NS, Knots
from vlp16emu.extras.live.windows import Cube, CubeWindows
from vlp16emu.foliage.polyline import distance_m
from vlp16emu.units import S_NS

START_NS = 1_779_267_600_000_000_000
PARTS = Batching(16, 55_296, 20)
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
        return CubeWindows(parts, START_NS, PARTS, 1, motion)

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


def test_the_next_window_is_asked_for_seconds_before_its_use(windows_of):
    """The window of the cube that the body enters is opened at once, and used 4 s later, or at 3 m/s 2 s."""
    for speed_m_s, least_s in ((1.0, 3.9), (3.0, 1.9)):
        of = windows_of(Knots(START_NS, states_at((speed_m_s, 0.0, 0.0), 40.0)))
        asked = []
        of._future_of = asked.append
        entered = used = None
        for block in range(300):
            of.open_ahead(block * PARTS.parts, 10**6)
            if entered is None and asked[-1][0].x == 1:
                entered = block
            if used is None and of.name_of(block * PARTS.parts)[0].x == 1:
                used = block
        assert (used - entered) * BLOCK_NS / S_NS == pytest.approx(least_s + 0.1, abs=0.4)


def test_a_body_that_jumps_has_the_window_of_its_place(windows_of):
    """Three blocks after a jump of 100 m, the window is that of the cube where the body is."""
    states = states_at((0.0, 0.0, 0.0), 10.0)
    jump = 20 * 30
    states[jump:, :3] += (100.0, -40.0, 10.0)
    of = windows_of(Knots(START_NS, states))
    assert of.name_of(29 * PARTS.parts)[0] == Cube(0, 0, 0)
    assert of.name_of(33 * PARTS.parts)[0] == Cube(6, -3, 0)


def test_parts_of_a_block_have_its_window_and_sway_its_time(windows_of):
    """A window changes at whole blocks of 0.1 s; if trees sway, also every 64 of these."""
    motion = Knots(START_NS, states_at((4.0, 2.0, 0.0), 30.0))
    of = windows_of(motion)
    for block in range(200):
        assert len({of.name_of(block * PARTS.parts + part) for part in (0, 7, 19)}) == 1
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
    ground_m = Emulator("birch_walk").parts.ground_m(np.array([x_m]), np.array([y_m]))
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


@pytest.mark.usefixtures("kept_woods")
def test_a_body_may_leave_the_region_of_its_path(tmp_path):
    """Half a kilometre from its path a flight sees, to the last bit, the forest of a path 100 m away."""
    live = '{{kind="live",flown="{flown}",path_m=%s}}'
    place_m = (400.0, -300.0)
    off_m = flight_ranges_m(tmp_path, place_m, live % "[[0,0]]")
    near_m = flight_ranges_m(tmp_path, place_m, live % "[[400,-200],[300,-300]]")
    assert off_m.tobytes() == near_m.tobytes()
    assert (off_m > 0.0).mean() > 0.5
