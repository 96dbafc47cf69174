"""The stream of a scene: how it is opened, measured, and what it says."""

from threading import Event

import pytest

from vlp16emu import Emulator, StreamPart
from vlp16emu.errors import OutputError, ScenarioError
from vlp16emu.extras import outlook
from vlp16emu.extras.outlook import LADDER
from vlp16emu.run.options import Outlets, StreamOptions
from vlp16emu.run.scene_stream import SceneStream
from vlp16emu.run.stream import State
from vlp16emu.sinks import FellBehind

FREE = {"data_port": 0, "position_port": 0}
WIDE = {"beam.model": "adaptive", "beam.rays": 64}


class Lines(StreamPart):
    """Keeps the lines of a stream."""

    def __init__(self):
        self.lines = []

    def news(self, line):
        self.lines.append(line)


@pytest.mark.parametrize(
    ("late", "treatment"),
    [
        ("pace", "the delay stays, at the sensor's own spacing (--late pace)"),
        ("skip", "late packets are dropped until the stream is at now (--late skip)"),
    ],
)
def test_the_line_names_seconds_cause_treatment_and_settings(late, treatment):
    """A late stream says how late, why and what becomes of packets; only a slow engine gets advice."""
    with SceneStream(Emulator("static_bench", WIDE), StreamOptions(late=late, **FREE)) as stream:
        slow = stream._behind_line(FellBehind(14.2, 0.051, True, 0.83))
        stood_still = stream._behind_line(FellBehind(12.3, 5.01, False, 0.1))
    assert slow == (
        f"behind: 0.051 s late at 14.2 s, as the engine computes 0.83 x real time; {treatment}; to keep up: "
        "--set beam.model=none, or --set beam.model=none --set sensor.max_range_m=45, or --speed 0.66"
    )
    assert stood_still == (
        f"behind: 5.010 s late at 12.3 s, as the process stood still or got no core; {treatment}"
    )


def test_a_stream_that_is_measured_sends_what_is_chosen(monkeypatch):
    """Packets are those of the rung, which a line names, on the same ports; a stop chooses nothing."""
    speeds = iter([0.6, 2.0])
    monkeypatch.setattr(outlook, "_measured", lambda _run: next(speeds))
    emulator = Emulator("static_bench", WIDE)
    told = Lines()
    with SceneStream(emulator, StreamOptions(duration_s=0.1, **FREE)) as stream:
        stream.add(told)
        ports = stream.links
        stream.measure()
        assert (stream.state, stream.links) == (State.OPENED, ports)
        stream.run()
    assert stream.result.about.beam.startswith("none")
    assert told.lines[0] == "keep-up: measuring this machine"
    assert told.lines[1].startswith(f"keep-up: one ray ({LADDER[3].options}; ")
    stop = Event()
    stop.set()
    monkeypatch.undo()
    with SceneStream(emulator, StreamOptions(duration_s=0.1, **FREE), stop=stop) as stream:
        stream.measure()
        assert stream.emulator.scenario.beam.model == "adaptive"
        assert stream.run().interrupted


def test_what_cannot_be_opened_is_an_error_of_the_call():
    """A receiver that is unknown, or a device that the scene lacks, is an error of the call."""
    emulator = Emulator("static_bench")
    with pytest.raises(OutputError, match="which is unknown"):
        SceneStream(emulator, StreamOptions(to="nobody.invalid"))
    with pytest.raises(ScenarioError, match=r"gps\.connected: found false"):
        SceneStream(emulator, StreamOptions(outlets=Outlets(gps_out="/dev/null"), **FREE))
