#!/usr/bin/env python3
"""Your own beam table: a sensor with 32 lasers, denser around the horizon, for `points`.

A package that declares it as an entry point of the group `vlp16emu.sensors` makes it available to all
scene files and commands.

tools/examples/own_sensor.py [SECONDS]
"""

import sys
from typing import Literal

from vlp16emu import Emulator, write_points
from vlp16emu.extras.free_sensor import FreeSensor


class Dense32(FreeSensor):
    """A sensor without packets.

    Lasers in firing order: every third of a degree from -4 to 2, coarser beyond.
    """

    model: Literal["dense-32"]
    elevations_deg: tuple[float, ...] = (
        -25,
        -19,
        -15,
        -11,
        -8,
        -6,
        -5,
        *(i / 3 for i in range(-12, 7)),
        3,
        5,
        7,
        10,
        12,
        15,
    )
    azimuth_resolution_deg: float = 0.1


if __name__ == "__main__":
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0
    cloud = write_points(
        Emulator("static_bench", {"sensor": {"model": "dense-32"}}), "dense.ply", duration_s=seconds
    )
    print(cloud.points, "points in dense.ply")
