#!/usr/bin/env python3
"""1. Record a scene into a capture, with its ground truth, and check it against the rules of VLP-16 traffic.

tools/examples/1_record.py [SECONDS]
"""

import sys

from vlp16emu import Emulator, verify

seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 10.0
emulator = Emulator("static_bench", {"seed": 7})  # any scene of `vlp16emu scenes`, or a file of your own
recording = emulator.record("bench.pcap", duration_s=seconds, truth="truth")
print("sha256", recording.sha256)  # the same scene and seed give the same bytes everywhere
print("clean", verify("bench.pcap").is_clean)
