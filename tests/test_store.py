"""What is kept on disk from run to run."""

import hashlib

import numpy as np
import pytest

from vlp16emu import store as module
from vlp16emu.emulator import Emulator
from vlp16emu.engine import assemble
from vlp16emu.foliage.tiles import STEM
from vlp16emu.scenario import load
from vlp16emu.store import Store, recalled, user_store

BUNDLE = {
    "numbers": np.arange(12, dtype=np.float32).reshape(3, 4),
    "none": np.zeros((0, 4, 3), np.uint8),
    "one": np.array(2.5),
    "rows": np.zeros(3, STEM),
}


@pytest.fixture
def folder(tmp_path):
    """Where a store puts its files."""
    return tmp_path / "cache" / "world"


@pytest.fixture
def kept(folder):
    """A store with one bundle."""
    store = Store(folder, 10_000_000)
    store.put("trees of tile 1", BUNDLE)
    store.flush()
    return store


def test_what_was_put_comes_back(kept):
    """Arrays have their values, types and shapes, and may be written to."""
    bundle = kept.get("trees of tile 1")
    assert bundle.keys() == BUNDLE.keys()
    for key, array in BUNDLE.items():
        np.testing.assert_array_equal(bundle[key], array, strict=True)
        assert bundle[key].flags.writeable
        assert bundle[key].flags.aligned == array.flags.aligned
    assert kept.get("trees of tile 2") is None


def test_no_objects_are_read():
    """A file that asks for Python objects is refused: reading runs no code."""
    for kind in ("|O", [["a", "<f8"], ["b", "|O"]]):
        with pytest.raises(ValueError, match="O"):
            module._dtype(kind)


def test_another_state_of_the_program_has_names_of_its_own(kept, monkeypatch):
    """What other files of the package made is not taken."""
    monkeypatch.setattr(module, "_state", lambda: "other")
    assert kept.get("trees of tile 1") is None


def test_the_user_chooses_the_folder(monkeypatch, tmp_path):
    """`VLP16EMU_CACHE_DIR` and `VLP16EMU_CACHE_MB` decide, else the user's cache is used."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    for value, folder in (("off", None), ("", None), (str(tmp_path / "mine"), tmp_path / "mine")):
        monkeypatch.setenv("VLP16EMU_CACHE_DIR", value)
        assert user_store.__wrapped__().folder == folder
    monkeypatch.delenv("VLP16EMU_CACHE_DIR")
    assert user_store.__wrapped__().folder == tmp_path / "vlp16emu" / "world"
    assert user_store.__wrapped__().most_bytes == 1_000_000_000
    monkeypatch.setenv("VLP16EMU_CACHE_MB", "50")
    assert user_store.__wrapped__().most_bytes == 50_000_000
    monkeypatch.setenv("VLP16EMU_CACHE_MB", "0")
    assert user_store.__wrapped__().folder is None


def test_a_thing_without_a_name_is_made_each_time():
    """An empty name keeps nothing."""
    assert recalled("", lambda: 5, None, None) == 5


@pytest.fixture
def use(monkeypatch):
    """Make a folder the user's store."""

    def choose(folder):
        monkeypatch.setenv("VLP16EMU_CACHE_DIR", str(folder))
        user_store.cache_clear()
        return user_store()

    yield choose
    user_store.cache_clear()


SMALL = (
    "sensor.max_range_m=8",
    "world.near_m=4",
    "world.stems_per_ha=150",
    "world.species=[{species='scots_pine',share=1,dbh_cm=28,height_m=22}]",
    "world.regeneration.species=['scots_pine']",
    "world.shrubs.species=['hazel']",
    "beam.model=none",
)
"""Each kind of shape, of one species, and a medium."""


def recorded(scene, *settings):
    """Digest of the first packets of a scene."""
    digest = hashlib.sha256()
    for packet in Emulator(load(scene, (*SMALL, *settings))).packets(0.0, 0.05):
        digest.update(packet.payload)
    return digest.hexdigest()


@pytest.mark.parametrize("settings", [(), ("wind.speed_m_s=4",)], ids=["still", "wind"])
def test_a_run_is_the_same_cold_and_warm(use, folder, settings):
    """Bytes do not depend on what is kept; a warm run makes nothing anew."""
    plain = (use("off"), recorded("reference_forest", *settings))[1]
    store = use(folder)
    assert recorded("reference_forest", *settings) == plain
    store.flush()
    files = {path: path.stat().st_ino for path in folder.iterdir()}
    assert files
    store = use(folder)
    assert recorded("reference_forest", *settings) == plain
    store.flush()
    assert {path: path.stat().st_ino for path in folder.iterdir()} == files


def test_another_path_is_grown_anew(use, folder):
    """Tiles keep clear of the path: a warm run on another one is as a cold one."""
    other = "motion.way_points_m=[[0, 0], [10, 20]]"
    plain = (use("off"), recorded("reference_forest", other))[1]
    use(folder)
    recorded("reference_forest")
    use(folder)
    assert recorded("reference_forest", other) == plain


def test_all_that_decides_a_world_is_in_its_name():
    """Seed, section and path are; how far away leaves are cast one by one is not."""
    settings = ((), ("seed=61",), ("world.terrain.rough_rms_m=0.2",), ("motion.way_points_m=[[0, 0], [9, 9]]",))
    worlds = [assemble(load("reference_forest", (*SMALL, *setting))).world for setting in settings]
    assert len({world.name for world in worlds}) == len(settings)
    assert assemble(load("reference_forest", (*SMALL, "world.near_m=9"))).world.name == worlds[0].name
    crown = worlds[0].window(np.zeros((2, 3))).shapes[1]
    assert worlds[0].shape_name(crown) != worlds[1].shape_name(crown)
    assert worlds[0].shape_name(crown) == worlds[2].shape_name(crown)
