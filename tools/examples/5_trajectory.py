#!/usr/bin/env python3
"""5. Move the sensor along your own trajectory: poses in TUM format, here a rising helix in the hall.

tools/examples/5_trajectory.py [SECONDS]
"""

import sys
from pathlib import Path

import numpy as np

from vlp16emu import Emulator

seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 5.0
t_s = np.arange(0.0, seconds + 0.1, 0.05)
yaw_rad = 0.5 * t_s
poses = np.zeros((len(t_s), 8))  # t x y z qx qy qz qw
poses[:, 0] = t_s
poses[:, 1:4] = np.column_stack([3 * np.sin(yaw_rad), -3 * np.cos(yaw_rad), 1.0 + 0.1 * t_s])
poses[:, 6:] = np.column_stack([np.sin(yaw_rad / 2), np.cos(yaw_rad / 2)])
np.savetxt("helix.tum", poses, fmt="%.9f")

motion = {"kind": "recorded", "format": "tum", "file": str(Path("helix.tum").absolute())}
emulator = Emulator("static_bench", {"motion": motion})
for scan in emulator.scans(duration_s=seconds):
    x_m, y_m, z_m = scan.world_T_sensor[:3, 3]
    print(f"{len(scan.xyz_m)} points from ({x_m:.2f}, {y_m:.2f}, {z_m:.2f}) m")
