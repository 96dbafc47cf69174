"""The public face: what `import vlp16emu` offers, and how soon."""

import subprocess
import sys
import textwrap

import pytest

import vlp16emu

SCRIPT = """
from vlp16emu import Emulator, load, decode, verify
emulator = Emulator("birch_walk", {"sensor.rpm": 1200, "seed": 7, "sensor.max_range_m": 15.0, "world.stems_per_ha": 50})
for scan in emulator.scans(duration_s=0.2, truth=True):
    print(scan.xyz_m.shape == (len(scan.t_ns), 3), len(scan.ring) == len(scan.reflectivity) == len(scan.labels.part),
          scan.world_T_sensor.shape)
recording = emulator.record("walk.pcap", duration_s=0.2)
streamed = emulator.stream(to="127.0.0.1", duration_s=0.02)
for scan in decode("walk.pcap"):
    print(len(scan.xyz_m) > 1000)
verification = verify("walk.pcap")
print(verification.is_clean, verification.findings, verification.data_packets == recording.packets)
print(streamed.packets, load("birch_walk").seed)
"""


def run(code, folder=None):
    """Standard output of a program of its own."""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=folder
    )
    return done.stdout


def test_nothing_heavy_is_loaded_with_the_package():
    """`import vlp16emu` loads no library, and its names are there all the same."""
    code = """
    import sys
    import vlp16emu
    heavy = {"numpy", "numba", "pydantic", "scipy", "dpkt", "typer", "vlp16emu.emulator", "vlp16emu.scenario"}
    print(sorted(heavy & set(sys.modules)), set(vlp16emu.__all__) <= set(dir(vlp16emu)))
    """
    assert run(textwrap.dedent(code)) == "[] True\n"


def test_a_scene_is_read_without_the_engine():
    """`load` brings no numba."""
    code = "import sys; from vlp16emu import load; load('static_bench'); print('numba' in sys.modules)"
    assert run(code) == "False\n"


@pytest.mark.parametrize("name", vlp16emu.__all__)
def test_each_public_name_is_what_its_module_has(name):
    """A name is loaded when it is used, once, and has a docstring."""
    assert getattr(vlp16emu, name) is getattr(vlp16emu, name)
    assert getattr(vlp16emu, name).__doc__


def test_another_name_is_none_of_ours():
    """What is not offered is an AttributeError that names it."""
    with pytest.raises(AttributeError, match="module 'vlp16emu' has no attribute 'nothing'"):
        _ = vlp16emu.nothing


def test_the_script_runs_as_it_is_printed(tmp_path):
    """Scans, a recording, a stream, decoding and the lint in a dozen lines."""
    lines = run(SCRIPT, tmp_path).splitlines()
    assert lines[:4] == ["True True (4, 4)"] * 4
    assert lines[4:-2] == ["True"] * 3
    assert lines[-2:] == ["True () True", "15 16"]
