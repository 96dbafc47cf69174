"""What a drawn walk leads to: the same as its recording, and what is in its way."""

from dataclasses import replace

import numpy as np
import pytest

from vlp16emu import Emulator
from vlp16emu.errors import InputError
from vlp16emu.extras.survey import survey
from vlp16emu.extras.viewer.draft import Draft
from vlp16emu.extras.viewer.outlook import Surroundings
from vlp16emu.foliage.polyline import distance_m
from vlp16emu.forest.ground.dem import DemHeights
from vlp16emu.forest.settings import Dem
from vlp16emu.scenario import load

POLE = {"name": "pole", "foot_m": [6.0, -4.0, 0.0], "diameter_m": 0.5, "height_m": 4.0}
CEILING = {"name": "lamp", "centre_m": [-6.0, -4.0, 5.0], "size_m": [2.0, 2.0, 1.0]}
ROOM = {"kind": "hall", "length_m": 30.0, "width_m": 18.0, "height_m": 6.0}
HALL = {
    "schema": 1,
    "duration_s": 3.0,
    "beam": {"model": "none"},
    "motion": {"kind": "walk", "way_points_m": [[-6, 0], [0, 1], [6, 0]]},
    "world": ROOM | {"poles": [POLE], "boxes": [CEILING]},
}
BIRCH = {"species": "silver_birch", "share": 1.0, "dbh_cm": 18.0, "height_m": 19.0}
FOREST = HALL | {
    "sensor": {"max_range_m": 15.0},
    "motion": {"kind": "walk", "way_points_m": [[0, 0], [6, 1]]},
    "world": {"kind": "forest", "stems_per_ha": 900, "species": [BIRCH], "stones": {"cover": 0.02}},
}


def around(scene):
    emulator = Emulator(scene)
    seen = survey(emulator.scenario, 10.0, emulator.parts)
    return Surroundings(emulator.scenario, emulator.parts.units, seen), Draft.of(emulator.scenario), seen


@pytest.fixture(scope="module")
def hall():
    return around(HALL)


@pytest.fixture(scope="module")
def forest():
    return around(FOREST)


def test_the_outlook_is_that_of_the_recording(hall, tmp_path):
    """Run time, duration, revolutions and packets are those of a recording with the new path."""
    surroundings, draft, _ = hall
    draft = replace(draft.move(2, 1.0, 1.5), run_time_s=None, speed_m_s=10.0)
    outlook = surroundings.outlook(draft)
    emulator = Emulator(load(HALL, surroundings.settings(draft)))
    assert emulator.parts.motion.run_time_s == outlook.run_time_s
    assert emulator.scenario.duration_s == outlook.recorded_s == 3.0
    short = surroundings.outlook(replace(draft, is_whole=True))
    assert outlook.run_time_s - 0.1 < short.recorded_s <= outlook.run_time_s
    (sent,) = emulator.record(tmp_path / "walk.pcap").units
    assert (sent.packets, sent.position_packets) == (outlook.data_packets, outlook.position_packets)
    assert sent.turn.revolutions == outlook.revolutions
    steps_m = np.diff(outlook.path_m[:, :2], axis=0)
    assert outlook.length_m == pytest.approx(np.hypot(*steps_m.T).sum(), rel=1e-3)


def test_a_short_walk_shortens_the_recording(hall):
    """A walk that ends before the scene's duration is recorded to its end, so that `record` takes it."""
    surroundings, draft, _ = hall
    short = draft.move(0, -0.5, 1.0).move(2, 0.5, 1.0)
    outlook = surroundings.outlook(short)
    assert outlook.run_time_s - 0.1 < outlook.recorded_s < 3.0
    assert surroundings.settings(short)["duration_s"] == outlook.recorded_s
    assert "duration_s" not in surroundings.settings(draft)


def test_objects_of_a_hall_stay_in_the_way(hall):
    """A pole and the outside of the hall are marked where the path leads there; a lamp is in nobody's way."""
    surroundings, draft, _ = hall
    assert surroundings.outlook(draft).marks == ()
    through = surroundings.outlook(draft.move(0, -10.0, -4.0).move(1, 0.0, -4.0).move(2, 10.0, -4.0))
    (mark,) = through.marks
    assert (mark.kind, mark.words.partition(": ")[2]) == ("stays", "pole")
    np.testing.assert_allclose(through.path_m[mark.rows].mean(axis=0), [6.0, -4.0, 0.0], atol=0.5)
    out = surroundings.outlook(draft.move(2, 20.0, 0.0))
    (mark,) = out.marks
    assert "outside the walls" in mark.words
    assert (out.path_m[mark.rows, 0] >= 15.0).all()
    assert (out.path_m[~mark.rows, 0] < 15.0).all()


def test_a_turn_that_nobody_can_walk_is_marked(hall):
    """The fault is that of `record`, marked at its place; such a draft has no keys to save."""
    surroundings, draft, _ = hall
    outlook = surroundings.outlook(draft.move(2, -6.0, 0.001))
    assert "turns with a radius" in outlook.refusal
    assert outlook.length_m == 0.0
    np.testing.assert_allclose(outlook.path_m[outlook.marks[0].rows].mean(axis=0), [0.0, 1.0, 0.0], atol=0.3)
    with pytest.raises(InputError, match="turns with a radius"):
        surroundings.settings(draft.move(2, -6.0, 0.001))
    too_short = surroundings.outlook(replace(draft, run_time_s=0.5))
    assert too_short.refusal.startswith("run time: found 0.5 s")


def test_stems_and_stones_are_left_out(forest):
    """The path of a grown stand is free; a path through a stem or a stone names it, and where it is."""
    surroundings, draft, seen = forest
    assert surroundings.outlook(draft).marks == ()
    tree = seen.near[0]
    outlook = surroundings.outlook(draft.move(1, float(tree["x_m"]), float(tree["y_m"])))
    words = f"stem of silver birch, DBH {100 * tree['dbh_m']:.0f} cm"
    mark = next(mark for mark in outlook.marks if mark.words.endswith(words) and mark.rows[-1])
    assert mark.kind == "left out"
    stone = next(thing for thing in seen.things if thing.kind == "stone")
    outlook = surroundings.outlook(draft.move(1, *stone.place_m[:2].tolist()))
    assert any(mark.words.endswith(": stone") and mark.rows[-1] for mark in outlook.marks)
    assert outlook.refusal == ""


def test_the_ground_is_followed_and_its_limits_shown(forest):
    """Points are on the ground; what is farther from the grown path than the stand is marked as unknown."""
    surroundings, draft, seen = forest
    outlook = surroundings.outlook(draft.move(1, 25.0, 1.0))
    np.testing.assert_allclose(outlook.path_m[:, 2], seen.bare.height_m(*outlook.path_m[:, :2].T))
    (unknown,) = [mark for mark in outlook.marks if mark.kind == "unknown"]
    gap_m = distance_m(outlook.path_m[:, :2], seen.path_m[:, :2])
    assert unknown.rows.tolist() == (gap_m > 10.0).tolist()


@pytest.mark.parametrize(("on_conflict", "kind"), [("refuse", "refused"), ("drop", "left out")])
def test_the_stems_of_a_list_are_known_also_where_they_were_left_out(on_conflict, kind, tmp_path):
    """A listed stem in the way has the scene refused, or is left out, as the scene says."""
    (tmp_path / "stems.csv").write_text(
        "x,y,species,dbh_cm,height_m\n3,0.2,silver_birch,20,18\n3,5,silver_birch,20,18\n"
    )
    plot = {"kind": "plot", "stem_list": str(tmp_path / "stems.csv"), "on_conflict": on_conflict}
    surroundings, draft, _ = around(
        FOREST | {"world": plot, "motion": {"kind": "walk", "way_points_m": [[0, 3], [6, 3]]}}
    )
    (mark,) = surroundings.outlook(draft.move(0, 0.0, 0.0).move(1, 6.0, 0.0)).marks
    assert (mark.kind, mark.words) == (kind, "2 to 4 m: stem of silver birch, DBH 20 cm")


def test_a_path_off_the_grid_of_heights_is_marked(tmp_path):
    """Points off the grid, or with a cell without height in reach, are those that `check` refuses."""
    heights_m = np.zeros((40, 40), np.float64)
    heights_m[2, 3] = np.nan
    np.save(tmp_path / "ground.npy", heights_m)
    dem = Dem(file=str(tmp_path / "ground.npy"), cell_m=1.0, corner_m=(0.0, 0.0))
    ground = DemHeights(dem, origin_m=(0.0, 0.0, 0.0))
    xy_m = np.random.default_rng(1).uniform(-5, 45, (200, 2))

    def is_refused(point_m):
        try:
            ground.check(point_m[None], 4.0)
        except InputError:
            return True
        return False

    refused = [is_refused(point_m) for point_m in xy_m]
    assert ground.has_heights(xy_m, 4.0).tolist() == [not one for one in refused]
    assert 20 < sum(refused) < 180
