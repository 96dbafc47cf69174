#!/usr/bin/env python3
"""7. Score a trajectory against the ground truth of a run.

Here the estimate is the ground truth with 5 cm of noise.

tools/examples/7_score.py [SECONDS]
"""

import sys

import numpy as np

from vlp16emu import Emulator, write_truth
from vlp16emu.cli.app import run

seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 20.0
emulator = Emulator(
    "birch_walk", {"gps.canopy_loss": False}
)  # else the trees above the antenna must grow first
write_truth(emulator, "truth", duration_s=seconds)  # no pulse is cast for it
poses = np.loadtxt("truth/trajectory.tum")[::20]  # t x y z qx qy qz qw, ten a second
poses[:, 1:4] += np.random.default_rng(1).normal(scale=0.05, size=(len(poses), 3))
np.savetxt("estimate.tum", poses, fmt="%.9f")
sys.exit(run(["score", "truth", "--trajectory", "estimate.tum", "--align", "se3", "--require", "ate_m<0.1"]))
