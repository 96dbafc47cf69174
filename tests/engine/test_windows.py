"""Work ahead, in order."""

import gc
import threading
import time
import weakref
from concurrent.futures import CancelledError
from types import SimpleNamespace

import numpy as np
import pytest

from vlp16emu.engine.windows import BLOCK, SEGMENT, Batching, Windows, in_order


def windows(*, per_segment=4, threads=2, opened=None):
    def open_segment(segment):
        if opened is not None:
            opened.append(segment)
        return f"segment {segment}"

    batching = SimpleNamespace(block_ns=100, segment=per_segment or 4, parts=1)
    return Windows(open_segment, batching, moves=per_segment is not None, threads=threads)


def run(work, blocks, of=None, *, threads=2, together=1, **own):
    """Work on runs of blocks in order, with windows of their own if none are given."""
    of = of or windows(threads=threads, **own)
    return in_order(work, of.runs(blocks, together, threads), of, threads=threads, stop=blocks.stop)


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_results_come_in_order_with_their_segment(threads):
    """Each block is worked on once, with the segment it belongs to, and handed out in order."""
    out = list(run(lambda run, scene: (run.start, scene.result()), range(3, 14), threads=threads))
    assert out == [(block, f"segment {block // 4}") for block in range(3, 14)]


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("span", [range(3), range(3, 14), range(50, 400)])
def test_runs_hold_each_block_once_and_keep_to_segments(threads, span):
    """Runs follow each other without gaps, none crosses a segment, and the first and last of every worker
    are single."""
    runs = list(windows(per_segment=64, threads=threads).runs(span, 8, threads))
    assert [block for run in runs for block in run] == list(span)
    assert all(run.start // 64 == (run.stop - 1) // 64 for run in runs)
    assert all(len(run) == 1 for run in runs[:threads])
    assert len(runs[-1]) == 1
    longest = {3: (1, 1, 1), 11: (4, 2, 1), 350: (8, 8, 4)}[len(span)]
    assert max(map(len, runs)) == dict(zip((1, 2, 5), longest, strict=True))[threads]


@pytest.mark.parametrize("threads", [1, 2, 7, 16, 24, 64, 100])
def test_with_any_number_of_threads_windows_are_opened_once(threads):
    """Neither workers far ahead nor who looks back 1.4 s, for the sky, make a window be opened again."""
    opened = []
    of = windows(per_segment=64, threads=threads, opened=opened)
    for blocks in run(lambda blocks, _scene: blocks, range(640), of, threads=threads, together=8):
        of.at_time(100 * (blocks.start - 13)).result()
    assert opened == list(range(10))


def test_only_windows_that_are_needed_are_opened():
    """One segment serves a scene in which nothing moves, an empty span opens nothing, and before the first
    pulse the first segment serves."""
    opened = []
    list(run(lambda _run, scene: scene.result(), range(100), per_segment=None, opened=opened))
    assert opened == [0]
    opened = []
    assert list(run(lambda run, scene: run, range(0), opened=opened)) == []
    assert opened == []
    assert windows().at_time(-12_000).result() == "segment 0"


def test_an_error_reaches_the_caller():
    """An error in the work or in opening is raised where the result is taken."""

    def fail(run, _scene):
        if run.start == 5:
            raise OSError("block five")
        return run.start

    results = run(fail, range(10))
    assert [next(results) for _ in range(5)] == [0, 1, 2, 3, 4]
    with pytest.raises(OSError, match="block five"):
        next(results)


def test_leaving_early_stops_the_work():
    """A run that is left in the middle begins no further blocks and leaves no worker behind."""
    begun, before = [], set(threading.enumerate())
    results = run(lambda run, _scene: begun.append(run), range(10_000))
    next(results)
    workers = [thread for thread in threading.enumerate() if thread.name.startswith("work")]
    results.close()
    for thread in set(workers) - before:
        thread.join(10)
        assert not thread.is_alive()
    assert len(begun) < 20


def test_a_wire_sensor_is_cut_as_ever():
    """A VLP-16 has blocks of 1920 sequences, whole packets in both return modes, and segments of 64 of
    them; in 20 parts they have the same edges."""
    batching = Batching(16, 55_296)
    assert (batching.block, batching.segment) == (BLOCK, SEGMENT) == (1_920, 64)
    assert batching.block_ns == 1_920 * 55_296
    assert batching.block % 24 == batching.block % 12 == 0
    whole, parts = Batching(16, 55_296), Batching(16, 55_296, 20)
    assert (parts.block, parts.block % 24) == (96, 0)
    assert parts.segment == 20 * whole.segment
    assert (parts.edges_ns(3) == whole.edges_ns(3)).all()
    # Blocks of a span begin no later and end no earlier; a segment's edges are its blocks' beginnings.
    assert list(whole.blocks(3 * whole.block_ns + 1, 5 * whole.block_ns)) == [3, 4]
    assert (whole.edges_ns(2) == (2 * SEGMENT + np.arange(SEGMENT + 1)) * whole.block_ns).all()


def unit_of(lasers, sequence_ns):
    """Return a unit without packets, with the beams that `Batching.of` reads."""
    beams = SimpleNamespace(elevation_deg=np.zeros(lasers), sequence_ns=sequence_ns)
    return SimpleNamespace(head=SimpleNamespace(beams=beams), section=None)


def test_sensors_of_equal_sequences_share_blocks_and_others_have_their_own():
    """Blocks are those of the sensor with most lasers among those with equally long firing sequences; beside
    others the edges of a segment end with the longest block of the others."""
    alone = Batching.of([unit_of(16, 55_296), unit_of(32, 55_296)])
    assert alone == {55_296: Batching(32, 55_296)}
    mixed = Batching.of([unit_of(16, 55_296), unit_of(32, 46_080), unit_of(128, 53_300)])
    others = [Batching(32, 46_080), Batching(128, 53_300)]
    assert [mixed[46_080], mixed[53_300]] == others
    longest_ns = max(batching.block_ns for batching in others)
    edges_ns = mixed[55_296].edges_ns(1)
    assert (edges_ns[:-1] == Batching(16, 55_296).edges_ns(1)).all()
    assert edges_ns[-1] - edges_ns[-2] == longest_ns


def test_blocks_of_another_length_are_in_the_segment_that_they_begin_in():
    """The same windows serve blocks of another length: none is opened twice, and runs keep to segments."""
    opened = []
    of = windows(per_segment=64, opened=opened)
    longer = of.in_blocks_of(SimpleNamespace(block_ns=130, parts=1))
    assert [longer.name_of(block) for block in (0, 49, 50, 98, 99)] == [0, 0, 1, 1, 2]
    runs = list(longer.runs(range(200), 8, 2))
    assert [block for run in runs for block in run] == list(range(200))
    assert all(run.start * 130 // 6400 == (run.stop - 1) * 130 // 6400 for run in runs)
    assert longer.at_block(50).result() == of.at_block(64).result() == "segment 1"
    assert opened == [1]


@pytest.mark.parametrize("lasers", [1, 8, 64, 256, 1024])
@pytest.mark.parametrize("sequence_ns", [2_315, 55_556, 5_555_556])
def test_blocks_of_any_sensor_are_bounded(lasers, sequence_ns):
    """Blocks are multiples of 8 sequences, with no more pulses than a VLP-16's and no longer unless that
    is the least."""
    batching = Batching(lasers, sequence_ns)
    assert batching.block % 8 == 0
    assert batching.block == 8 or (batching.block * lasers <= 16 * BLOCK and batching.block_ns <= 110_000_000)
    assert 6.5e9 < batching.segment * batching.block_ns <= 6.8e9


def test_each_window_is_opened_once_while_it_is_in_use():
    """A window that blocks use is not opened again for a time in it, nor the other way; two are kept, so
    one is opened again after two others."""
    opened = []
    of = windows(opened=opened)
    assert of.at_time(399).result() == "segment 0"
    for block, scene in enumerate(run(lambda _run, scene: scene.result(), range(8), of, threads=1)):
        assert of.at_time(100 * block).result() == scene
    assert opened == [0, 1]
    opened = []
    of = windows(opened=opened, per_segment=64, threads=1)
    for segment in (0, 1, 0, 2, 1):
        of.at_block(64 * segment).result()
    assert opened == [0, 1, 2, 1]


def test_windows_are_let_go_with_their_owner():
    """Nothing holds a window in a circle: it dies with the last who knows it, without the collector."""

    class World:
        pass

    gc.disable()
    try:
        of = Windows(
            lambda _segment: World(), SimpleNamespace(block_ns=1, segment=4, parts=1), moves=True, threads=1
        )
        alive = weakref.ref(of.at_block(0).result())
        assert alive() is not None
        del of
        until_s = time.monotonic() + 60.0
        while alive() is not None and time.monotonic() < until_s:  # the thread that opened it lets go last
            time.sleep(0.001)
        assert alive() is None
    finally:
        gc.enable()


def test_a_stop_ends_the_wait_for_a_window():
    """Who waits for a block is let go when the run is stopped, and no thread that grows its window is
    waited for."""
    grown, stop = threading.Event(), threading.Event()
    batching = SimpleNamespace(block_ns=100, segment=4, parts=1)
    of = Windows(lambda _segment: grown.wait(), batching, moves=True, threads=2)
    results = run(lambda _run, scene: scene.result(), range(8), of.stopped_by(stop))
    threading.Timer(0.0, stop.set).start()
    with pytest.raises(CancelledError):
        next(results)
    grown.set()
    assert of.wait(of.at_block(0))
