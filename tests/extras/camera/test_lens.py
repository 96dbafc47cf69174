"""The lens beside formulas of others."""

import math

import numpy as np
import pytest

from vlp16emu.errors import InputError
from vlp16emu.extras.camera.lens import Lens
from vlp16emu.extras.camera.settings import Camera

EUROC = {
    "focal_px": (458.654, 457.296),
    "principal_px": (367.215, 248.375),
    "width_px": 752,
    "height_px": 480,
}
BENT = (-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05, 0.005)
"""Camera 0 of the EuRoC data set (Burri et al., IJRR 2016), with a third radial coefficient of our own."""


def opencv(lens: Lens, xyz) -> list[float]:
    """Pixel of a point, word by word from OpenCV's page "Camera Calibration and 3D Reconstruction"."""
    k1, k2, p1, p2, k3 = lens.distortion
    x, y = xyz[0] / xyz[2], xyz[1] / xyz[2]
    r = math.hypot(x, y)
    radial = 1 + k1 * r**2 + k2 * r**4 + k3 * r**6
    x2 = x * radial + 2 * p1 * x * y + p2 * (r**2 + 2 * x**2)
    y2 = y * radial + p1 * (r**2 + 2 * y**2) + 2 * p2 * x * y
    return [lens.fx * x2 + lens.cx, lens.fy * y2 + lens.cy]


def test_distortion_is_the_one_of_opencv():
    """Points project to the pixels of OpenCV's documented formula, all five coefficients included."""
    strong = Lens.of(Camera(**EUROC, distortion=(-0.28, 0.07, 0.003, -0.002, -0.01)))
    points_m = np.array([[0.4, -0.3, 1.0], [-2.0, 1.1, 4.0], [0.1, 0.7, 2.5], [0.0, 0.0, 3.0]])
    np.testing.assert_allclose(
        strong.project(points_m), [opencv(strong, point) for point in points_m], atol=1e-10
    )


@pytest.mark.parametrize("distortion", [(0.0,) * 5, BENT, (0.1, -0.05, 0.001, 0.001, 0.0)])
def test_rays_end_at_their_pixels(distortion):
    """Rays through places of the image, corners included, are unit vectors that project back there."""
    lens = Lens.of(Camera(**EUROC, distortion=distortion))
    columns, rows = (
        of.ravel() for of in np.meshgrid(np.linspace(-0.5, 751.5, 40), np.linspace(-0.5, 479.5, 30))
    )
    rays = lens.rays(columns, rows)
    np.testing.assert_allclose(lens.project(rays), np.column_stack([columns, rows]), atol=1e-8)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0, atol=1e-12)


def test_the_field_of_view_reaches_the_outer_edges():
    """Rays through the outer edges of the first and last column are the field of view apart."""
    lens = Lens.of(Camera(width_px=640, height_px=480, hfov_deg=70.0))
    left, right = lens.rays(np.array([-0.5, 639.5]), np.array([239.5, 239.5]))
    assert np.degrees(np.arccos(left @ right)) == pytest.approx(70.0, abs=1e-9)
    assert (lens.cx, lens.cy) == (319.5, 239.5)


@pytest.mark.parametrize("distortion", [(-2.0, 0.0, 0.0, 0.0, 0.0), (100.0,) * 5])
def test_a_distortion_that_folds_the_image_is_refused(distortion):
    """A lens that maps two rays to one place is named with its key."""
    lens = Lens.of(Camera(distortion=distortion))
    with pytest.raises(
        InputError, match=r"camera.distortion: found .*; expected a distortion that maps no two rays"
    ):
        lens.rays(np.array([0.0, 600.0]), np.array([0.0, 470.0]))
