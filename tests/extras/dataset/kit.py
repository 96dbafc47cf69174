"""A small dataset: eight walks of a quarter of a second in halls."""

from vlp16emu.extras.dataset import load_spec, walks_of

SPEC = """
schema = 1
layout = "semantickitti"
seeds = [1, 2]
stands = [
    { name = "a", scene = "static_bench", set = ["duration_s=0.25"] },
    { name = "b", scene = "static_bench", set = ["duration_s=0.25", "world.width_m=20.0"] },
]
paths = [{ name = "middle" }]
sensors = [{ name = "puck" }, { name = "four", set = ["sensor.model=free", "sensor.beams=4"] }]
splits = { train = 0.5, val = 0.0, test = 0.5 }
"""
PUCK_ALONE = SPEC.replace(', { name = "four", set = ["sensor.model=free", "sensor.beams=4"] }', "")


def spec_file(folder, text=SPEC):
    path = folder / "spec.toml"
    path.write_text(text)
    return path


def walks_in(folder, text=SPEC):
    return walks_of(load_spec(spec_file(folder, text)), folder)
