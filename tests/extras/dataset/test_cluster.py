"""Datasets by the workers of a Dask scheduler: the bytes of one process, whatever dies on the way."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from extras.dataset.kit import PUCK_ALONE, walks_in

from vlp16emu.errors import InputError, MissingExtraError, RunError
from vlp16emu.extras.dataset import cluster, make_dataset

dask = pytest.importorskip("dask")
distributed = pytest.importorskip("distributed")

PAGE = Path(__file__).resolve().parents[3] / "tools" / "results" / "dataset.md"
LONGEST_S = 100.0  # that a program of these tests takes for a step, on a machine with other work

KILLED = """
import os
import signal
from vlp16emu.extras.dataset.layouts import LAYOUTS

def die(emulator, folder, span):
    (folder / "velodyne").mkdir()
    os.kill(os.getpid(), signal.SIGKILL)

LAYOUTS["semantickitti"] = die
"""
"""Preload of a worker that is killed with -9 in the middle of its first walk."""

CLIENT = """
import sys
from pathlib import Path
from extras.dataset.kit import PUCK_ALONE, walks_in
from vlp16emu.extras.dataset import make_dataset

def progress(done_s):
    if done_s:
        print(done_s, flush=True)
        sys.stdin.read()

walks = walks_in(Path(sys.argv[1]), PUCK_ALONE)
make_dataset(walks, Path(sys.argv[2]), scheduler=sys.argv[3], progress=progress)
"""
"""Client that waits after its first walk, for its end by a signal."""


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """Four walks, and the dataset that this process makes of them."""
    folder = tmp_path_factory.mktemp("alone")
    walks = walks_in(folder, PUCK_ALONE)
    return walks, folder / "out", make_dataset(walks, folder / "out", workers=0)


@pytest.fixture(scope="module")
def here():
    """A scheduler and a worker in threads of this process: they share its kernels."""
    with (
        dask.config.set({"distributed.admin.system-monitor.interval": "1h"}),
        distributed.LocalCluster(
            n_workers=1,
            threads_per_worker=1,
            processes=False,
            protocol="tcp",
            host="127.0.0.1",
            dashboard_address=":0",
        ) as made,
    ):
        yield made


@pytest.fixture(scope="module")
def programs(tmp_path_factory):
    """A scheduler, a worker that is killed in its first walk, and another, each a process: address and
    processes."""
    folder = tmp_path_factory.mktemp("dask")
    (folder / "killed.py").write_text(KILLED)
    running = {}

    def start(name, *words):
        log = (folder / f"{name}.log").open("w")
        command = [
            sys.executable,
            "-m",
            f"distributed.cli.dask_{words[0]}",
            "--host",
            "127.0.0.1",
            "--no-dashboard",
        ]
        running[name] = subprocess.Popen([*command, *words[1:]], stderr=log, stdout=log)
        log.close()

    start("scheduler", "scheduler", "--port", "0", "--scheduler-file", folder / "scheduler.json")
    worker = ["worker", "--scheduler-file", folder / "scheduler.json", "--nthreads", "1", "--no-nanny"]
    worker += ["--local-directory", folder]
    start("killed", *worker, "--preload", folder / "killed.py")
    start("other", *worker)
    with distributed.Client(scheduler_file=folder / "scheduler.json", set_as_default=False) as client:
        client.wait_for_workers(2, timeout=LONGEST_S)
    yield str(folder / "scheduler.json"), running
    for process in running.values():
        process.kill()
        process.wait(LONGEST_S)


def test_a_worker_and_a_client_that_are_killed_lose_a_walk_only(programs, alone, tmp_path):
    """A worker dies in its first walk, the client after another one: the next client makes what is missing.

    Manifest and files are those of one process.
    """
    address, running = programs
    walks, folder, first = alone
    out = tmp_path / "out"
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    command = [sys.executable, "-c", CLIENT, tmp_path, out, address]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment) as client:
        assert client.stdout.readline() == b"0.25\n"
        client.kill()
    assert running["killed"].wait(LONGEST_S) == -signal.SIGKILL
    assert not (out / "manifest.json").exists()
    (kept,) = (out / "sequences").iterdir()
    before = kept.stat().st_mtime_ns
    second = make_dataset(walks, out, scheduler=address)
    assert (second.made, second.sha256) == (3, first.sha256)
    assert kept.stat().st_mtime_ns == before
    assert contents(out) == contents(folder)


def test_a_scheduler_that_is_killed_ends_the_run_in_one_line(programs, alone, tmp_path):
    """The walks that are complete stay and are in the manifest; without a scheduler the rest is made as
    before."""
    address, running = programs
    walks, _, first = alone
    out = tmp_path / "out"

    def progress(done_s):
        if done_s:
            running["scheduler"].kill()
            running["scheduler"].wait(LONGEST_S)

    with pytest.raises(
        RunError, match=r"^tcp://127\.0\.0\.1:\d+: the scheduler is lost; what is made so far is kept$"
    ):
        make_dataset(walks, out, scheduler=address, progress=progress)
    kept = len(json.loads((out / "manifest.json").read_text())["walks"])
    assert 1 <= kept < 4
    second = make_dataset(walks, out, workers=0)
    assert (second.made, second.sha256) == (4 - kept, first.sha256)
    assert sorted(path.name for path in out.iterdir()) == ["manifest.json", "sequences"]


def test_files_of_workers_that_do_not_see_the_folder_are_fetched(here, alone, tmp_path, monkeypatch):
    """Walks come in pieces smaller than their files, are those of one process, and leave nothing on the
    worker.

    One that is gone when it is fetched is made again.
    """
    walks, folder, first = alone
    read, lost = cluster._read_piece, tmp_path / "lost"

    def lost_once(source, begin):  # Dask sends it by value: it can change no variable here
        if begin and not lost.exists():
            lost.touch()
            raise FileNotFoundError(source)
        return read(source, begin)

    monkeypatch.setattr(cluster, "is_marked", lambda _: False)
    monkeypatch.setattr(cluster, "_PIECE_BYTES", 100_000)
    monkeypatch.setattr(cluster, "_read_piece", lost_once)
    made = make_dataset(walks, tmp_path / "out", scheduler=here.scheduler_address)
    assert (made.made, made.sha256) == (4, first.sha256)
    assert contents(tmp_path / "out") == contents(folder)
    assert lost.exists()
    (worker,) = here.workers.values()
    assert not list(Path(worker.local_directory).glob("vlp16emu-*"))


def test_a_walk_of_another_version_is_refused(here, alone, tmp_path, monkeypatch):
    """A worker that came later with another version of the program ends the run; its walk is not taken."""
    walks, *_ = alone
    make = cluster.make_walk

    def another(*arguments, **options):
        walk, folder, entry = make(*arguments, **options)
        return walk, folder, entry | {"written_by": "vlp16emu 0.0.9"}

    monkeypatch.setattr(cluster, "make_walk", another)
    with pytest.raises(
        RunError, match=r"^walk a\.1\.middle\.puck: a worker has made .*, with vlp16emu 0\.0\.9$"
    ):
        make_dataset(walks[:1], tmp_path / "out", scheduler=here.scheduler_address)
    assert not (tmp_path / "out" / "sequences").exists()


def versions(**others):
    """Answers of a scheduler and two workers, one of them with `others`."""
    here = distributed.versions.get_versions(["vlp16emu"])
    other = json.loads(json.dumps(here))
    other["packages"]["vlp16emu"] = others.get("package", other["packages"]["vlp16emu"])
    other["host"]["python"] = others.get("python", other["host"]["python"])
    return {"scheduler": here, "workers": {"tcp://a:1": here, "tcp://b:2": other}}


@pytest.mark.parametrize(
    ("others", "found"),
    [
        ({"package": None}, "worker tcp://b:2 has no vlp16emu on Python 3"),
        ({"package": "0.0.9"}, "worker tcp://b:2 has vlp16emu 0.0.9 on Python 3"),
        ({"python": "3.9.1.final.0"}, "worker tcp://b:2 has vlp16emu .* on Python 3.9;"),
    ],
)
def test_a_worker_of_another_version_is_named(others, found):
    """A worker without the program, or with another version of it or of Python, is one line before
    anything is made."""
    cluster.check_versions("tcp://s:3", versions())
    with pytest.raises(
        InputError, match=f"^tcp://s:3: {found}.*expected vlp16emu .* on Python 3.*, as here$"
    ):
        cluster.check_versions("tcp://s:3", versions(**others))


def test_a_scheduler_without_workers_is_one_line(tmp_path, monkeypatch):
    """Without a worker in time, the line says how to start one, and no folder is made."""
    monkeypatch.setattr(cluster, "_FIRST_WORKER_WITHIN_S", 0.05)
    options = {
        "n_workers": 0,
        "processes": False,
        "protocol": "tcp",
        "host": "127.0.0.1",
        "dashboard_address": ":0",
    }
    with (
        distributed.LocalCluster(**options) as empty,
        pytest.raises(
            InputError, match=r"has no workers after 0 s; expected at least one: `dask worker tcp://"
        ),
    ):
        make_dataset([], tmp_path / "out", scheduler=empty.scheduler_address)
    assert not (tmp_path / "out").exists()


def test_dask_is_an_extra(tmp_path, monkeypatch):
    """Without Dask a scheduler is refused with the extra that brings it."""
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingExtraError, match=r"needs distributed: pip install 'vlp16emu\[cluster\]'"):
        make_dataset([], tmp_path / "out", scheduler="tcp://127.0.0.1:9")


def test_the_page_of_results_is_made_by_its_command(tool_named, capsys):
    """`tools/results/dataset.md` begins as what `tools/dataset_speed` prints, has its tables, and one
    manifest for all ways."""
    tool_named("dataset_speed").main(["--shortest"])
    made, page = (text.splitlines() for text in (capsys.readouterr().out, PAGE.read_text(encoding="utf-8")))
    assert made[:3] == page[:3]
    assert page[2].strip() == "tools/dataset_speed > tools/results/dataset.md"

    def first_words(lines):
        return [line.split("|")[1].split()[0] for line in lines if line.startswith("| ")]

    assert set(first_words(made)) <= set(first_words(page))
    assert len(first_words(made)) == 16
    assert "The manifests are the same bytes." in made
    assert "The manifests are the same bytes." in page
