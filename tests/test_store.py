"""What is kept on disk from run to run."""

import hashlib
import os

import numpy as np
import pytest

from vlp16emu import store as module
from vlp16emu.chain import assemble
from vlp16emu.emulator import Emulator
from vlp16emu.scenario import load
from vlp16emu.store import Store, recalled, user_store
from vlp16emu.world.tiles import STEM

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


def only_file(folder):
    """The file of a store that holds one."""
    (path,) = folder.iterdir()
    return path


def test_what_was_put_comes_back(kept):
    """Arrays have their values, types and shapes, and may be written to."""
    bundle = kept.get("trees of tile 1")
    assert bundle.keys() == BUNDLE.keys()
    for key, array in BUNDLE.items():
        np.testing.assert_array_equal(bundle[key], array, strict=True)
        assert bundle[key].flags.writeable
        assert bundle[key].flags.aligned == array.flags.aligned
    assert kept.get("trees of tile 2") is None


def test_the_folder_is_the_users_alone(kept, folder):
    """Nobody else may read or write it."""
    assert folder.stat().st_mode & 0o777 == 0o700
    assert only_file(folder).stat().st_mode & 0o777 == 0o600


def test_damage_is_as_good_as_nothing(kept, folder):
    """A file that is cut, or of which any byte changed, is not read, and is written anew."""
    path = only_file(folder)
    whole = path.read_bytes()
    for at in range(0, len(whole), 7):
        path.write_bytes(whole[:at])
        assert kept.get("trees of tile 1") is None
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        assert kept.get("trees of tile 1") is None
    kept.put("trees of tile 1", BUNDLE)
    kept.flush()
    assert path.read_bytes() == whole


def test_no_objects_are_read(kept, folder):
    """A file that asks for Python objects is damaged: reading runs no code."""
    path = only_file(folder)
    path.write_bytes(path.read_bytes().replace(b"'<f4'", b"'|O' "))
    assert kept.get("trees of tile 1") is None
    with pytest.raises(ValueError, match="O"):
        module._dtype("'|O'")


def test_a_link_is_not_followed(kept, folder, tmp_path):
    """Neither a file nor the folder may be a link."""
    path = only_file(folder)
    path.rename(tmp_path / "elsewhere")
    path.symlink_to(tmp_path / "elsewhere")
    assert kept.get("trees of tile 1") is None
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    store = Store(tmp_path / "link", 10_000_000)
    store.put("a", BUNDLE)
    store.flush()
    assert not list((tmp_path / "real").iterdir())


def test_where_nothing_can_be_written_all_goes_on(tmp_path):
    """A folder that cannot be made, or is open to others, keeps nothing and does no harm."""
    (tmp_path / "file").write_text("in the way")
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    for folder in (tmp_path / "file", tmp_path / "file" / "below", tmp_path / "open", None):
        store = Store(folder, 10_000_000)
        store.put("a", BUNDLE)
        store.flush()
        assert store.get("a") is None
    assert not list((tmp_path / "open").iterdir())


def test_what_was_not_used_for_longest_goes_first(folder):
    """The store stays within its size, and reading counts as use."""
    store, array = Store(folder, 100_000), {"a": np.zeros(30_000, np.uint8)}
    for number in range(3):
        store.put(f"{number}", array)
        store.flush()
        os.utime(store._path(f"{number}"), (1000.0 + number,) * 2)
    assert store.get("0") is not None
    store.put("3", array)
    store.flush()
    assert [store.get(f"{number}") is not None for number in range(4)] == [True, False, True, True]
    assert store.kept().bytes <= 100_000


def test_foreign_files_stay(kept, folder):
    """Only files with our name and our first bytes are counted and removed."""
    foreign = [folder / "notes.txt", folder / f"{'0' * 40}.world"]
    for path in foreign:
        path.write_text("mine")
    assert kept.kept().files == 1
    assert kept.clear().files == 1
    assert sorted(folder.iterdir()) == sorted(foreign)


def test_another_state_of_the_program_has_names_of_its_own(kept, monkeypatch):
    """What other files of the package made is not taken."""
    monkeypatch.setattr(module, "_state", lambda: "other")
    assert kept.get("trees of tile 1") is None


def test_a_change_of_any_file_is_another_state(monkeypatch, tmp_path):
    """Each file of the folders that decide what is kept counts, also one in a folder of theirs."""
    files = [tmp_path / "world" / "one.py", tmp_path / "world" / "stand" / "two.py"]
    files[1].parent.mkdir(parents=True)
    for file in files:
        file.write_text("")
    monkeypatch.setattr(module, "_PACKAGE", tmp_path)
    monkeypatch.setattr(module, "_MAKERS", ("world",))
    states = [module._state.__wrapped__()]
    for file in files:
        file.write_text("x = 1")
        states.append(module._state.__wrapped__())
    assert len(set(states)) == 3


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
    "sensor.max_range_m=12",
    "world.near_m=5",
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
    for packet in Emulator(load(scene, (*SMALL, *settings))).packets(0.0, 0.1):
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
    settings = (
        (),
        ("seed=61",),
        ("world.terrain.rough_rms_m=0.2",),
        ("motion.way_points_m=[[0, 0], [9, 9]]",),
    )
    worlds = [assemble(load("reference_forest", setting)).world for setting in settings]
    assert len({world.name for world in worlds}) == len(settings)
    assert assemble(load("reference_forest", ("world.near_m=9",))).world.name == worlds[0].name
    crown = worlds[0].window(np.zeros((2, 3))).shapes[1]
    assert worlds[0].shape_name(crown) != worlds[1].shape_name(crown)
    assert worlds[0].shape_name(crown) == worlds[2].shape_name(crown)
