#!/usr/bin/env python3
"""8. Make a training dataset: each stand with each seed, labelled, with a manifest and splits.

tools/examples/8_dataset.py [SECONDS]
"""

import json
import sys
from pathlib import Path

from vlp16emu.extras.dataset import load_spec, make_dataset, walks_of

seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 5.0
spec = Path("spec.toml")
spec.write_text(f"""\
schema = 1
layout = "semantickitti"
seeds = [1, 2]
stands = [{{ name = "hall", scene = "static_bench", set = ["duration_s={seconds}"] }}]
paths = [
    {{ name = "low", set = ["motion.height_m=1.0"] }},
    {{ name = "high", set = ["motion.height_m=2.0"] }},
]
sensors = [{{ name = "puck" }}]
splits = {{ train = 1.0, val = 0.0, test = 0.0 }}
""")
result = make_dataset(walks_of(load_spec(spec), Path.cwd()), Path("dataset"), workers=0)
manifest = json.loads(Path("dataset/manifest.json").read_text())
print(result.walks, "walks:", ", ".join(walk["folder"] for walk in manifest["walks"]))
