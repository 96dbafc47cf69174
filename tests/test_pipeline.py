"""Work ahead, in order."""

import threading

import pytest

from vlp16emu.pipeline import ahead


def run(work, blocks, *, per_stretch=4, threads=2, opened=None):
    def open_stretch(stretch):
        if opened is not None:
            opened.append(stretch)
        return f"stretch {stretch}"

    return ahead(work, open_stretch, blocks=blocks, per_stretch=per_stretch, threads=threads)


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_results_come_in_order_with_their_stretch(threads):
    """Each block is worked on once, with the stretch it belongs to, and handed out in order."""
    out = list(run(lambda block, scene: (block, scene.result()), range(3, 14), threads=threads))
    assert out == [(block, f"stretch {block // 4}") for block in range(3, 14)]


def test_each_stretch_is_opened_once_and_none_beyond_the_end():
    """Stretches are opened in order, once each, and only those that the blocks need."""
    opened = []
    list(run(lambda block, scene: scene.result(), range(3, 14), opened=opened))
    assert opened == [0, 1, 2, 3]


def test_all_blocks_may_share_one_stretch():
    """Where nothing moves a single stretch serves all."""
    opened = []
    list(run(lambda block, scene: scene.result(), range(100), per_stretch=None, opened=opened))
    assert opened == [0]


def test_work_runs_only_a_little_ahead():
    """The number of blocks begun but not handed out stays bounded by the number of threads."""
    begun, most = [], 0
    for number, _ in enumerate(run(lambda block, _scene: begun.append(block), range(200), threads=2)):
        most = max(most, len(begun) - number)
    assert most <= 6


def test_an_error_reaches_the_caller():
    """An error in the work or in opening is raised where the result is taken."""

    def fail(block, _scene):
        if block == 5:
            raise OSError("block five")
        return block

    results = run(fail, range(10))
    assert [next(results) for _ in range(5)] == [0, 1, 2, 3, 4]
    with pytest.raises(OSError, match="block five"):
        next(results)


def test_leaving_early_stops_the_work():
    """A run that is left in the middle begins no further blocks and leaves no thread behind."""
    before = threading.active_count()
    begun = []
    results = run(lambda block, _scene: begun.append(block), range(10_000))
    next(results)
    results.close()
    assert len(begun) < 20
    assert threading.active_count() == before


def test_no_blocks_no_work():
    """An empty span opens nothing."""
    opened = []
    assert list(run(lambda block, scene: block, range(0), opened=opened)) == []
    assert opened == []
