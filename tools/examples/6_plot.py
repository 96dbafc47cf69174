#!/usr/bin/env python3
"""6. Scan your own plot: a list of measured trees and a walk along a line give labelled points.

tools/examples/6_plot.py [SECONDS]
"""

import sys
from pathlib import Path

from vlp16emu import Emulator, write_points

seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 5.0
Path("stems.csv").write_text("""\
x_m,y_m,species,dbh_cm,height_m
6.0,2.5,Betula pendula,21,19
9.5,-3.0,Picea abies,34,27
14.0,3.5,Pinus sylvestris,28,22
17.5,-2.0,Picea abies,18,16
""")
scene = {
    "schema": 1,
    "title": "my plot",
    "motion": {"kind": "walk", "way_points_m": [[0, 0], [20, 0]]},
    "world": {"kind": "plot", "stem_list": "stems.csv", "terrain": {"relief": "flat"}},
}
cloud = write_points(Emulator(scene), "plot.ply", duration_s=seconds, truth=True)
print(cloud.points, "points in plot.ply")
