#!/usr/bin/env python3
"""4. Get labels with the points: the class of the surface, and the plant, of each point.

tools/examples/4_labels.py [SECONDS]
"""

import sys
from collections import Counter

import numpy as np

from vlp16emu import Emulator
from vlp16emu.types import Semantic

seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0
classes, trees = Counter(), set()
settings = {"beam.model": "none", "sensor.max_range_m": 10.0}  # one ray per pulse, and few trees to grow
for scan in Emulator("birch_walk", settings).scans(duration_s=seconds, truth=True):
    numbers, counts = np.unique(scan.labels.semantic, return_counts=True)
    classes.update(
        {Semantic(number).name.lower(): count for number, count in zip(numbers, counts.tolist(), strict=True)}
    )
    trees |= set(scan.labels.instance[scan.labels.semantic == Semantic.TREE].tolist())
print(dict(classes))
print(len(trees), "trees and saplings seen")
