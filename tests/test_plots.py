"""The common style of plots."""

import io

import numpy as np
import pytest

from vlp16emu.extras.plots import BACK, plotted

mpl = pytest.importorskip("matplotlib", reason="the extra picture is not installed")
Image = pytest.importorskip("PIL.Image", reason="the extra picture is not installed")


@pytest.mark.parametrize("few_colours", [None, 16])
def test_a_plot_has_its_size_and_the_background_and_leaves_the_settings_of_matplotlib(few_colours):
    """A figure has the pixels that were asked for, corners of the common background, and settings hold for it alone."""
    before = dict(mpl.rcParams)
    file = io.BytesIO()
    with plotted(file, (320, 200), few_colours=few_colours) as figure:
        figure.subplots().plot([0, 1], [0, 1])
    pixels = np.asarray(Image.open(file).convert("RGB"))
    assert pixels.shape == (200, 320, 3)
    assert tuple(pixels[0, 0]) == tuple(bytes.fromhex(BACK[1:]))
    assert dict(mpl.rcParams) == before
