"""What a scene does not ask for is not done: not computed, not held, not imported."""

import json
import subprocess
import sys

import numpy as np
import pytest
from kit import set_words
from woods import LINES

from vlp16emu import Emulator
from vlp16emu.engine.engine import Engine
from vlp16emu.engine.windows import window_of
from vlp16emu.forest.plants.stem import StemKey
from vlp16emu.forest.tiles import GroundKey, TileKey
from vlp16emu.scenario import Scenario, load, schema

SPAN_S = 0.05  # less than one block


KERNELS = """
import json, logging, sys
import numpy as np
from vlp16emu import Emulator
from vlp16emu.scenario import load

class Used(logging.Handler):
    def emit(self, record):
        used.update(record.args)

logger = logging.getLogger("vlp16emu.kernels.cache")
logger.setLevel(logging.DEBUG)
logger.addHandler(Used())
for scene, settings, work, watched in json.loads(sys.argv[1]):
    used = set()
    emulator = Emulator(load(scene, settings), threads=1)
    if work == "poses":
        t_ns = emulator.scenario.start_ns + 2 * 10**9 + np.arange(10)
        emulator.parts.motion.poses_at(t_ns)
    else:
        next(emulator.engine.returns(0.0, 0.05, truth=work == "truth"))
    print(json.dumps(sorted(used.intersection(watched))))
"""
"""A program that computes poses or returns of scenes one after the other, and says after each which of some
kernels it has called for the first time."""


def kernels_called(steps, kernels):
    """Which of some kernels are called for the first time in each step (scene, settings, work) of one
    process."""
    rows = json.dumps([[*step, kernels] for step in steps])
    done = subprocess.run([sys.executable, "-c", KERNELS, rows], capture_output=True, text=True, check=True)
    return [json.loads(line) for line in done.stdout.splitlines()]


def first(*settings, taps=(), truth=False):
    """Returns of the first blocks of a hall that are cast together."""
    engine = Engine.of(load("static_bench", settings), threads=1, taps=taps)
    return next(engine.returns(0.0, SPAN_S, truth=truth))


def birch(*settings):
    """Scene of a walk with little around it."""
    return load("birch_walk", [*LINES, *settings])


def test_a_beam_without_width_has_no_footprint():
    """Without width a pulse has no axis across the beam and one ray; with it, an axis and sub-rays."""
    seen = []

    def tap(_job, firings, hits, _geometry):
        seen.append((firings.beam_axis, int(hits.count.max())))

    first(taps=[tap])
    first("beam.model=adaptive", taps=[tap])
    (no_axis, one_ray), *_, (axis, rays) = seen
    assert no_axis is None
    assert one_ray == 1
    assert axis.shape[1:] == (16, 3)
    assert rays > 1


def test_an_ideal_sensor_calls_no_kernel_of_others():
    """Sub-rays are cast only for a beam with a width, and surfaces are looked up only for ground truth."""
    hall = "static_bench"
    width = "beam.model=adaptive"
    cast, look = "raycast.kernel.cast_pulses", "returns.echoes.find_source_surfaces"
    steps = [(hall, [], "returns"), (hall, [width], "returns"), (hall, [width], "truth")]
    assert kernels_called(steps, [cast, look]) == [[], [cast], [look]]


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
    for setting in ("noise.range_noise_m=0.01", "weather.rain_mm_h=50"):
        assert depends_on_seed(setting), setting


def test_without_truth_returns_have_no_surfaces():
    """Without truth returns have neither surfaces nor a table of them; with truth they have both."""
    for truth in (False, True):
        returns = first(truth=truth)
        assert (returns.surface is not None) == truth
        assert (returns.surfaces is not None) == truth


def test_a_static_sensor_has_one_pose_and_one_window(caplog):
    """A sensor that stands has one pose, made once, and one window however long the run; a walk has more."""
    caplog.set_level("DEBUG", "vlp16emu.engine.windows")
    emulator = Emulator(load("static_bench"), threads=1)
    motion, t_ns = emulator.parts.motion, np.arange(1000, dtype=np.int64)
    assert motion.poses_at(t_ns) is motion.poses_at(t_ns + 10**12)
    assert len(motion.poses_at(t_ns).t_ns) == 1
    for start_s in (0.0, 7.0, 3000.0):
        next(emulator.returns(start_s, start_s + SPAN_S))
    assert caplog.messages == ["opens a window around 1 positions"]
    assert len(Emulator(birch(), threads=1).parts.motion.poses_at(t_ns).t_ns) == 1000


BARE, STRAPS = "motion.gait={ preset = 'none' }", "motion.harness={}"


def test_a_walk_computes_no_sway_that_it_has_not():
    """Without gait neither trunk nor pack is computed, with straps too, and straps are solved only where
    there are some."""
    trunk, pack, swing = "extras.walk.gait._fill", "extras.walk.motion._add_pack", "extras.walk.pack._swing"
    settings = [[BARE, STRAPS], [], [STRAPS]]
    steps = [("birch_walk", [*LINES, *each], "poses") for each in settings]
    assert kernels_called(steps, [trunk, pack, swing]) == [[], [trunk, pack], [swing]]


@pytest.mark.parametrize("setting", ["gps.connected=false", "gps={ connected = true, canopy_loss = false }"])
def test_without_canopy_loss_nobody_looks_at_the_sky(caplog, setting):
    """No ray is cast at the sky without a receiver, or for one that sees through trees; else once for a
    sensor that stands in still air."""
    caplog.set_level("DEBUG", "vlp16emu.raycast.caster")
    list(Emulator(load("static_bench", [setting]), threads=1).packets(0.0, 0.5))
    assert not caplog.messages
    list(Emulator(load("static_bench", ["gps.connected=true"]), threads=1).packets(0.0, 2.5))
    assert len(caplog.messages) == 1


@pytest.mark.usefixtures("kept_woods")
def test_still_air_moves_nothing():
    """Without wind no placement of a window sways, and each tile's stems are one shape; in wind layers of
    near stems are on their own."""
    still, blown = (
        window_of(emulator.parts, emulator.scenario.start_ns, emulator.engine.batching, 0)
        for emulator in (Emulator(birch(*wind), threads=1) for wind in ([], ["wind.speed_m_s=3"]))
    )
    assert still.sway is None
    assert not any(isinstance(key, StemKey | GroundKey) for key in still.shapes)
    assert blown.sway is not None
    assert any(isinstance(key, StemKey) for key in blown.shapes)
    assert not any(isinstance(key, TileKey) for key in blown.shapes)


def test_a_medium_out_of_sight_is_not_made(tmp_path, monkeypatch):
    """Where no sensor sees beyond `world.near_m` all is faces and no voxels are made; where one does, they
    are."""
    monkeypatch.setenv("VLP16EMU_CACHE_DIR", str(tmp_path / "world"))
    fill, march = "foliage.filling.fill_block", "foliage.march.march_pulses"
    sparse = "world.stems_per_ha=15", "world.stones.cover=0.01", "world.near_m=5"
    seen_to = [[*LINES, *sparse, f"sensor.max_range_m={far_m}"] for far_m in (5, 5.1)]
    steps = [("birch_walk", settings, "returns") for settings in seen_to]
    assert kernels_called(steps, [fill, march]) == [[], [fill, march]]


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

    A walk in still air imports nothing of wind. A static, single-ray recording imports nothing that draws,
    reads meshes or grids, makes curves or talks; a stream builds no frames, and waits neither for the lint
    nor for scipy, be its path and woods made for it or kept from before.
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
    wind = ["vlp16emu.forest.stand.wind", "vlp16emu.forest.plants.bending"]
    steps = [
        ([("schema",), ("record", *wrong, "x.pcap"), ("stream", *wrong)], ["numba", "scipy", "dpkt"]),
        ([walk, walk], ["numba", "dpkt", "scipy.linalg", *heavy, *wind]),
        ([lean], ["numba", *heavy, *talks, *own]),
    ]
    command = [sys.executable, "-c", STEPS, json.dumps(steps)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    said = [line for line in done.stderr.splitlines() if line[0].isdigit()]
    assert said == ["0 2 2", "0 0 numba", "0 numba"]


def test_a_hall_in_clear_air_knows_neither_weather_nor_gnss(tmp_path):
    """Without a receiver and without weather a recording in a hall imports no laws of rain and fog and no
    receiver; with both it does."""
    names = ["vlp16emu.returns.weather", "vlp16emu.motion.gnss", "vlp16emu.forest.stand.wind"]
    options = "--duration", "0.1", "--json", "--no-audit", "--set"
    bare = "record", "static_bench", f"{tmp_path}/x.pcap", *options, "gps.connected=false"
    wet = (
        "record",
        "static_bench",
        f"{tmp_path}/y.pcap",
        *options,
        "weather.rain_mm_h=2",
        "--set",
        "gps.connected=true",
    )
    command = [sys.executable, "-c", STEPS, json.dumps([([bare], names), ([wet], names)])]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    said = [line for line in done.stderr.splitlines() if line[0].isdigit()]
    assert said == ["0", "0 vlp16emu.motion.gnss vlp16emu.returns.weather"]


def test_descriptions_of_keys_are_read_for_the_schema_only():
    """No section's source is parsed at the start: the docstring of a key is no part of its field."""
    assert Scenario.model_fields["seed"].description is None
    assert schema()["properties"]["seed"]["description"].startswith("Seed of all random numbers")
