"""Which caster is taken, its device and threads, and how much of the sky it sees hidden."""

import math
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
from vlp16emu.raycast.build import EmbreeMesh, Instances, shape_of
from vlp16emu.raycast.caster import caster, sky_cover
from vlp16emu.raycast.near import EmbreeCaster
from vlp16emu.types import SURFACE, Mesh, Window
from vlp16emu.world.hall import HallWorld
from vlp16emu.world.settings import Hall, HallSphere

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
    """Embree reports an error only to the thread on which it happened; there it is asked for, and the run
    ends."""
    _, shape = lab.upright((10.0, -1.0, 1.0, -1.0, 1.0))
    monkeypatch.setattr(embree, "BUFFER_INDEX", 99)
    with pytest.raises(RunError, match=r"^Embree could not build a shape: invalid argument$"):
        workers.submit(EmbreeMesh(shape_of(shape("all"))).build, [0]).result()
    monkeypatch.undo()
    workers.submit(EmbreeMesh(shape_of(shape("all"))).build, [0]).result()


def test_a_window_that_fails_leaves_nothing_behind(workers, monkeypatch):
    """Where Embree cannot build a window, the scene that was begun is given back before the error is
    raised."""
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
        Instances(lab.placed(0), [], workers).scene(np.zeros(0, np.bool_))
    assert len(released) == 1
    real.rtcReleaseScene(released[0])


AT_M = np.array([432_100.0, 6_901_234.0, 87.0])


def roof(_key):
    """A disc of radius 1 m, level."""
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    rim = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(400)])
    corners_m = np.concatenate([np.zeros((1, 3)), rim]).astype("f4")
    faces = np.column_stack([np.zeros(400), 1 + np.arange(400), 1 + (np.arange(400) + 1) % 400])
    return (Mesh(corners_m, faces.astype("u4")),)


def under(radius_m, height_m, workers):
    transform = np.column_stack([np.diag([radius_m, radius_m, 1.0]), AT_M + [0.0, 0.0, height_m]])[None]
    window = Window(AT_M, ("roof",), np.zeros(1, "i4"), transform, np.zeros(1, "u4"), np.zeros(1, SURFACE))
    return caster(lab.world(roof), workers).open(window)


@pytest.mark.parametrize("height_m", [2.0, 5.0, 10.0, 30.0])
def test_a_disc_overhead_hides_its_solid_angle(workers, height_m):
    """A disc of 10 m hides the share of the sky above 15 degrees that its cone fills, within a ring of
    rays."""
    cover = sky_cover(under(10.0, height_m, workers), 0, AT_M, 15.0, 100.0)
    lowest = math.sin(math.radians(15.0))
    share = (1 - height_m / math.hypot(height_m, 10.0)) / (1 - lowest)
    assert cover == pytest.approx(min(share, 1.0), abs=1 / 16)


def test_half_a_sky(workers):
    """A wide roof whose edge is overhead hides half of it, whatever the direction of the edge."""
    scene = under(80.0, 1.0, workers)
    for angle in np.radians(range(0, 360, 40)):
        edge_m = AT_M + 80.0 * np.array([math.cos(angle), math.sin(angle), 0.0])
        assert sky_cover(scene, 0, edge_m, 15.0, 100.0) == pytest.approx(0.5, abs=0.04)


def test_what_is_low_or_far_does_not_count(workers):
    """A roof below the lowest elevation, below the antenna or out of reach hides nothing."""
    scene = under(10.0, 5.0, workers)
    assert sky_cover(scene, 0, AT_M + [35.0, 0.0, 0.0], 15.0, 100.0) == 0.0
    assert sky_cover(scene, 0, AT_M + [35.0, 0.0, 0.0], 1.0, 100.0) > 0.0
    assert sky_cover(scene, 0, AT_M + [0.0, 0.0, 6.0], 15.0, 100.0) == 0.0
    assert sky_cover(scene, 0, AT_M, 15.0, 4.9) == 0.0


def test_crowns_overhead_hide_as_much_as_their_leaves_do(workers):
    """In the wood the share of the sky that is hidden is that of leaf by leaf within 0.02 in the mean, and
    no crown is built for it."""
    x_m, y_m = (place.ravel() for place in np.meshgrid(*2 * [np.arange(2.0, 20.0, 4.0)]))
    places_m = np.column_stack([x_m, y_m, lab.Tiles().height_m(x_m, y_m) + 1.7])
    scenes = [caster(lab.Tiles(near_m, per_tile=16), workers) for near_m in (20.0, math.inf)]
    window = lab.Tiles(20.0, per_tile=16).window(places_m)
    near, leaves = (each.open(window) for each in scenes)
    covers = [[sky_cover(scene, 0, at_m, 15.0, 60.0) for at_m in places_m] for scene in (near, leaves)]
    assert 0.1 < np.mean(covers[1]) < 0.6
    assert np.mean(covers[0]) == pytest.approx(np.mean(covers[1]), abs=0.02)
    assert not near._near.steep


def test_the_sky_is_that_of_its_instant():
    """What sways is looked at where it is at the time that is asked for."""
    asked = []

    def cast(rays, _near_m, _far_m):
        asked.append(rays.t_ns)
        return SimpleNamespace(range_m=np.full(rays.t_ns.size, np.inf))

    far = SimpleNamespace(cast=cast)
    assert sky_cover(SimpleNamespace(as_far=far), 1_234, AT_M, 15.0, 100.0) == 0.0
    assert (asked[0] == 1_234).all()


def test_halls_share_their_things():
    """The mesh of a ball that two halls of one program have is made once; a greater ball is another shape."""
    meshes = []
    for diameter_m in (0.5, 0.5, 0.6):
        ball = HallSphere(name="ball", centre_m=(0.0, 0.0, 1.0), diameter_m=diameter_m)
        hall = HallWorld(Hall(kind="hall", length_m=10.0, width_m=8.0, height_m=3.0, spheres=[ball]))
        meshes.append(hall.shape(hall.window(np.zeros((1, 3))).shapes[1])[0])
    assert meshes[0] is meshes[1]
    assert meshes[0] is not meshes[2]
