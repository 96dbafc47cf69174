"""The sky over the antenna of a live run is cast beside its packets."""

import threading
from types import SimpleNamespace

from vlp16emu.extras.live import sky
from vlp16emu.extras.live.sky import SkyAhead
from vlp16emu.units import S_NS

START_NS = 1_779_267_600 * S_NS + 700_000_000


def test_the_fix_of_each_second_is_asked_for_as_it_passes(monkeypatch):
    """The last second before the first pulse at once, the next ones when they have passed; then it ends."""
    monkeypatch.setattr(sky, "lower_priority", lambda _: None)
    asked = []
    third = threading.Event()
    motion = SimpleNamespace(elapsed_ns=2 * S_NS)

    def fix(second_ns):
        asked.append(second_ns - START_NS)
        if len(asked) == 3:
            third.set()

    engine = SimpleNamespace(receiver=SimpleNamespace(fix=fix), scenario=SimpleNamespace(start_ns=START_NS))
    with SkyAhead(engine, motion):
        assert third.wait(10.0)
    assert asked == [-700_000_000, 300_000_000, 1_300_000_000]  # 2.3 s is still to come
