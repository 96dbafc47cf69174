"""Files that are kept from run to run: whole or as good as none, where only the user can write."""

import hashlib
import os

import numpy as np
import pytest

from vlp16emu import Emulator
from vlp16emu import store as module
from vlp16emu.engine import assemble
from vlp16emu.foliage.tiles import STEM
from vlp16emu.scenario import load
from vlp16emu.store import Store, digest_of, recall, user_store

ABROAD = 4711  # a user that is not us


@pytest.fixture
def folder(tmp_path):
    """Where the files go."""
    return tmp_path / "cache" / "files"


@pytest.fixture
def kept(folder):
    """A folder of one file."""
    kept = Store(folder, ".thing", 10_000_000)
    kept.write("a.thing", b"one two")
    return kept


def is_kept(folder):
    """Whether what is written to a folder is there, and whether it comes back."""
    kept = Store(folder, ".thing", 1000)
    kept.write("b.thing", b"x")
    return kept.read("b.thing") == b"x"


def test_damage_is_as_good_as_nothing(kept, folder):
    """A file that is cut, or of which any byte changed, is not read, and is written anew."""
    path = folder / "a.thing"
    whole = path.read_bytes()
    for at in range(len(whole)):
        path.write_bytes(whole[:at])
        assert kept.read("a.thing") is None
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        assert kept.read("a.thing") is None
    path.unlink()
    os.mkfifo(path)
    assert kept.read("a.thing") is None  # and it does not wait for the other end
    kept.write("a.thing", b"one two")
    assert path.read_bytes() == whole


def test_a_file_of_another_name_is_not_taken(kept, folder):
    """A file under the name of another one is not read."""
    (folder / "a.thing").rename(folder / "b.thing")
    assert kept.read("b.thing") is None


def test_the_folder_is_the_users_alone(folder):
    """Neither the folder nor the one above may be entered by others, whatever the user's umask."""
    before = os.umask(0o002)
    try:
        assert is_kept(folder)
    finally:
        os.umask(before)
    assert [level.stat().st_mode & 0o777 for level in (folder, folder.parent)] == [0o700, 0o700]


@pytest.mark.parametrize("mode", [0o770, 0o707])
@pytest.mark.parametrize("level", [0, 1])
def test_where_others_can_write_nothing_is_kept(kept, folder, level, mode):
    """Neither the folder nor its parent may be writable for others, who could put something in its place."""
    (folder, folder.parent)[level].chmod(mode)
    assert not is_kept(folder)
    assert [path.name for path in folder.iterdir()] == ["a.thing"]


def test_below_a_folder_for_all_a_folder_is_safe(kept, folder):
    """In a folder like /tmp, where each removes only what is one's own, files are kept."""
    folder.parent.chmod(0o1777)
    assert is_kept(folder)


def test_a_link_is_not_followed(kept, folder, tmp_path):
    """A folder that is a symbolic link, to wherever, is refused."""
    (tmp_path / "link").symlink_to(folder)
    assert not is_kept(tmp_path / "link")


@pytest.mark.parametrize(("owner", "is_taken"), [(ABROAD, False), (0, True)])
def test_only_our_own_folders_and_those_of_root_are_taken(monkeypatch, folder, owner, is_taken):
    """A folder of another user is refused, as that user can write in it; root can write everywhere."""
    fstat = os.fstat

    def of_owner(opened):
        state = fstat(opened)
        return os.stat_result([*state[:4], owner, *state[5:10]])

    monkeypatch.setattr(os, "fstat", of_owner)
    monkeypatch.setattr(os, "getuid", lambda: ABROAD + 1)
    assert is_kept(folder) is is_taken


def test_a_folder_that_is_exchanged_is_not_read(kept, folder, tmp_path):
    """A user who owns a folder above may rename ours and put another there: what comes back is from the
    folder that was checked, and nothing is written to the other."""
    assert kept.read("a.thing") == b"one two"
    theirs = tmp_path / "theirs" / "files"
    Store(theirs, ".thing", 1000).write("a.thing", b"planted")
    folder.parent.rename(tmp_path / "aside")
    theirs.parent.rename(folder.parent)
    assert kept.read("a.thing") == b"one two"
    kept.write("b.thing", b"x")
    assert [path.name for path in folder.iterdir()] == ["a.thing"]
    assert kept.read("b.thing") == b"x"


@pytest.mark.parametrize("mode", [0o666, 0o660])
def test_a_file_that_others_can_write_is_not_read(kept, folder, mode):
    """A file in a private folder counts only if it is private itself; a link in its place does not."""
    path = folder / "a.thing"
    path.chmod(mode)
    assert kept.read("a.thing") is None
    path.chmod(0o600)
    assert kept.read("a.thing") == b"one two"
    path.rename(folder / "c")
    path.symlink_to("c")
    assert kept.read("a.thing") is None


@pytest.mark.skipif(os.getuid() != 0, reason="only root can give a folder away")
def test_a_folder_below_one_of_another_user_is_not_taken(kept, folder):
    """Who owns the folder above can replace ours, whatever its mode."""
    os.chown(folder.parent, ABROAD, ABROAD)
    assert not is_kept(folder)


def test_where_nothing_can_be_written_all_goes_on(monkeypatch, kept, folder, tmp_path):
    """No folder, a file in its place and a full disk keep nothing and do no harm."""
    (tmp_path / "file").write_text("in the way")
    for place in (None, tmp_path / "file", tmp_path / "file" / "below"):
        assert not is_kept(place)

    def fail(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    assert not is_kept(folder)
    assert [path.name for path in folder.iterdir()] == ["a.thing"]


def test_what_was_not_used_for_longest_goes_first(folder):
    """The files stay within their size, and reading counts as use."""
    kept = Store(folder, ".thing", 100_000)
    for number in range(3):
        kept.write(f"{number}.thing", bytes(30_000))
        os.utime(folder / f"{number}.thing", (1000.0 + number,) * 2)
    assert kept.read("0.thing") is not None
    kept.write("3.thing", bytes(30_000))
    assert [kept.read(f"{number}.thing") is not None for number in range(4)] == [True, False, True, True]
    assert kept.kept()[1] <= 100_000


def test_foreign_files_stay(kept, folder):
    """Only files with our name and our first bytes are counted and removed, one not written to its end
    among them."""
    foreign = [folder / "b.thing", folder / "notes.txt"]
    for path in foreign:
        path.write_text("mine")
    (folder / "a.thing").rename(folder / "a.thing.7.part")
    assert kept.kept() == (1, 71)
    assert kept.clear() == (1, 71)
    assert sorted(folder.iterdir()) == foreign


def test_a_change_of_any_file_is_another_state(monkeypatch, tmp_path):
    """Each file of the sources counts, also one in a folder of theirs, and so does what else is named."""
    files = [tmp_path / "world" / "one.py", tmp_path / "world" / "stand" / "two.toml"]
    files[1].parent.mkdir(parents=True)
    monkeypatch.setattr(module, "PACKAGE", tmp_path)
    states = [digest_of(["world"]), digest_of(["world"], "1.0")]
    for file in files:
        file.write_text("x = 1")
        states.append(digest_of(["world"]))
    assert len(set(states)) == 4


def test_a_thing_is_kept_as_it_was(use, tmp_path):
    """Arrays have their values, types and shapes; what other files of the package made is not taken."""
    thing = {
        "numbers": np.arange(12, dtype=np.float32).reshape(3, 4),
        "none": np.zeros((0, 4, 3), np.uint8),
        "rows": np.zeros(3, STEM),
    }
    store = use(tmp_path / "cache" / "world")
    recall("trees of tile 1", lambda: thing)
    store.flush()
    again = recall("trees of tile 1", lambda: None)
    for key, array in thing.items():
        np.testing.assert_array_equal(again[key], array, strict=True)
    assert recall("trees of tile 2", lambda: 2) == 2
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_state", lambda: "other")
        assert recall("trees of tile 1", lambda: 1) == 1


def test_the_user_chooses_the_folder(monkeypatch, tmp_path):
    """`VLP16EMU_CACHE_DIR` and `VLP16EMU_CACHE_MB` decide, else the user's cache is used; a size that is
    no number counts for none."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    for value, folder in (("off", None), ("", None), (str(tmp_path / "mine"), tmp_path / "mine")):
        monkeypatch.setenv("VLP16EMU_CACHE_DIR", value)
        assert user_store.__wrapped__().folder == folder
    monkeypatch.delenv("VLP16EMU_CACHE_DIR")
    assert user_store.__wrapped__().folder == tmp_path / "vlp16emu" / "world"
    assert user_store.__wrapped__().most_bytes == 1_000_000_000
    monkeypatch.setenv("VLP16EMU_CACHE_MB", "50")
    assert user_store.__wrapped__().most_bytes == 50_000_000
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(
        "os.path.expanduser", lambda name: name
    )  # no HOME, and a user whom the system does not know
    assert user_store.__wrapped__().usable_folder is None
    for wrong in ("lots", "nan", "inf"):
        monkeypatch.setenv("VLP16EMU_CACHE_MB", wrong)
        assert user_store.__wrapped__().most_bytes == 1_000_000_000
    monkeypatch.setenv("VLP16EMU_CACHE_MB", "0")
    assert user_store.__wrapped__().folder is None


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
    "sensor.max_range_m=6",
    "world.near_m=5",
    "world.stems_per_ha=30",
    "world.terrain.rough_rms_m=0",
    "world.species=[{species='scots_pine',share=1,dbh_cm=28,height_m=22}]",
    "world.regeneration.species=['scots_pine']",
    "world.regeneration.stems_per_ha=200",
    "world.shrubs={species=['hazel'],per_ha=100}",
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
    store = use(folder)
    cold = recorded("reference_forest", *settings)
    store.flush()
    files = {path: path.stat().st_ino for path in folder.iterdir()}
    assert files
    store = use(folder)
    assert recorded("reference_forest", *settings) == cold
    store.flush()
    assert {path: path.stat().st_ino for path in folder.iterdir()} == files


def test_all_that_decides_a_world_is_in_its_name():
    """Seed, section and path are; how far away leaves are cast one by one is not."""
    settings = (
        (),
        ("seed=61",),
        ("world.terrain.rough_rms_m=0.2",),
        ("motion.way_points_m=[[0, 0], [9, 9]]",),
    )
    worlds = [assemble(load("reference_forest", (*SMALL, *setting))).world for setting in settings]
    assert len({world.name for world in worlds}) == len(settings)
    assert assemble(load("reference_forest", (*SMALL, "world.near_m=9"))).world.name == worlds[0].name
    crown = worlds[0].window(np.zeros((2, 3))).shapes[1]
    assert worlds[0].shape_name(crown) != worlds[1].shape_name(crown)
    assert worlds[0].shape_name(crown) == worlds[2].shape_name(crown)
