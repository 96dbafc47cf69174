"""The page in a real browser: Chromium without a screen, drawing by software."""

import re
import shutil
import subprocess
import sys
import tomllib
from contextlib import contextmanager

import imageio.v3 as imageio
import numpy as np
import pytest

from vlp16emu import Emulator

pytest.importorskip("viser", reason="the extra viewer is not installed")
sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

CHROMIUM = shutil.which("chromium")
pytestmark = [pytest.mark.skipif(CHROMIUM is None, reason="no chromium"), pytest.mark.usefixtures("kept_woods")]
SOFTWARE = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
WAIT_MS = 120_000

SCENE = """# mine
schema = 1
duration_s = 2.0
[sensor]
max_range_m = 12.0
[beam]
model = "none"
[motion]
kind = "walk"  # on foot
way_points_m = [[0, 0], [4, 0], [8, 1]]
speed_m_s = 1.2
[world]
kind = "forest"
stems_per_ha = 150
species = [{ species = "silver_birch", share = 1.0, dbh_cm = 18.0, height_m = 9.0 }]
"""


@contextmanager
def page_of(*words):
    """Page of a command when the first points are drawn."""
    command = [sys.executable, "-m", "vlp16emu", *map(str, words)]
    with (
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program,
        sync_api.sync_playwright() as playwright,
        playwright.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE) as browser,
    ):
        try:
            page = browser.new_page(viewport={"width": 900, "height": 700})
            page.goto(re.search(r"http\S+", program.stdout.readline())[0])
            page.get_by_text(re.compile("points (by|in)")).wait_for(timeout=WAIT_MS)
            yield page
        finally:
            program.terminate()


def pixels_of(page):
    """What is on the screen, (h, w, 3) RGB."""
    return imageio.imread(page.screenshot(timeout=WAIT_MS))[..., :3].astype(int)


def seen_by(page, is_there, least=20):
    """Wait until so many pixels are there, and give their rows and columns."""
    for _ in range(30):
        found = np.argwhere(is_there(*np.moveaxis(pixels_of(page), -1, 0)))
        if len(found) >= least:
            return found
    raise AssertionError(f"{len(found)} pixels, not {least}")


def arrow(r, g, b):
    return (r < 130) & (g > 200) & (abs(b - 140) < 30)


def leaf(r, g, b):
    return (g > r) & (r > b + 60) & (g > 120)


def stem(r, g, b):
    return (abs(r - b) < 12) & (abs(g - r) < 12) & (r > 90) & (r < 190)


def test_a_way_point_is_dragged_and_saved(tmp_path):
    """The page shows trees and points; a way point that the mouse drags is in the file, whose comments are kept.

    The walk goes there.
    """
    scene, out = tmp_path / "mine.toml", tmp_path / "drawn.toml"
    scene.write_text(SCENE)
    with page_of("view", scene, "--save", out, "--radius", "8", "--port", "0") as page:
        seen_by(page, stem, 1000)
        seen_by(page, leaf, 200)
        arrows = seen_by(page, arrow)
        first = arrows[arrows[:, 0] > arrows[:, 0].max() - 8]  # the nearest is lowest
        y, x = (first[first[:, 1].argmin()] + [0, 4]).tolist()
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x - 70, y, steps=8)
        page.mouse.up()
        page.get_by_text("path: 8.2 m").wait_for(state="detached", timeout=WAIT_MS)
        page.get_by_role("button", name="save").click(timeout=WAIT_MS)
        page.get_by_text("saved drawn.toml").wait_for(timeout=WAIT_MS)
    text = out.read_text()
    assert text.startswith("# mine\n")
    assert "# on foot" in text
    (x_m, y_m), *rest = tomllib.loads(text)["motion"]["way_points_m"]
    assert rest == [[4, 0], [8, 1]]
    assert abs(x_m) < 0.3
    assert 0.5 < y_m < 5.0
    walked = Emulator(out)
    start_m = walked.world_T_sensor(np.array([walked.scenario.start_ns]))[0, :2, 3]
    np.testing.assert_allclose(start_m, [x_m, y_m], atol=0.3)
