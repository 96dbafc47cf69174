"""Which caster is taken."""

import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from raycast import lab

from vlp16emu.errors import RunError
from vlp16emu.raycast import embree
from vlp16emu.raycast.build import EmbreeMesh, Placed, shape_of
from vlp16emu.raycast.near import EmbreeCaster

TASKS = Path("/proc/self/task")


@pytest.mark.skipif(not TASKS.is_dir(), reason="the threads of a process are counted in /proc")
def test_a_second_caster_starts_no_thread():
    """Beside a second device Embree keeps a thread busy for ever, so all casters of a process share one."""
    window, shape = lab.upright((10.0, -1.0, 1.0, -1.0, 1.0))
    with ThreadPoolExecutor(1) as worker:
        first = EmbreeCaster(lab.world(shape), worker)
        scenes = [first.open(window)]
        threads = len(list(TASKS.iterdir()))
        scenes.append(EmbreeCaster(lab.world(shape), worker).open(window))
        assert len(list(TASKS.iterdir())) == threads


def test_threads_that_ask_at_once_get_one_device(monkeypatch):
    """Shapes are built on several workers, each of which asks for the device: only the first makes one."""
    made, both = [], threading.Barrier(2)

    def new_device(_settings):
        made.append(len(made) + 1)
        with suppress(threading.BrokenBarrierError):
            both.wait(0.2)  # for a second one in here
        return made[-1]

    monkeypatch.setattr(embree, "library", lambda: SimpleNamespace(rtcNewDevice=new_device))
    monkeypatch.setattr(embree, "_new_device", cache(embree._new_device.__wrapped__))
    with ThreadPoolExecutor(2) as pool:
        assert [asked.result() for asked in [pool.submit(embree.device) for _ in range(2)]] == [1, 1]
    assert made == [1]


def test_what_fails_on_a_worker_is_raised_there(workers, monkeypatch):
    """Embree reports an error only to the thread on which it happened; there it is asked for, and the run ends."""
    _, shape = lab.upright((10.0, -1.0, 1.0, -1.0, 1.0))
    monkeypatch.setattr(embree, "BUFFER_INDEX", 99)
    with pytest.raises(RunError, match=r"^Embree could not build a shape: invalid argument$"):
        workers.submit(EmbreeMesh(shape_of(shape("all"))).scene, 0).result()
    monkeypatch.undo()
    workers.submit(EmbreeMesh(shape_of(shape("all"))).scene, 0).result()


def test_a_window_that_fails_leaves_nothing_behind(workers, monkeypatch):
    """Where Embree cannot build a window, the scene that was begun is given back before the error is raised."""
    real, released = embree.library(), []

    class Watched:
        """The library, with an eye on what is given back."""

        def __getattr__(self, name):
            return released.append if name == "rtcReleaseScene" else getattr(real, name)

    def fails(doing):
        raise RunError(f"Embree could not {doing}: out of memory")

    monkeypatch.setattr(embree, "library", Watched)
    monkeypatch.setattr(embree, "check", fails)
    with pytest.raises(RunError, match=r"^Embree could not build the window: out of memory$"):
        Placed(lab.placed(0), [], workers).scene(np.zeros(0, np.bool_))
    assert len(released) == 1
    real.rtcReleaseScene(released[0])
