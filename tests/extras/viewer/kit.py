"""What a page in the browser looks like."""

import imageio.v3 as imageio
import numpy as np

LOOKS = 30  # a second or more each, as the drawing is by software


def places_of(page, is_there, least):
    """Rows and columns (n, 2) of the pixels of some colours, once there are at least so many."""
    for _ in range(LOOKS):
        pixels = imageio.imread(page.screenshot())[..., :3].astype(int)
        places = np.argwhere(is_there(*np.moveaxis(pixels, -1, 0)))
        if len(places) >= least:
            return places
    raise AssertionError(f"{len(places)} pixels, not {least}")
