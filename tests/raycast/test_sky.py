"""How much of the sky is hidden."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from raycast import lab

from vlp16emu.raycast.caster import caster, sky_cover
from vlp16emu.types import SURFACE, Mesh, Window

AT_M = np.array([432_100.0, 6_901_234.0, 87.0])


def roof(_key):
    """A disc of radius 1 m, level."""
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    rim = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(400)])
    corners_m = np.concatenate([np.zeros((1, 3)), rim]).astype("f4")
    faces = np.column_stack([np.zeros(400), 1 + np.arange(400), 1 + (np.arange(400) + 1) % 400])
    return (Mesh(corners_m, faces.astype("u4")),)


def under(radius_m, height_m, workers):
    """Scene with a disc right over a point."""
    transform = np.column_stack([np.diag([radius_m, radius_m, 1.0]), AT_M + [0.0, 0.0, height_m]])[None]
    window = Window(AT_M, ("roof",), np.zeros(1, "i4"), transform, np.zeros(1, "u4"), np.zeros(1, SURFACE))
    return caster(lab.world(roof), workers).open(window)


@pytest.mark.parametrize("height_m", [2.0, 5.0, 10.0, 30.0])
def test_a_disc_overhead_hides_its_solid_angle(workers, height_m):
    """A disc of 10 m hides the share of the sky above 15 degrees that its cone fills, within a ring of rays."""
    cover = sky_cover(under(10.0, height_m, workers), 0, AT_M, 15.0, 100.0)
    lowest = math.sin(math.radians(15.0))
    share = (1 - height_m / math.hypot(height_m, 10.0)) / (1 - lowest)
    assert cover == pytest.approx(min(share, 1.0), abs=1 / 16)


def test_half_a_sky(workers):
    """A wide roof whose edge is overhead hides half of it, whatever the direction of the edge."""
    scene = under(80.0, 1.0, workers)
    for angle in np.radians(range(0, 360, 40)):
        edge_m = AT_M + 80.0 * np.array([math.cos(angle), math.sin(angle), 0.0])
        assert sky_cover(scene, 0, edge_m, 15.0, 100.0) == pytest.approx(0.5, abs=0.04)


def test_what_is_low_or_far_does_not_count(workers):
    """A roof below the lowest elevation, below the antenna or out of reach hides nothing."""
    scene = under(10.0, 5.0, workers)
    assert sky_cover(scene, 0, AT_M + [35.0, 0.0, 0.0], 15.0, 100.0) == 0.0
    assert sky_cover(scene, 0, AT_M + [35.0, 0.0, 0.0], 1.0, 100.0) > 0.0
    assert sky_cover(scene, 0, AT_M + [0.0, 0.0, 6.0], 15.0, 100.0) == 0.0
    assert sky_cover(scene, 0, AT_M, 15.0, 4.9) == 0.0


def test_crowns_overhead_hide_as_much_as_their_leaves_do(workers):
    """In the wood the share of the sky that is hidden is that of leaf by leaf within 0.02 in the mean, and no crown is built for it."""
    x_m, y_m = (place.ravel() for place in np.meshgrid(*2 * [np.arange(2.0, 20.0, 4.0)]))
    places_m = np.column_stack([x_m, y_m, lab.Tiles().height_m(x_m, y_m) + 1.7])
    scenes = [caster(lab.Tiles(near_m, per_tile=16), workers) for near_m in (20.0, math.inf)]
    window = lab.Tiles(20.0, per_tile=16).window(places_m)
    near, leaves = (each.open(window) for each in scenes)
    covers = [[sky_cover(scene, 0, at_m, 15.0, 60.0) for at_m in places_m] for scene in (near, leaves)]
    assert 0.1 < np.mean(covers[1]) < 0.6
    assert np.mean(covers[0]) == pytest.approx(np.mean(covers[1]), abs=0.02)
    assert not near._near.steep


def test_the_sky_is_that_of_its_instant():
    """What sways is looked at where it is at the time that is asked for."""
    asked = []

    class Still:
        """A scene of nothing that keeps the times of its rays."""

        def cast(self, rays, _near_m, _far_m, *, as_far):
            assert as_far
            asked.append(rays.t_ns)
            return SimpleNamespace(range_m=np.full(rays.t_ns.size, np.inf))

    assert sky_cover(Still(), 1_234, AT_M, 15.0, 100.0) == 0.0
    assert (asked[0] == 1_234).all()
