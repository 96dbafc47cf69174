"""Datasets: the same bytes by any number of workers, whole after a death, and split by stand."""

import json
import multiprocessing
import re
import threading
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest

import vlp16emu.run.emulator as emulator_module
from vlp16emu import Emulator
from vlp16emu.errors import OutputError, ScenarioError
from vlp16emu.extras.clouds.points import write_points
from vlp16emu.extras.dataset import load_spec, make_dataset, walks_of

pytestmark = pytest.mark.usefixtures("kept_woods")

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


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A dataset made by this process."""
    folder = tmp_path_factory.mktemp("made")
    walks = walks_in(folder)
    return walks, folder / "out", make_dataset(walks, folder / "out", workers=0)


def test_a_sequence_takes_its_points_to_where_the_sensor_saw_them(made):
    """Scan, pose and label of a sequence are those of the scene's scans, point for point."""
    walks, out, _ = made
    scans = list(Emulator(walks[0].scenario).scans(truth=True))
    folder = out / "sequences" / "00"
    poses = np.loadtxt(folder / "poses.txt").reshape(-1, 3, 4)
    assert len(scans) == len(poses) == len(list((folder / "velodyne").iterdir())) == 2
    for number, scan in enumerate(scans):
        points = np.fromfile(folder / "velodyne" / f"{number:06d}.bin", "<f4").reshape(-1, 4)
        labels = np.fromfile(folder / "labels" / f"{number:06d}.label", "<u4")
        np.testing.assert_allclose(points[:, :3], scan.xyz_m, atol=1e-5)  # the sensor does not move
        np.testing.assert_allclose(poses[number], scan.world_T_sensor[:3], atol=1e-9)
        assert np.array_equal(labels >> 16 == 0, scan.labels.instance == 0)
        assert len(np.unique(labels >> 16)) == len(np.unique(scan.labels.instance))


def test_a_moving_sensor_s_scan_is_that_of_its_first_pose(tmp_path):
    """With the pose of its scan, a point of a walk comes to where the pulse's own pose puts it."""
    moving = """duration_s=1.3", "motion={kind='walk', way_points_m=[[-8, 0], [4, 0]]}"""
    (walk, *_) = walks_in(tmp_path, SPEC.replace('duration_s=0.25"', f'{moving}"'))
    make_dataset([walk], tmp_path / "out", workers=0)
    emulator, folder = Emulator(walk.scenario), tmp_path / "out" / "sequences" / "00"
    scan = list(emulator.scans())[10]  # the first ones stand still
    pose = np.loadtxt(folder / "poses.txt").reshape(-1, 3, 4)[10]
    points = np.fromfile(folder / "velodyne" / "000010.bin", "<f4").reshape(-1, 4)[:, :3]
    own = emulator.world_T_sensor(scan.t_ns)
    world_m = np.einsum("nij,nj->ni", own[:, :3, :3], scan.xyz_m) + own[:, :3, 3]
    skewed_m = scan.xyz_m @ pose[:, :3].T + pose[:, 3]
    np.testing.assert_allclose(points @ pose[:, :3].T + pose[:, 3], world_m, atol=1e-4)
    assert np.abs(skewed_m - world_m).max() > 0.01


def test_only_what_is_missing_or_damaged_is_made_again(made):
    """A second run makes nothing; a file that somebody changed stays, and once it is moved its walk is made again as before."""
    walks, out, first = made
    assert make_dataset(walks, out, workers=0).made == 0
    scan = out / "sequences" / "03" / "velodyne" / "000001.bin"
    right = scan.read_bytes()
    scan.write_bytes(bytes([right[0] ^ 1]) + right[1:])
    with pytest.raises(OutputError, match=r"000001\.bin is there, and no walk\.json lists it so"):
        make_dataset(walks, out, workers=0)
    scan.rename(out.parent / "mine")
    again = make_dataset(walks, out, workers=0)
    assert (again.made, again.sha256) == (1, first.sha256)
    assert scan.read_bytes() == right


def test_a_run_that_ends_keeps_its_walks(tmp_path):
    """After an error in the third walk the next run makes the third and the fourth, and leaves nothing beside them."""
    walks, done = walks_in(tmp_path)[:4], []

    def progress(done_s):
        done.append(done_s)
        if done_s == 0.5 and len(done) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_dataset(walks, tmp_path / "out", workers=0, progress=progress)
    listed = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert [walk["folder"] for walk in listed["walks"]] == ["sequences/00", "sequences/01"]
    assert make_dataset(walks, tmp_path / "out", workers=0, progress=done.append).made == 2
    np.testing.assert_allclose(done, [0, 0.25, 0.5, 0.5, 0.75, 1.0])
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["manifest.json", "sequences"]


@pytest.mark.parametrize(
    "strange", ["sequences/00", "sequences/00/notes.txt", "sequences/01/velodyne/000000.bin", "manifest.json"]
)
def test_what_is_not_listed_is_not_touched(tmp_path, strange):
    """A file in the place of a walk or of the manifest is named in one line with exit code 2, and all that was there stays."""
    out = tmp_path / "out"
    (out / strange).parent.mkdir(parents=True)
    (out / strange).write_text("mine")
    (out / "sequences").mkdir(exist_ok=True)
    (out / "sequences" / "mine.part").mkdir()
    before = sorted(out.rglob("*"))
    with pytest.raises(OutputError, match=strange) as error:
        make_dataset(walks_in(tmp_path), out, workers=0)
    assert error.value.exit_code == 2
    assert sorted(out.rglob("*")) == before
    assert (out / strange).read_text() == "mine"


def test_a_note_beside_a_walk_s_files_stays(tmp_path):
    """A whole walk is kept with what somebody put beside it; one to be made again is refused until that is gone.

    The folder in which an earlier run made walks is removed; another of a like name stays.
    """
    (walk, *_) = walks_in(tmp_path)
    folder = tmp_path / "out" / "sequences" / "00"
    for name in (".vlp16emu.parts", ".parts.mine"):
        (tmp_path / "out" / name / "walk").mkdir(parents=True)
    make_dataset([walk], tmp_path / "out", workers=0)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [".parts.mine", "manifest.json", "sequences"]
    (folder / "notes.txt").write_text("mine")
    assert make_dataset([walk], tmp_path / "out", workers=0).made == 0
    (folder / "poses.txt").unlink()
    with pytest.raises(OutputError, match=r"notes\.txt"):
        make_dataset([walk], tmp_path / "out", workers=0)
    assert (folder / "velodyne" / "000000.bin").exists()
    (folder / "notes.txt").rename(tmp_path / "notes.txt")
    assert make_dataset([walk], tmp_path / "out", workers=0).made == 1
    assert (folder / "poses.txt").exists()


def test_sensors_of_a_stand_share_its_world(tmp_path, monkeypatch):
    """Of four walks with two sensors and two seeds the world is grown twice, and the manifest is that of walks made each by itself."""
    text = SPEC.replace('"world.width_m=20.0"', '"world.width_m=19.0"')
    walks = walks_in(tmp_path, text)[:4]
    worlds = []
    making = emulator_module.Emulator.__init__

    def made(self, *args, **options):
        making(self, *args, **options)
        worlds.append(self.parts.world)  # which is kept, or another one would have its id

    monkeypatch.setattr(emulator_module.Emulator, "__init__", made)
    shared = make_dataset(walks, tmp_path / "shared", workers=0)
    assert len(set(map(id, worlds))) == 2 < len(worlds)
    monkeypatch.setattr("vlp16emu.extras.dataset.in_one_world", lambda *_: False)
    assert make_dataset(walks, tmp_path / "alone", workers=0).sha256 == shared.sha256


def test_a_capture_of_a_dataset_is_that_of_record(tmp_path):
    """Capture and truth of a walk are, byte for byte, those that `record` writes."""
    (walk, *_) = walks_in(tmp_path, PUCK_ALONE.replace("semantickitti", "pcap+truth"))
    make_dataset([walk], tmp_path / "out", workers=0)
    Emulator(walk.scenario).record(tmp_path / "walk.pcap", truth=tmp_path / "truth")
    made = tmp_path / "out" / "walks" / "0000"
    assert (made / "walk.pcap").read_bytes() == (tmp_path / "walk.pcap").read_bytes()
    names = sorted(file.name for file in (tmp_path / "truth").iterdir())
    assert sorted(file.name for file in (made / "truth").iterdir()) == names
    for name in names:
        assert (made / "truth" / name).read_bytes() == (tmp_path / "truth" / name).read_bytes(), name


def test_a_plot_is_a_laz_file_that_others_read(tmp_path):
    """Points and classes of a plot are those of the scene's points."""
    laspy = pytest.importorskip("laspy")
    (walk, *_) = walks_in(tmp_path, SPEC.replace("semantickitti", "las-plots"))
    make_dataset([walk], tmp_path / "out", workers=0)
    write_points(Emulator(walk.scenario), tmp_path / "points.npz", truth=True)
    points, cloud = (np.load(tmp_path / "points.npz"), laspy.read(tmp_path / "out" / "walks" / "0000" / "points.laz"))
    np.testing.assert_allclose(cloud.xyz, points["world_m"], atol=1e-3)
    assert np.array_equal(cloud["instance"], points["instance"])
    assert set(cloud.classification) >= {2}  # ground


def test_workers_that_are_killed_lose_nothing(tmp_path):
    """Two workers, with one killed on the way, make the manifest of one process."""
    walks, killed = walks_in(tmp_path, PUCK_ALONE)[:3], []

    def progress(done_s):
        if done_s and not killed:
            killed.append(multiprocessing.active_children()[0])
            killed[0].kill()

    first = make_dataset(walks, tmp_path / "alone", workers=0)
    second = make_dataset(walks, tmp_path / "out", workers=2, progress=progress)
    assert second.sha256 == first.sha256
    assert killed[0].exitcode == -9
    assert not (tmp_path / "out" / ".vlp16emu.parts").exists()
    with pytest.raises(ZeroDivisionError):
        make_dataset(walks, tmp_path / "third", workers=2, progress=lambda done_s: 1 / (done_s == 0))
    assert "ExecutorManager" not in str([*map(type, threading.enumerate())])  # its semaphores would stay


def test_shares_of_machines_are_the_dataset(made, tmp_path):
    """Shares that two machines made are, in one folder, the dataset that one machine makes; each stand is in one split."""
    walks, _, first = made
    assert sorted(split for _, split in {(walk.stand, walk.split) for walk in walks}) == ["test", "train"]
    for name, share in (("one", (0, 3)), ("two", (3, 99))):
        assert make_dataset(walks, tmp_path / name, workers=0, share=share).made == len(walks[slice(*share)])
        copytree(tmp_path / name, tmp_path / "all", dirs_exist_ok=True)
    whole = make_dataset(walks, tmp_path / "all", workers=0)
    assert (whole.made, whole.walks, whole.sha256) == (0, len(walks), first.sha256)


def test_the_dataset_of_the_documents_has_24_walks(tmp_path):
    """The file that `scenes/OUTPUTS.md` shows is one."""
    root = Path(__file__).resolve().parents[2]
    (text,) = re.findall(r"```toml\n(schema.*?)```", (root / "scenes" / "OUTPUTS.md").read_text(), re.DOTALL)
    assert len(walks_in(tmp_path, text)) == 24


@pytest.mark.parametrize(
    ("right", "wrong", "said"),
    [
        ('name = "b"', 'name = "a"', "each name and each number once"),
        ("seeds = [1, 2]", "seeds = [1, 1]", "each name and each number once"),
        ("val = 0.0", "val = 0.1", "sum to 1"),
        ("semantickitti", "pcap+truth", "no packets"),
        ("semantickitti", "kitti", "pcap\\+truth"),
        ("sensor.beams", "sensor.beans", r"^walk a\.1\.middle\.four: --set sensor\.beans.*beams"),
        ('set = ["sensor.', 'set = ["seed=5", "sensor.', "set: found seed=5; expected no seed"),
        ("schema = 1", "schema = 1\nstand = 1", "unknown key"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(tmp_path, right, wrong, said):
    """What is wrong in the file of a dataset is named before anything is made."""
    with pytest.raises(ScenarioError, match=said):
        walks_in(tmp_path, SPEC.replace(right, wrong))
