"""The path editor of the page: requests of its panel, and a way point that a real browser drags."""

import re
import tomllib
from threading import Event

import numpy as np
import pytest
from extras.viewer.kit import places_of

pytest.importorskip("viser", reason="the extra viewer is not installed")

from vlp16emu import Emulator
from vlp16emu.cli.app import run
from vlp16emu.errors import TrajectoryError
from vlp16emu.extras.survey import survey
from vlp16emu.extras.viewer.draft import Draft
from vlp16emu.extras.viewer.editor import Editor, OpenScene
from vlp16emu.extras.viewer.page import guarded_server, scene_page
from vlp16emu.scenario import load

SCENE = """# mine
schema = 1
duration_s = 0.3
[beam]
model = "none"
[motion]
kind = "walk"  # on foot
way_points_m = [[-6, 0], [0, 1], [6, 4]]
[world]
kind = "hall"
length_m = 30.0
width_m = 18.0
height_m = 6.0
"""


@pytest.fixture
def opened(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(SCENE)
    return OpenScene(file, (), load(file), (file,), tmp_path / "new.toml")


@pytest.fixture
def shown():
    """Emulators that a preview has shown."""
    return []


@pytest.fixture
def editor(server, opened, shown):
    def show(other):
        shown.append(other)
        return survey(other.scenario, 20.0, other.parts)

    emulator = Emulator(opened.scenario)
    return Editor(server, opened, emulator, survey(opened.scenario, 20.0, emulator.parts), show)


def ask(editor, *requests):
    """Do what the editor's thread does with requests that come together."""
    for request in requests:
        editor._execute(request)
    editor._show()


def way_points_of(editor):
    return [list(one[:2]) for one in editor._versions.draft.way_points]


def test_a_drag_is_one_change(editor):
    """While a way point is dragged its length follows, and one undo takes it back."""
    before = editor._text.content
    ask(editor, *(lambda y_m=y_m: editor._drag(2, 6.0, y_m, is_end=False) for y_m in (-1.0, -4.0)))
    assert editor._text.content != before
    assert way_points_of(editor)[2] == [6.0, 4.0]
    ask(editor, lambda: editor._drag(2, 6.0, -5.0, is_end=True))
    assert way_points_of(editor)[2] == [6.0, -5.0]
    assert editor._gizmos[2].position.tolist() == pytest.approx([6.0, -5.0, 0.3])
    ask(editor, lambda: editor._versions.step(-1))
    assert way_points_of(editor)[2] == [6.0, 4.0]
    assert editor._text.content.split("stand and sweeps")[0] == before.split("stand and sweeps")[0]


def test_the_panel_changes_the_draft_and_follows_it(editor):
    """Stop, speed, run time, loop and laps of the panel are those of the draft, and undo sets the panel."""
    ask(editor, lambda: editor._drag(2, 2.0, 6.0, is_end=True))
    editor._pause.value, editor._speed.value, editor._loop.value, editor._laps.value = 4.0, 0.7, True, 2
    ask(editor, editor._read_panel)
    draft = editor._versions.draft
    assert (draft.way_points[2].pause_s, draft.speed_m_s, draft.is_loop, draft.laps) == (4.0, 0.7, True, 2)
    assert "3 way points" in editor._text.content
    editor._time.value = 200.0
    ask(editor, editor._read_panel)
    assert "in 200.0 s" in editor._text.content
    ask(editor, lambda: editor._versions.step(-9))
    assert (editor._pause.value, editor._speed.value) == (0.0, 1.2)
    assert (editor._loop.value, editor._time.value) == (False, 0.0)


def test_what_is_saved_can_be_undone(editor, opened):
    """The saved scene has the path; after an undo it is as before, and saving again writes that."""
    ask(editor, editor._insert_after, editor._save)
    assert len(tomllib.loads(opened.to.read_text())["motion"]["way_points_m"]) == 4
    assert f"Saved as {opened.to}" in editor._text.content
    ask(editor, lambda: editor._versions.step(-1))
    assert "not saved" in editor._text.content
    ask(editor, editor._save)
    assert opened.to.read_text() == SCENE


def test_a_path_that_nobody_can_walk_is_not_saved(editor, opened):
    """The page says why in a line, and writes no file."""
    ask(editor, lambda: editor._drag(2, -6.0, 0.001, is_end=True), editor._save)
    assert "nobody can walk this" in editor._text.content
    assert "turns with a radius" in editor._note
    assert not opened.to.exists()


def test_a_preview_grows_the_new_path(editor, shown):
    """The emulator of the preview goes along the new path to its end, also if less of it is recorded."""
    grown, place = Event(), [8.0, -5.0]
    take = editor._adopt_stand
    editor._adopt_stand = lambda *result: (take(*result), grown.set())
    ask(editor, lambda: editor._drag(2, *place, is_end=True), editor._begin_preview)
    assert grown.wait(60)
    (emulator,) = shown
    motion, scenario = emulator.parts.motion, emulator.scenario
    assert scenario.duration_s > 10.0
    end_ns = scenario.start_ns + int(1e9 * motion.run_time_s)
    np.testing.assert_allclose(motion.poses_at(np.array([end_ns])).world_p_body_m[0, :2], place, atol=0.1)


def test_a_client_may_send_anything(editor):
    """Numbers that no control has, and words, change nothing or give the least."""
    before = way_points_of(editor)
    editor._speed.value, editor._pause.value, editor._laps.value = float("nan"), -5.0, 1e300
    ask(editor, editor._read_panel)
    draft = editor._versions.draft
    assert (draft.speed_m_s, draft.way_points[0].pause_s, draft.laps) == (0.1, 0.0, 1000)
    editor._speed._impl.value = "fast"  # as a message sets it
    requests = (
        editor._read_panel,
        lambda: editor._press({}, "explode"),
        lambda: editor._drag(99, 1.0, 1.0, is_end=True),
        lambda: editor._drag(0, float("nan"), 1.0, is_end=True),
        lambda: editor._drag(0, 1e9, 1.0, is_end=True),
        lambda: editor._click_dot(10**6),
        lambda: editor._choose(10**9),
    )
    ask(editor, *requests)
    assert way_points_of(editor) == before


def test_many_way_points_have_few_arrows(editor):
    """Of 100 way points the chosen one alone has arrows, and each has a ball to choose it."""
    draft = editor._versions.draft
    angle = np.linspace(0, 12, 100)
    rows = [draft.way_points[0]._replace(x_m=float(a), y_m=float(np.sin(a))) for a in angle]
    ask(editor, lambda: editor._versions.change(Draft(tuple(rows), 1.2, None, 1, back_and_forth=False)))
    assert (len(editor._gizmos), len(editor._balls.batched_positions)) == (1, 100)
    ask(editor, lambda: editor._choose(60))
    np.testing.assert_allclose(editor._gizmos[0].position[:2], rows[60][:2])
    ask(editor, lambda: editor._drag(editor._first_gizmo, 3.0, 5.0, is_end=True))
    assert way_points_of(editor)[60] == [3.0, 5.0]
    ask(editor, editor._simplify)
    assert len(editor._gizmos) == len(editor._versions.draft.way_points) < 24


def test_a_track_that_nobody_can_walk_is_opened_simpler(server, opened):
    """A noisy track is opened with fewer way points, and undo brings back all of them with the fault."""
    rng = np.random.default_rng(5)
    noisy = np.column_stack([np.linspace(-8, 8, 60), np.zeros(60)]) + rng.normal(0, 0.3, (60, 2))
    scenario = load(opened.scenario, {"motion.way_points_m": noisy.tolist()})
    opened = OpenScene(opened.file, (), scenario, (), None)
    with pytest.raises(TrajectoryError, match="turns with a radius") as fault:
        Emulator(scenario)
    emulator = Emulator(opened.walkable(fault.value))
    editor = Editor(server, opened, emulator, survey(emulator.scenario, 20.0, emulator.parts), lambda _: None)
    assert "Nobody can walk through all 60 way points" in editor._note
    assert "start with --save FILE.toml" in editor._text.content
    ask(editor, lambda: editor._versions.step(-1))
    assert "turns with a radius" in editor._text.content
    assert len(editor._versions.draft.way_points) == 60


def test_a_scene_without_a_walk_is_only_shown():
    """The page of a static sensor has no path to edit, and says so."""
    with guarded_server("127.0.0.1", 0) as server:
        emulator = Emulator("static_bench")
        scene_page(server, emulator, OpenScene("static_bench", (), emulator.scenario, (), None), 1, 25.0)
        assert server.scene.get_handle_by_name("/draft") is None
        texts = [getattr(handle, "content", "") for handle in server.gui._gui_input_handle_from_uuid.values()]
        assert not any("way points" in str(text) for text in texts)


def arrow(r, g, b):
    return (r < 130) & (g > 200) & (abs(b - 140) < 30)


def test_a_way_point_is_dragged_saved_and_recorded(in_browser, tmp_path):
    """A way point that the mouse drags is in the saved file; the truth of its recording begins there."""
    scene, out = tmp_path / "mine.toml", tmp_path / "new.toml"
    scene.write_text(SCENE)
    _, page = in_browser("view", scene, "--save", out, "--port", "0")
    text = page.locator("b", has_text=re.compile(r"m in .* s$"))
    text.wait_for()
    before = text.text_content()
    arrows = places_of(page, arrow, 100)
    lowest = arrows[arrows[:, 0] > arrows[:, 0].max() - 8]  # of the nearest way point, the first
    y, x = (lowest[lowest[:, 1].argmin()] + [0, 4]).tolist()
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 50, y, steps=8)
    page.get_by_text(before).wait_for(state="detached")  # while it is dragged
    page.mouse.up()
    page.get_by_text("not saved").wait_for()
    page.get_by_role("button", name="save").click()
    page.get_by_text("Saved as").wait_for()
    (x_m, y_m), *rest = tomllib.loads(out.read_text())["motion"]["way_points_m"]
    assert rest == [[0, 1], [6, 4]]
    assert abs(x_m + 6.0) < 0.5
    assert 0.5 < y_m < 8.0
    assert run(["record", str(out), str(tmp_path / "walk.pcap"), "--truth", str(tmp_path / "truth")]) == 0
    place_m = np.loadtxt(tmp_path / "truth" / "trajectory.tum")[0, 1:3]
    np.testing.assert_allclose(place_m, [x_m, y_m], atol=0.2)
