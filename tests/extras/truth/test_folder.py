"""A folder of truth."""

import ctypes
import resource
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vlp16emu.errors import OutputError, RunError
from vlp16emu.extras.truth.folder import TruthFolder
from vlp16emu.extras.truth.tables import POSES, pose_rows
from vlp16emu.motion.pose import Kinematics
from vlp16emu.output import write_json


def tum(t_ns, turns, positions_m):
    """Text of poses at rest."""
    at_rest = np.zeros((4, len(t_ns), 3))
    return POSES.text(pose_rows(Kinematics(np.array(t_ns), turns, np.array(positions_m), *at_rest)))


def test_rows_hold_every_nanosecond_and_rotation():
    """Times keep nine decimals, which no float of today does; quaternions have length 1 and qw >= 0, and
    give the rotation back, half turns too."""
    assert tum([1_781_254_795_000_000_001], np.eye(3)[None], [[1.0, -2.0, 0.5]]) == (
        "1781254795.000000001 1.000000000 -2.000000000 0.500000000 "
        "0.000000000000 0.000000000000 0.000000000000 1.000000000000\n"
    )
    turns = Rotation.concatenate(
        [Rotation.random(200, rng=np.random.default_rng(5)), Rotation.from_rotvec(np.pi * np.eye(3))]
    )
    text = tum(np.arange(203), turns.as_matrix(), np.zeros((203, 3)))
    quaternions = np.array([line.split()[4:] for line in text.splitlines()], float)
    assert (quaternions[:, 3] >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1.0, atol=1e-11)
    np.testing.assert_allclose(Rotation.from_quat(quaternions).as_matrix(), turns.as_matrix(), atol=1e-11)


@pytest.mark.parametrize("scenario", [None, "[]", "no JSON", '{"seed": 1}'])
def test_files_of_somebody_else_stay(tmp_path, scenario):
    """A folder of a data set that has the same names, but no scenario that we wrote, is refused and kept."""
    (tmp_path / "imu.csv").write_text("mine")
    if scenario is not None:
        (tmp_path / "scenario.json").write_text(scenario)
    with pytest.raises(
        OutputError, match=r"holds imu\.csv; expected a new or empty folder, or one with the truth"
    ):
        TruthFolder(tmp_path)
    assert (tmp_path / "imu.csv").read_text() == "mine"


@contextmanager
def files_of_at_most(size):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_on_a_full_disk_the_last_line_is_whole(tmp_path):
    """Where half a line finds room it is cut off, and nothing is written behind it; a JSON file is whole
    or not there."""
    with TruthFolder(tmp_path / "one") as folder:
        folder.append("imu.csv", "one two\n")
        for _ in range(2):
            with (
                pytest.raises(RunError, match=r"imu\.csv: File too large; it ends with a whole line"),
                files_of_at_most(25),
            ):
                folder.append("imu.csv", "three four\nfive six\n")
    (left,) = tmp_path.glob("one.*.part")
    assert (left / "imu.csv").read_text() == "one two\nthree four\n"
    assert not (tmp_path / "one").exists()
    whole_or_none = pytest.raises(RunError, match=r"/rig\.json: File too large; no file is written")
    with TruthFolder(tmp_path / "more") as folder, whole_or_none, files_of_at_most(25):
        write_json(folder.path / "rig.json", {"key": "of more than 25 letters"})
    assert list((tmp_path / "more").iterdir()) == []


def test_a_table_has_whole_rows_at_any_time(tmp_path):
    """While it grows, and when half a row found room on a full disk, numpy reads the rows so far."""
    rows = np.zeros(3, POSES.dtype)
    rows["t_ns"] = [1, 2, 3]
    with TruthFolder(tmp_path / "t") as folder:
        folder.begin_rows("trajectory", POSES)
        assert len(np.load(folder.path / "trajectory.npy")) == 0
        folder.append_rows("trajectory", POSES, rows[:2])
        assert np.array_equal(np.load(folder.path / "trajectory.npy"), rows[:2])
        assert (folder.path / "trajectory.tum").read_text() == POSES.header + POSES.text(rows[:2])
        most = (folder.path / "trajectory.npy").stat().st_size + 20
        with (
            pytest.raises(RunError, match=r"trajectory\.npy: File too large; it ends with a whole row"),
            files_of_at_most(most),
        ):
            folder.append_rows("trajectory", POSES, rows[2:])
    (left,) = tmp_path.glob("t.*.part")
    assert np.array_equal(np.load(left / "trajectory.npy"), rows[:2])


def test_two_runs_into_one_folder_are_refused(tmp_path):
    """While a run writes, another one neither removes nor replaces its files; a path that is taken by a
    file is refused, and the file kept."""
    with TruthFolder(tmp_path / "t") as folder:
        folder.append("imu.csv", "one\n")
        with pytest.raises(OutputError, match=r": is being written by process \d+; expected another place"):
            TruthFolder(tmp_path / "t")
    assert (tmp_path / "t" / "imu.csv").read_text() == "one\n"
    assert [path.name for path in tmp_path.iterdir()] == ["t"]
    (tmp_path / "taken").write_text("mine")
    with pytest.raises(OutputError, match=r"taken: Not a directory; expected a folder that can be written"):
        TruthFolder(tmp_path / "taken")
    assert (tmp_path / "taken").read_text() == "mine"


@pytest.mark.parametrize("entry", ["trajectory.tum", "returns.parquet.part", "notes.txt"])
def test_a_folder_with_something_else_is_kept_as_a_whole(tmp_path, entry):
    """A folder, or a file of another name, beside the truth of an earlier run is refused, and nothing of
    that run is lost."""
    place = tmp_path / "t"
    with TruthFolder(place) as folder:
        write_json(folder.path / "scenario.json", {"written_by": "vlp16emu"})
        write_json(folder.path / "rig.json", {})
    (place / entry).mkdir()
    with pytest.raises(OutputError, match=rf"holds {entry}"):
        TruthFolder(place)
    assert sorted(path.name for path in place.iterdir()) == sorted(["rig.json", "scenario.json", entry])


@pytest.mark.parametrize("swap", [True, False])
def test_an_earlier_run_is_replaced_as_a_whole_or_not_at_all(tmp_path, monkeypatch, swap):
    """A run that fails leaves the folder of the one before as it was; one that ends replaces all its
    files, with renameat2(2) and without it."""
    if not swap:
        monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: None)
    place = tmp_path / "t"
    with TruthFolder(place) as folder:
        write_json(folder.path / "scenario.json", {"written_by": "vlp16emu"})
        folder.append("imu.csv", "earlier\n")
    with pytest.raises(RunError), TruthFolder(place) as folder:  # noqa: PT012
        folder.append("imu.csv", "half\n")
        raise RunError("the device is gone")
    (left,) = tmp_path.glob("t.*.part")
    assert (left / "imu.csv").read_text() == "half\n"
    assert (place / "imu.csv").read_text() == "earlier\n"
    with TruthFolder(place) as folder:
        folder.append("gnss.csv", "new\n")
    assert [path.name for path in place.iterdir()] == ["gnss.csv"]


@pytest.mark.parametrize("place", ["/proc", "."])
def test_a_folder_that_cannot_be_renamed_is_refused(place):
    """A mount point, and the folder in which the program runs, are refused before anything is written."""
    with pytest.raises(OutputError, match="is a mount point or the working folder; expected a folder in it"):
        TruthFolder(Path(place))


def test_a_folder_keeps_its_rights(tmp_path):
    """An empty folder that only its owner may enter stays so when it is replaced."""
    (tmp_path / "x").mkdir(mode=0o700)
    with TruthFolder(tmp_path / "x") as folder:
        folder.append("imu.csv", "new\n")
    assert (tmp_path / "x").stat().st_mode & 0o777 == 0o700
    assert (tmp_path / "x" / "imu.csv").read_text() == "new\n"


def test_a_folder_that_became_somebody_elses_stays(tmp_path):
    """Files that another program puts there during the run are not replaced; the new folder is left beside
    them."""
    place = tmp_path / "x"

    def meanwhile():
        with TruthFolder(place) as folder:
            folder.append("imu.csv", "one\n")
            place.mkdir()
            (place / "mine").touch()

    with pytest.raises(RunError, match=r"x: holds mine; it is left as .*x\.[0-9a-f]{8}\.part"):
        meanwhile()
    (left,) = tmp_path.glob("x.*.part")
    assert ([*map(str, place.iterdir())], [path.name for path in left.iterdir()]) == (
        [f"{place}/mine"],
        ["imu.csv"],
    )
