"""A path that is drawn: steps, what it leads to, and the file."""

import re
import time
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("tomlkit", reason="the extra viewer is not installed")

pytest.importorskip("viser", reason="the extra viewer is not installed")

from vlp16emu.errors import OutputError
from vlp16emu.extras.sheets.survey import survey
from vlp16emu.extras.viewer.editor import Draft, Editor
from vlp16emu.extras.viewer.guard import guarded_server
from vlp16emu.extras.viewer.stand import pieces_of
from vlp16emu.foliage.polyline import Polyline
from vlp16emu.scenario import load

SCENE = """# mine
schema = 1
duration_s = 5.0
[sensor]
max_range_m = 15.0
[motion]
kind = "walk"  # on foot
way_points_m = [[0, 0], [6, 1]]
speed_m_s = 1.2
[world]
kind = "forest"
stems_per_ha = 900  # dense
species = [{ species = "silver_birch", share = 1.0, dbh_cm = 18.0, height_m = 19.0 }]
"""


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("draft") / "mine.toml"
    path.write_text(SCENE)
    return path


@pytest.fixture(scope="module")
def seen(scene):
    return survey(load(scene), 10.0)


@pytest.fixture
def draft(scene, seen):
    return Draft(str(scene), load(scene), seen)


def test_steps_are_undone_and_done_again(draft):
    """Each change is one step back, and one forward."""
    first = draft.course
    draft.change(first.moved(1, 7.0, 3.0))
    second = draft.course.added(0)
    draft.change(second)
    assert len(second.points) == 3
    for _ in range(2):
        draft.undo()
    assert draft.course == first
    draft.undo()
    for _ in range(3):
        draft.redo()
    assert draft.course == second
    assert second.removed(1).removed(0).removed(0).points == second.removed(1).points


def test_run_time_follows_at_once(draft):
    """Twice the way takes longer; an answer comes within 0.3 s of processor time."""
    short = draft.outlook(draft.course)
    longer = draft.course.moved(1, 12.0, 2.0)
    draft.outlook(longer)
    began_s = time.process_time()
    far = draft.outlook(longer)
    assert time.process_time() - began_s < 0.3
    assert far.length_m > 1.9 * short.length_m
    assert far.run_time_s > short.run_time_s


def test_stems_in_the_way_are_those_of_the_path(draft, seen):
    """A path through a stem has that stem in its way; the first path has none."""
    assert len(draft.outlook(draft.course).in_the_way_m) == 0
    tree = seen.near[0]
    hit = draft.course.moved(1, float(tree["x_m"]), float(tree["y_m"]))
    feet_m = draft.outlook(hit).in_the_way_m
    assert np.hypot(*(feet_m[:, :2] - [tree["x_m"], tree["y_m"]]).T).min() < 1e-6


def test_a_turn_that_nobody_can_walk_is_said(draft):
    """The fault is that of `record`, and is marked at the turn."""
    back = replace(draft.course, points=((0.0, 0.0, 0.0), (6.0, 0.0, 0.0), (0.0, 0.001, 0.0)))
    outlook = draft.outlook(back)
    assert "radius" in outlook.fault
    assert outlook.path_m is None
    place_m = [float(number) for number in re.search(r"at \((.*), (.*)\) m", outlook.fault).groups()]
    np.testing.assert_allclose(outlook.fault_m[0, :2], place_m, atol=0.006)


def test_what_is_saved_is_walked_and_keeps_comments(draft, scene, tmp_path):
    """The saved scene has the user's comments, and its sensor goes along the new path."""
    from vlp16emu.engine import assemble

    course = draft.course.moved(1, -6.0, 4.0).stopped(1, 2.0)
    draft.change(replace(course, speed_m_s=0.8, gait="strong", harness=True))
    to = tmp_path / "drawn.toml"
    draft.save(to)
    text = to.read_text()
    assert all(comment in text for comment in ("# mine", "# on foot", "# dense"))
    saved = load(to)
    assert saved == draft.scenario(draft.course).model_copy(update={"title": saved.title})
    motion = assemble(saved).motion
    end_ns = saved.start_ns + int(motion.run_time_s * 1e9)
    end_m = motion.poses_at(np.array([end_ns])).world_p_body_m[0, :2]
    assert np.hypot(*(end_m - [-6.0, 4.0])) < 0.3
    with pytest.raises(OutputError, match=r"a \.toml file"):
        draft.save(tmp_path / "drawn.txt")


def test_the_panel_changes_the_path_and_follows_undo(draft):
    """Speed and stop that the panel has are the course's after a step, undo brings both back; with nothing asked there is nothing to do."""
    with guarded_server("127.0.0.1", 0, "test") as server:
        editor = Editor(server, draft, 5.0, None)
        first = draft.course
        editor._speed.value, editor._pause.value = 0.8, 2.0
        editor.ask(lambda: editor._as_in_panel(draft.course, 0))
        assert editor.wake.is_set()
        assert editor.step()
        assert (draft.course.speed_m_s, draft.course.points[0][2]) == (0.8, 2.0)
        editor.ask(draft.undo)
        editor.step()
        assert draft.course == first
        assert (editor._speed.value, editor._pause.value) == (first.speed_m_s, 0.0)
        assert not editor.step()


def test_stems_are_drawn_with_their_crowns_only(seen):
    """Of what is drawn around a path nothing stands farther off than the radius and the width of a crown: no bare stems beyond."""
    path = Polyline(seen.path_m[:, :2])
    farthest_m = [
        path.distance_m((piece.vertices_m[:, None, :2] + piece.position_m[None, :, :2]).reshape(-1, 2)).max()
        for piece in pieces_of(seen)
        if piece.name.startswith("single")
    ]
    assert farthest_m
    assert max(farthest_m) < 10.0 + 5.0
