"""A section drawn against a wall whose place is known."""

import numpy as np
import pytest

from vlp16emu.extras.sheets.sheet import StandSection, draw_section, strip_along
from vlp16emu.types import NO_SURFACE, Hits

PAPER = np.array([252, 251, 248])
COLOURS = np.array([[200, 40, 20], [20, 40, 200]], np.uint8)
SECTION = StandSection(np.array([5.0, -3.0]), np.array([0.6, 0.8]), 10.0, 4.0, -1.0, 5.0)


class Wall:
    """A wall right across the strip, `into_m` behind its middle line, red up to 2 m and blue up to 4 m."""

    def __init__(self, into_m):
        self.into_m = into_m

    def cast(self, firings, near_m, far_m):
        """Cast as casters do."""
        _, into_m = SECTION.coordinates(firings.origin_m[..., :2].reshape(-1, 2))
        range_m = self.into_m - into_m.reshape(firings.t_ns.shape)
        z_m = firings.origin_m[..., 2]
        assert np.allclose(firings.direction, [-0.8, 0.6, 0.0])
        hit = (z_m < 4) & (range_m < far_m) & (range_m > near_m)
        surface = np.where(hit, (z_m > 2).astype(np.uint32), NO_SURFACE).astype(np.uint32)
        return Hits.one_ray_each(np.where(hit, range_m, np.inf).astype(np.float32), surface, hit.astype(np.float32))


def draw(into_m, overhang_m=3.0, ground_m=0.0):
    return draw_section(Wall(into_m), SECTION, overhang_m, COLOURS, lambda x, _: np.full_like(x, ground_m), 10.0)


def test_what_stands_there_is_drawn_at_its_height_in_its_colour():
    """Ten pixels per metre: soil below the ground, then red, then blue, then paper, from bottom to top."""
    picture = draw(-2.0)
    assert picture.shape == (60, 100, 3)
    column = picture[::-1, 50].astype(int)
    assert (column[5] == [196, 178, 150]).all()
    assert (column[15] == COLOURS[0]).all()
    assert (column[35] == COLOURS[1]).all()
    assert (column[55] == PAPER).all()
    assert (picture == picture[:, :1]).all()


def test_distance_pales_and_the_overhang_is_seen():
    """Colours fade with distance up to the strip's far side; a wall 2 m before the strip is seen with 3 m of overhang, not with none."""
    near, far, beyond = (draw(into_m)[40, 0].astype(int) for into_m in (-2.0, 2.0, 4.0))
    assert far == pytest.approx(0.45 * near + 0.55 * PAPER, abs=1)
    assert (beyond == far).all()
    assert (draw(-4.0)[40, 0] == COLOURS[0]).all()
    assert (draw(-4.0, overhang_m=0.0)[40, 0] == PAPER).all()


def test_ground_hides_what_lies_below_it():
    """Where the cut runs at 3 m, soil reaches up to 3 m."""
    column = draw(-2.0, ground_m=3.0)[::-1, 0].astype(int)
    assert (column[39] == [196, 178, 150]).all()
    assert (column[45] == COLOURS[1]).all()


def test_a_strip_follows_the_beginning_of_a_way():
    """The strip begins a little before the way, points along it and holds its beginning."""
    s = np.linspace(0, 300, 301)
    way = np.column_stack([0.6 * s, 0.8 * s, np.full(301, 2.0)])
    strip = strip_along(way, 60.0, 10.0)
    assert strip.along == pytest.approx([0.6, 0.8])
    assert strip.length_m == 60.0
    along_m, into_m = strip.coordinates(way[:, :2])
    assert along_m[0] == pytest.approx(3.6, abs=0.5)
    assert into_m == pytest.approx(0.0, abs=1e-9)
    assert strip.holds(way[:, :2], 0.0).sum() == 57


def test_a_strip_of_a_loop_or_of_a_place_is_one_too():
    """A way that comes back has a strip across it, a short one a strip about its middle, a place one to the east."""
    turn = np.linspace(0, 2 * np.pi, 100)
    loop = np.column_stack([10 * np.cos(turn), 10 * np.sin(turn), np.zeros(100)])
    assert strip_along(loop, 60.0, 10.0).along == pytest.approx([-1.0, 0.0], abs=0.05)
    short = strip_along(np.array([[0.0, 0.0, 1.0], [0.0, 10.0, 1.0]]), 60.0, 10.0)
    assert short.coordinates(np.array([[0.0, 5.0]]))[0] == pytest.approx(30.0)
    stands = strip_along(np.array([[7.0, 2.0, 1.0]]), 60.0, 10.0)
    assert stands.along.tolist() == [1.0, 0.0]
    assert stands.start_xy_m.tolist() == [-23.0, 2.0]
