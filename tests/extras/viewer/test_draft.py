"""A walk that is drawn: changes, versions, and the keys of the scene that it changes."""

from dataclasses import replace

import numpy as np
import pytest

from vlp16emu.errors import InputError
from vlp16emu.extras.viewer.draft import Draft, Versions, WayPoint, plan_of
from vlp16emu.foliage.polyline import distance_m
from vlp16emu.scenario import load

HALL = {"kind": "hall", "length_m": 30.0, "width_m": 18.0, "height_m": 6.0}


def scenario_of(**motion):
    return load({"schema": 1, "motion": {"kind": "walk", **motion}, "world": HALL})


def draft_of(*places):
    return Draft(tuple(WayPoint(*place) for place in places), 1.2, None, 1, back_and_forth=False)


SQUARE = draft_of((0.0, 0.0), (4.0, 0.0, 2.0), (4.0, 4.0), (0.0, 4.0))
LOOP = SQUARE.set_loop(is_loop=True)


def test_a_way_point_takes_its_stop_with_it():
    """A moved way point is on whole millimetres, keeps its stop, and no other one changes."""
    moved = SQUARE.move(1, 5.00049, -1.0)
    assert moved.way_points == (WayPoint(0, 0), WayPoint(5.0, -1.0, 2.0), WayPoint(4, 4), WayPoint(0, 4))
    assert SQUARE.set_stop(1, 0.0).way_points[1].pause_s == 0.0


def test_an_inserted_way_point_goes_into_its_leg():
    """A place on the curve becomes a way point between its neighbours, also in the last leg of a loop."""
    inserted, number = SQUARE.insert(4.1, 2.0)
    assert (number, inserted.way_points[2]) == (2, WayPoint(4.1, 2.0))
    inserted, number = LOOP.insert(-0.1, 2.0)
    assert number == 4
    assert inserted.is_loop


@pytest.mark.parametrize("number", [0, 1, 4])
def test_a_loop_stays_closed(number):
    """First and last way point of a loop move together, and the loop closes again if one is deleted."""
    moved = LOOP.move(number, -2.0, 1.0)
    assert moved.is_loop
    removed = LOOP.remove(number)
    assert removed.is_loop
    assert len(removed.way_points) == 4


def test_a_loop_is_opened_again():
    """Closing adds a way point on the first, opening removes it and the laps; two way points cannot close."""
    assert LOOP.way_points == (*SQUARE.way_points, WayPoint(0.0, 0.0))
    assert replace(LOOP, laps=3).set_loop(is_loop=False) == SQUARE
    two = draft_of((0, 0), (4, 0))
    assert two.set_loop(is_loop=True) == two


def test_two_way_points_are_left():
    """Two way points of a path, and three of a loop, cannot be deleted."""
    two = SQUARE.remove(3).remove(2)
    assert len(two.way_points) == 2
    assert two.remove(0) == two
    three = LOOP.remove(2)
    assert three.remove(1) == three


def test_changes_are_undone_and_redone():
    """Each change is one step back and forward; a change after an undo drops what was undone."""
    versions = Versions(SQUARE)
    second = SQUARE.move(0, 1.0, 1.0)
    third = second.remove(3)
    for draft in (second, second, third):
        versions.change(draft)
    versions.step(-1)
    assert versions.draft == second
    versions.step(-5)
    assert versions.draft == versions.first == SQUARE
    versions.step(9)
    assert versions.draft == third
    versions.step(-1)
    versions.change(LOOP)
    versions.step(1)
    assert versions.draft == LOOP


def test_fewer_way_points_keep_the_curve():
    """The curve through fewer of 100 way points passes all within the tolerance; stops and ends stay."""
    angle = np.linspace(0, 12, 100)
    draft = draft_of(*np.column_stack([2 * angle, 4 * np.sin(angle)]).tolist()).set_stop(41, 3.0)
    simple = draft.simplify(0.2)
    assert 8 < len(simple.way_points) < 40
    assert {draft.way_points[0], draft.way_points[41], draft.way_points[99]} <= set(simple.way_points)
    assert distance_m(draft.xy_m, plan_of(simple.xy_m).xy_m).max() < 0.2
    assert simple.simplify(0.2).xy_m.tolist() == simple.xy_m.tolist()
    assert SQUARE.simplify(0.01) == SQUARE


def test_a_round_of_many_way_points_stays_a_loop():
    """A loop of 100 way points is a loop with fewer."""
    angle = np.linspace(0, 2 * np.pi, 101)
    circle_m = np.column_stack([9 * np.cos(angle), 9 * np.sin(angle)])
    simple = draft_of(*circle_m.round(3).tolist()).simplify(0.1)
    assert simple.is_loop
    assert len(simple.way_points) < 20


def test_the_way_there_and_back_on_one_road_stays():
    """Way points of the way back are not taken for those of the way there, at the same places."""
    there = [(float(x), 0.0) for x in range(20)]
    draft = draft_of(*there, (22.0, 2.0), (19.0, 2.5), *((x, 0.1) for x, _ in reversed(there[:15])))
    assert max(draft.simplify(0.3).xy_m[:, 0]) == 22.0
    assert draft.simplify(0.3).way_points[-1] == WayPoint(0.0, 0.1)


def test_an_unchanged_draft_changes_no_key():
    """The draft of a scene has its way points and stops; only what is changed becomes a key."""
    stops = [{"way_point": 2, "pause_s": 3.0}, {"at_m": 1.0, "pause_s": 1.0}]
    walk = {"run_time_s": 20.0, "laps": 2, "back_and_forth": True}
    scenario = scenario_of(way_points_m=[[0, 0], [5, 1]], stops=stops, **walk)
    first = Draft.of(scenario)
    assert [one.pause_s for one in first.way_points] == [0.0, 3.0]
    assert first.settings(first, scenario.motion) == {}
    faster = replace(first.set_stop(1, 0.0), run_time_s=None, speed_m_s=0.8)
    assert faster.settings(first, scenario.motion) == {
        "motion.way_points_m": [[0.0, 0.0], [5.0, 1.0]],
        "motion.stops": [{"at_m": 1.0, "pause_s": 1.0}],
        "motion.speed_m_s": 0.8,
    }
    changed = load(scenario, faster.settings(first, scenario.motion))
    assert (changed.motion.run_time_s, changed.motion.speed_m_s) == (None, 0.8)
    assert Draft.of(changed) == faster


def test_the_track_of_a_phone_is_opened(tmp_path):
    """The way points of a GPX file are those of the draft; the file is no longer named when one has moved."""
    points = "".join(f'<trkpt lat="{62.24 + 2e-5 * i}" lon="25.75"/>' for i in range(4))
    (tmp_path / "phone.gpx").write_text(f"<gpx><trk><trkseg>{points}</trkseg></trk></gpx>")
    scenario = scenario_of(way_points_file=str(tmp_path / "phone.gpx"))
    first = Draft.of(scenario)
    np.testing.assert_allclose(first.xy_m[:, 1], 2.23 * np.arange(4), atol=0.02)
    moved = load(scenario, first.move(3, 2.0, 7.0).settings(first, scenario.motion))
    assert moved.motion.way_points_file is None
    assert Draft.of(moved).way_points[3] == WayPoint(2.0, 7.0)


def test_a_scene_without_a_walk_has_no_draft():
    """A static sensor has no path to draw, in one line."""
    with pytest.raises(InputError, match=r"motion.kind: found static; expected walk"):
        Draft.of(load("static_bench"))
