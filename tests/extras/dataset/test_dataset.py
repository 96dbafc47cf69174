"""Datasets: the same bytes by any number of workers, whole after a death, and split by stand."""

import json
import multiprocessing
import os
import re
import threading
import tracemalloc
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from extras.dataset.kit import PUCK_ALONE, SPEC, walks_in

import vlp16emu.run.emulator as emulator_module
from vlp16emu import Emulator
from vlp16emu.errors import InputError, OutputError, RunError, ScenarioError
from vlp16emu.extras.clouds.points import write_points
from vlp16emu.extras.dataset import estimate_dataset, make_dataset
from vlp16emu.extras.dataset.layouts import LAYOUTS
from vlp16emu.extras.dataset.manifest import check_manifest, write_manifest
from vlp16emu.extras.dataset.processes import WorldQueue

pytestmark = pytest.mark.usefixtures("kept_woods")


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
    """A second run makes nothing; a file that somebody changed stays, and once it is moved its walk is
    made again as before."""
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
    """After an error in the third walk the next run makes the third and the fourth, and leaves nothing
    beside them."""
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
    """A file in the place of a walk or of the manifest is named in one line with exit code 2, and all that
    was there stays."""
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


@pytest.mark.parametrize("head", [b"", b'{"written_by": "vlp16emu 0.1.0", "walks": ['])
def test_a_hole_in_the_place_of_a_manifest_is_refused_unread(tmp_path, head):
    """A sparse file of 3 GB is refused for its last bytes, with less than 1 MB of memory, also if it begins
    as a manifest does."""
    path = tmp_path / "manifest.json"
    with path.open("wb") as file:
        file.write(head)
        file.truncate(3_000_000_000)
    tracemalloc.start()
    with pytest.raises(OutputError, match="is none of ours"):
        check_manifest(path)
    _, most_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most_bytes < 1_000_000
    assert path.stat().st_size == 3_000_000_000


@pytest.mark.parametrize("entries", [[], [{"name": "a", "files": []}]])
def test_an_own_manifest_is_replaced(tmp_path, entries):
    """A manifest that was written here passes the check, with walks and without any."""
    path = tmp_path / "manifest.json"
    write_manifest(path, entries)
    check_manifest(path)


def test_a_note_beside_a_walk_s_files_stays(tmp_path):
    """A whole walk is kept with what somebody put beside it; one to be made again is refused until that is
    gone.

    In the folder for parts, that of an earlier run which was killed is removed; what somebody put there
    stays, also under such a name.
    """
    (walk, *_) = walks_in(tmp_path)
    out = tmp_path / "out"
    folder = out / "sequences" / "00"
    killed = "run-0123456789abcdef"
    foreign = ["run-0123456789abcdee", "run-of-mine"]
    for name in (killed, *foreign):
        (out / ".vlp16emu.parts" / name / "walk").mkdir(parents=True)
    (out / ".vlp16emu.parts" / killed / "mark").write_text(killed)
    make_dataset([walk], out, workers=0)
    assert sorted(path.name for path in out.iterdir()) == [".vlp16emu.parts", "manifest.json", "sequences"]
    assert sorted(path.name for path in (out / ".vlp16emu.parts").iterdir()) == foreign
    (folder / "notes.txt").write_text("mine")
    assert make_dataset([walk], out, workers=0).made == 0
    (folder / "poses.txt").unlink()
    with pytest.raises(OutputError, match=r"notes\.txt"):
        make_dataset([walk], out, workers=0)
    assert (folder / "velodyne" / "000000.bin").exists()
    (folder / "notes.txt").rename(tmp_path / "notes.txt")
    assert make_dataset([walk], out, workers=0).made == 1
    assert (folder / "poses.txt").exists()


@pytest.mark.parametrize(
    "form",
    ["relative", "absolute", "link", "number", "list", "twice_written", "half_a_character", "too_long"],
)
def test_a_list_names_no_file_outside_its_walk(tmp_path, form):
    """A `walk.json` that names a file elsewhere, with its true size and sha256, does not make it a file of
    the dataset."""
    (walk, *_) = walks_in(tmp_path)
    out = tmp_path / "out"
    make_dataset([walk], out, workers=0)
    mine, folder = tmp_path / "mine" / "poses.txt", out / "sequences" / "00"
    mine.parent.mkdir()
    (folder / "poses.txt").rename(mine)
    (folder / "link").symlink_to(mine.parent)
    listed = json.loads((folder / "walk.json").read_text())
    (entry,) = (file for file in listed["files"] if file["path"] == "poses.txt")
    entry["path"] = {
        "relative": "../../../mine/poses.txt",
        "absolute": str(mine),
        "link": "link/poses.txt",
        "number": 7,
        "list": ["poses.txt"],
        "twice_written": "./link/poses.txt",
        "half_a_character": "\ud800",
        "too_long": "x" * 5000,
    }[form]
    listed["scenario_sha256"] = "of another scene"  # so that it would be made again
    (folder / "walk.json").write_text(json.dumps(listed))
    content = mine.read_bytes()
    with pytest.raises(OutputError, match=r"is there, and no walk\.json lists it so"):
        make_dataset([walk], out, workers=0)
    assert mine.read_bytes() == content


def test_a_folder_of_walks_that_is_a_link_is_refused(tmp_path):
    """A dataset is not written through a link that leads out of its folder."""
    (walk, *_) = walks_in(tmp_path)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "sequences").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OutputError, match="sequences/00 is reached through a link"):
        make_dataset([walk], tmp_path / "out", workers=0)
    assert not list((tmp_path / "elsewhere").iterdir())


@pytest.mark.parametrize("kind", ["pipe", "zero", "text"])
def test_a_list_that_is_no_file_is_a_file_of_others(tmp_path, kind):
    """A `walk.json` that is a FIFO, a device or another text is neither waited for nor touched."""
    (walk, *_) = walks_in(tmp_path)
    path = tmp_path / "out" / "sequences" / "00" / "walk.json"
    path.parent.mkdir(parents=True)
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "zero":
        path.symlink_to("/dev/zero")
    else:
        path.write_text('{"written_by": "vlp16emu 0.1.0", "files": {"path": 3}}')
    with pytest.raises(OutputError, match=r"sequences/00/walk\.json is there"):
        make_dataset([walk], tmp_path / "out", workers=0)
    assert os.path.lexists(path)


def test_sensors_of_a_stand_share_its_world(tmp_path, monkeypatch):
    """Of four walks with two sensors and two seeds the world is grown twice, and the manifest is that of
    walks made each by itself."""
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
    monkeypatch.setattr("vlp16emu.extras.dataset.walk.in_one_world", lambda *_: False)
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
    points, cloud = (
        np.load(tmp_path / "points.npz"),
        laspy.read(tmp_path / "out" / "walks" / "0000" / "points.laz"),
    )
    np.testing.assert_allclose(cloud.xyz, points["world_m"], atol=1e-3)
    assert np.array_equal(cloud["instance"], points["instance"])
    assert set(cloud.classification) >= {2}  # ground


def test_workers_keep_to_the_worlds_they_have_entered(tmp_path):
    """Two workers share four worlds of two walks without entering one twice; a third helps at the end."""
    walks = walks_in(tmp_path)
    queue = WorldQueue(walks)
    first, second = queue.take(None), queue.take(None)
    assert [first, second] == [walks[0], walks[2]]
    assert [queue.take(first), queue.take(second)] == [walks[1], walks[3]]
    third = queue.take(walks[1])
    assert third == walks[4]
    assert queue.take(walks[3]) == walks[6]
    assert queue.take(None) == walks[5]  # all worlds are entered
    assert queue.take(third) == walks[7]
    assert queue.take(walks[6]) is None
    queue.put_back(third)
    assert queue.take(None) == third


def test_walks_of_one_world_that_do_not_follow_one_another_are_all_made(tmp_path):
    """A queue of walks in any order, some of them missing, gives each of them once."""
    walks = [walk for walk in walks_in(tmp_path) if walk.number != 2][::-1]
    queue = WorldQueue(walks)
    taken = list(iter(lambda: queue.take(None), None))
    assert sorted(walk.number for walk in taken) == sorted(walk.number for walk in walks)


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


def test_a_walk_that_kills_its_workers_ends_the_run(tmp_path, monkeypatch):
    """After four deaths over one walk the run ends with its name; a death does not touch the walk of
    another worker."""
    walks, tried = walks_in(tmp_path, PUCK_ALONE)[:2], []

    class Dead(ThreadPoolExecutor):  # in the place of processes
        def submit(self, job, walk, parts, threads):
            tried.append(walk.number)
            if walk.number == 0:
                job = lambda *_: (_ for _ in ()).throw(BrokenExecutor)  # noqa: E731
            return super().submit(job, walk, parts, threads)

    monkeypatch.setattr("vlp16emu.extras.dataset.processes._new_worker", lambda: Dead(1))
    with pytest.raises(RunError, match=r"^walk a\.1\.middle\.puck: 4 workers died over it; what is made"):
        make_dataset(walks, tmp_path / "out", workers=2)
    assert tried.count(0) == 4
    assert tried.count(1) == 1


def test_an_estimate_is_near_what_is_made_and_makes_nothing(made, tmp_path):
    """Bytes of walks shorter than the measured span are exact; walks that are complete are left out."""
    walks, out, first = made
    estimate = estimate_dataset(walks, tmp_path / "new" / "out", workers=1)
    assert not (tmp_path / "new").exists()
    assert estimate.bytes == first.bytes
    assert (estimate.missing, estimate.kinds, estimate.cores) == (8, 4, 1)
    assert estimate.simulated_s == 8 * 0.25
    assert 0 < estimate.cpu_hours == estimate.hours
    again = estimate_dataset(walks, out, workers=1)
    assert (again.complete, again.missing, again.bytes, again.hours, again.probes) == (8, 0, 0, 0, ())


def test_an_estimate_of_many_sensors_measures_eight(tmp_path, monkeypatch):
    """Eight of twelve sensors are measured, and the others are estimated by their mean."""
    sensors = ", ".join(
        f'{{ name = "s{n}", set = ["sensor.model=free", "sensor.beams={n}"] }}' for n in range(1, 13)
    )
    text = re.sub(r"sensors = .*", f"sensors = [{sensors}]", SPEC).replace("seeds = [1, 2]", "seeds = [1]")
    walks = [walk for walk in walks_in(tmp_path, text) if walk.stand == "a"]
    monkeypatch.setitem(
        LAYOUTS, "semantickitti", lambda _, folder, span: (folder / "x").write_bytes(bytes(1000))
    )
    estimate = estimate_dataset(walks, tmp_path / "out", workers=1)
    assert (estimate.kinds, len(estimate.probes), estimate.bytes) == (12, 8, 12_000)


def test_workers_and_a_scheduler_exclude_each_other(tmp_path):
    """The workers of a scheduler are its own: a number of others is refused before anything is made."""
    with pytest.raises(
        InputError, match=r"^workers: found 2 beside a scheduler; expected only one of the two"
    ):
        make_dataset([], tmp_path / "out", workers=2, scheduler="tcp://127.0.0.1:9")
    assert not (tmp_path / "out").exists()


def test_the_dataset_of_the_documents_has_24_walks(tmp_path):
    """The file that `scenes/OUTPUTS.md` shows is one."""
    root = Path(__file__).resolve().parents[3]
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
