#!/usr/bin/env python3
"""2. Read a capture, emulated or from a real sensor: one scan for each revolution, points as arrays.

tools/examples/2_read.py [FILE.pcap]
"""

import sys

from vlp16emu import decode

for number, scan in enumerate(decode(sys.argv[1] if len(sys.argv) > 1 else "bench.pcap")):
    top = scan.xyz_m[scan.ring == 15]  # points of the highest beam; x forward, y left, z up
    print(
        f"scan {number}: {len(scan.xyz_m)} points, nearest {scan.distance_m.min():.2f} m, top "
        f"{top[:, 2].max():.2f} m"
    )
