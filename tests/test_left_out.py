"""What a scene does not ask for is not done: not computed, not held, not imported."""

import json
import subprocess
import sys

import numpy as np
import pytest
from kit import set_words
from woods import LINES

import vlp16emu.engine.engine as page
from vlp16emu import Emulator
from vlp16emu.engine.windows import window_of
from vlp16emu.extras.walk import gait, motion, pack
from vlp16emu.foliage.far import FarCaster
from vlp16emu.forest.plants.stem import StemKey
from vlp16emu.raycast import near as fast
from vlp16emu.returns import detect as detection
from vlp16emu.scenario import Scenario, load, schema
from vlp16emu.world.hall import HallWorld

SPAN_S = 0.05  # less than one block


class TouchedError(AssertionError):
    """Something was done that should have been left out."""


def touched(*_arguments, **_options):
    """Stand for a function that must not be called."""
    raise TouchedError


def forbid(monkeypatch, *places):
    """Let (owner, name) pairs raise when they are called."""
    for owner, name in places:
        monkeypatch.setattr(owner, name, touched)


def first(*settings, scene="static_bench", truth=False):
    """Returns of the first blocks of a scene that are cast together."""
    return next(Emulator(load(scene, settings), threads=1).engine.returns(0.0, SPAN_S, truth=truth))


def birch(*settings):
    """Scene of a walk with little around it."""
    return load("birch_walk", [*LINES, *settings])


def test_a_beam_without_width_has_no_footprint(monkeypatch):
    """Without width no axis across the beam is made and no sub-ray laid or cast; with it both are."""
    axes = []
    monkeypatch.setattr(page, "add_texture", lambda firings, *_: axes.append(firings.beam_axis))
    first()
    first("beam.model=adaptive")
    assert axes[0] is None
    assert axes[-1].shape[1:] == (16, 3)
    forbid(monkeypatch, (fast.EmbreeGeometry, "pulses"), (fast, "beam_axis_of"))
    first()
    with pytest.raises(TouchedError):
        first("beam.model=adaptive")


def depends_on_seed(*settings):
    """Whether returns of the hall are others with another seed."""
    one, other = (
        Emulator(load("static_bench", [*settings, f"seed={seed}"]), threads=1).returns(0.0, 0.1)
        for seed in (1, 2)
    )
    return any(
        getattr(a, name).tobytes() != getattr(b, name).tobytes()
        for a, b in zip(one, other, strict=True)
        for name in ("distance_m", "reflectivity")
    )


def test_without_noise_nothing_is_drawn():
    """An ideal sensor in clear air has returns that no random number changes; noise and rain make them
    random."""
    assert not depends_on_seed()
    for setting in ("noise.range_noise_m=0.01", "weather.rain_mm_h=5"):
        assert depends_on_seed(setting), setting


def test_without_truth_nobody_looks_for_surfaces(monkeypatch):
    """Without truth there is neither an array of surfaces nor the work of filling it."""
    forbid(monkeypatch, (detection, "find_source_surfaces"))
    returns = first()
    assert returns.surface is None
    assert returns.surfaces is None
    with pytest.raises(TouchedError):
        first(truth=True)


def test_a_static_sensor_has_one_pose_and_one_window(monkeypatch):
    """A sensor that stands has one pose, made once, and one window however long the run; a walk has more."""
    opened, window = [], HallWorld.window
    monkeypatch.setattr(
        HallWorld, "window", lambda self, track_m: opened.append(len(track_m)) or window(self, track_m)
    )
    emulator = Emulator(load("static_bench"), threads=1)
    motion, t_ns = emulator.parts.motion, np.arange(1000, dtype=np.int64)
    assert motion.poses_at(t_ns) is motion.poses_at(t_ns + 10**12)
    assert len(motion.poses_at(t_ns).t_ns) == 1
    for start_s in (0.0, 7.0, 3000.0):
        next(emulator.returns(start_s, start_s + SPAN_S))
    assert opened == [1]
    assert len(Emulator(birch(), threads=1).parts.motion.poses_at(t_ns).t_ns) == 1000


BARE, STRAPS = "motion.gait={ preset = 'none' }", "motion.harness={}"


@pytest.mark.parametrize(
    ("places", "without", "beside"),
    [
        ([(gait.Trunk, "at"), (pack.Pack, "nodes"), (motion, "_add_pack")], [BARE, STRAPS], []),
        ([(pack, "_swing")], [], [STRAPS]),
    ],
)
def test_a_walk_computes_no_sway_that_it_has_not(monkeypatch, places, without, beside):
    """Without gait neither trunk nor pack is asked, with straps too, and straps are solved only where
    there are some."""
    forbid(monkeypatch, *places)
    t_ns = birch().start_ns + 2 * 10**9 + np.arange(10, dtype=np.int64)
    Emulator(birch(*without), threads=1).parts.motion.poses_at(t_ns)
    with pytest.raises(TouchedError):
        Emulator(birch(*beside), threads=1).parts.motion.poses_at(t_ns)


@pytest.mark.parametrize("setting", ["gps.connected=false", "gps={ connected = true, canopy_loss = false }"])
def test_without_canopy_loss_nobody_looks_at_the_sky(monkeypatch, setting):
    """No ray is cast at the sky without a receiver, or for one that sees through trees; else one look a
    second."""
    looks = []
    monkeypatch.setattr(page, "sky_cover", lambda *_: looks.append(1) or 0.0)
    list(Emulator(load("static_bench", [setting]), threads=1).packets(0.0, 0.5))
    assert not looks
    list(Emulator(load("static_bench", ["gps.connected=true"]), threads=1).packets(0.0, 0.5))
    assert 1 <= len(looks) <= 2


@pytest.mark.usefixtures("kept_woods")
def test_still_air_moves_nothing():
    """Without wind no placement of a window sways, and each tile's stems are one shape; in wind each is
    its own."""
    still, blown = (
        window_of(emulator.parts, emulator.scenario.start_ns, emulator.engine.batching, 0)
        for emulator in (Emulator(birch(*wind), threads=1) for wind in ([], ["wind.speed_m_s=3"]))
    )
    assert still.sway is None
    assert not any(isinstance(key, StemKey) for key in still.shapes)
    assert blown.sway is not None
    assert any(isinstance(key, StemKey) for key in blown.shapes)


@pytest.mark.usefixtures("kept_woods")
def test_a_medium_out_of_sight_is_not_made(monkeypatch):
    """Where no sensor sees beyond `world.near_m` all is faces and no voxels are made; where one does, they
    are."""
    forbid(monkeypatch, (FarCaster, "medium"))
    next(Emulator(birch("sensor.max_range_m=5", "world.near_m=5"), threads=1).returns(0.0, SPAN_S))
    with pytest.raises(TouchedError):
        next(Emulator(birch("sensor.max_range_m=5.1", "world.near_m=5"), threads=1).returns(0.0, SPAN_S))


STEPS = """
import json, sys
from vlp16emu.cli.app import run

for lines, names in json.loads(sys.argv[1]):
    codes = [run(line) for line in lines]
    print(*codes, *sorted(set(names) & set(sys.modules)), file=sys.stderr)
"""
"""A program that carries out command lines step by step, and says after each step which of some modules
are loaded by now."""


def test_commands_load_no_library_they_do_not_need(tmp_path, monkeypatch):
    """What is wrong with a scene is found before kernels and their compiler are loaded.

    A static, single-ray recording imports nothing that draws, reads meshes or grids, makes curves or talks; a
    stream builds no frames, and waits neither for the lint nor for scipy, be its path and woods made for it
    or kept from before.
    """
    monkeypatch.setenv("VLP16EMU_CACHE_DIR", str(tmp_path / "world"))
    wrong, json_ = ("birch_walk", "--set", "sensor.rpm=17"), "--json"
    lean = (
        "record",
        "static_bench",
        f"{tmp_path}/x.pcap",
        "--duration",
        "0.1",
        "--set",
        "gps.connected=false",
        json_,
    )
    sets = (
        "sensor.max_range_m=6",
        "world.near_m=5",
        "world.stems_per_ha=15",
        "world.stones.cover=0.01",
        "gps.connected=false",
    )
    ports = "--data-port", "23680", "--position-port", "23681"
    walk = "stream", "birch_walk", "--duration", "0.05", "--no-audit", *set_words(sets), *ports, json_
    scipy = [f"scipy.{part}" for part in ("interpolate", "ndimage", "optimize", "spatial", "special")]
    heavy = ["trimesh", "rich.progress", "vlp16emu.extras.verify", *scipy]
    talks = ["rasterio", "PIL", "networkx", "serial", "pynmea2", "velodyne_decoder"]
    own = ["vlp16emu.extras.truth.truth", "vlp16emu.extras.accuracy.sweep"]
    steps = [
        ([("schema",), ("record", *wrong, "x.pcap"), ("stream", *wrong)], ["numba", "scipy", "dpkt"]),
        ([walk, walk], ["numba", "dpkt", "scipy.linalg", *heavy]),
        ([lean], ["numba", *heavy, *talks, *own]),
    ]
    command = [sys.executable, "-c", STEPS, json.dumps(steps)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    said = [line for line in done.stderr.splitlines() if line[0].isdigit()]
    assert said == ["0 2 2", "0 0 numba", "0 numba"]


def test_descriptions_of_keys_are_read_for_the_schema_only():
    """No section's source is parsed at the start: the docstring of a key is no part of its field."""
    assert Scenario.model_fields["seed"].description is None
    assert schema()["properties"]["seed"]["description"].startswith("Seed of all random numbers")
