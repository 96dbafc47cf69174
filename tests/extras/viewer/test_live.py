"""The page beside a stream: it shows what was sent, sets the sensor, and no packet waits for it, whatever
happens to it."""

import asyncio
import os
import pickle
import re
import signal
import socket
import threading
import time
import urllib.request
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from kit import data_payloads
from listening import Listener

pytest.importorskip("viser", reason="the extra viewer is not installed")

from viser._messages import GuiUpdateMessage

import vlp16emu
from vlp16emu import Emulator
from vlp16emu.errors import RunError
from vlp16emu.extras.viewer.live import (
    Batch,
    LivePage,
    PageSetup,
    instant_ns,
    live_page,
    offer,
    receive,
    with_labels,
)
from vlp16emu.extras.viewer.live_page import LiveView, gps_text, mode_text
from vlp16emu.extras.viewer.live_settings import SettingsPanel
from vlp16emu.packets import DATA_BYTES, pack_position
from vlp16emu.packets.layout import DATA_PAYLOAD
from vlp16emu.run.emulator import TRUTH_OF_RECORDS
from vlp16emu.run.options import Http, StreamOptions
from vlp16emu.run.part import StreamPart
from vlp16emu.run.scene_stream import SceneStream
from vlp16emu.sinks import Lateness
from vlp16emu.types import Labels, PacketKind, PpsState

MODE_AT = 1204  # offset of the return mode in a data packet


@pytest.fixture(scope="module")
def emulator():
    return Emulator("static_bench", {"duration_s": 0.6})


@pytest.fixture(scope="module")
def packets(emulator):
    return list(emulator.packets())


@pytest.fixture
def ends():
    both = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    yield both
    for end in both:
        end.close()


def page_on(channel, emulator, **options):
    """Page at the other end of a channel, which follows a stream of an emulator to free ports."""
    page = LivePage("", channel)
    page.follow(SceneStream(emulator, StreamOptions(data_port=0, position_port=0, **options)))
    return page


def until_the_end(channel):
    with suppress(EOFError):
        while True:
            yield receive(channel)


def test_messages_that_nobody_reads_are_dropped_at_once(ends):
    """A full channel loses messages and returns; those before arrive whole and in order, and the end of
    the reader is noticed."""
    ours, theirs = ends
    assert all(offer(ours, (number, bytes(1_000))) for number in range(5_000))
    ours.close()
    numbers = [number for number, _ in until_the_end(theirs)]
    assert numbers == list(range(len(numbers)))
    assert 10 < len(numbers) < 1_000
    assert not offer(theirs, "anything")


def test_a_page_without_a_reader_keeps_few_packets(emulator, packets, ends):
    """Only the last 512 packets wait for the page, and the counts are of all."""
    page = page_on(ends[0], emulator)
    with page._stream as stream:
        for packet in packets * 2:
            stream.pacer.late_ns = 60_000_000 if packet is packets[0] else 1_000
            page.sent(packet)
    assert [id(packet) for packet, _ in page.waiting] == [id(packet) for packet in (packets * 2)[-512:]]
    assert page.counts[PacketKind.DATA] == 2 * sum(packet.kind is PacketKind.DATA for packet in packets)
    assert page.late == 2


@pytest.mark.parametrize("truth", [False, True])
def test_batches_hold_sent_packets_with_their_poses(ends, truth):
    """The page gets the very payloads, the pose at each first pulse, the counts, and labels if the packets
    have them."""
    ours, theirs = ends
    second = {"name": "second", "data_port": 2369, "position_port": 8309, "mount": {"pitch_deg": -35.0}}
    emulator = Emulator("static_bench", {"duration_s": 0.02, "rig": [second]})
    if truth:
        emulator = emulator.with_engine(replace(emulator.engine, truth_of=TRUTH_OF_RECORDS.load()))
    sent = list(emulator.packets())
    page = page_on(ours, emulator, http=Http("127.0.0.1:0"))
    batches = []
    with page._stream as stream:
        stream.prepare()
        for packet in sent:
            page.sent(packet)
        while sum(len(batch.packets) for batch in batches) < len(sent):
            batches.append(receive(theirs))
        places = tuple(stream.web.places)
    got = [packet for batch in batches for packet in batch.packets]
    assert [(packet.unit, packet.kind, packet.payload) for packet in got] == [
        (packet.unit, packet.kind, packet.payload) for packet in sent
    ]
    assert {packet.unit for packet in got} == {0, 1}
    poses = np.concatenate([batch.world_T_sensor for batch in batches])
    for packet, pose in zip(got, poses, strict=True):
        at_ns = np.array([instant_ns(packet)])
        np.testing.assert_array_equal(pose, emulator.world_T_sensor(at_ns, unit=packet.unit + 1)[0])
    for mine, theirs_ in zip(got, sent, strict=True):
        assert (mine.slots is None) == (not truth or mine.kind is not PacketKind.DATA)
        if mine.slots is not None:
            assert set(mine.slots.dtype.names) == set(Labels.__slots__)
            np.testing.assert_array_equal(mine.slots["semantic"], theirs_.slots["semantic"])
    assert batches[-1].sent == {
        kind: sum(packet.kind is kind for packet in sent) for kind in batches[-1].sent
    }
    assert batches[-1].web == places
    assert len(places) == 2
    assert batches[-1].lateness.packets == len(sent)


def received(emulator, page, ended, while_sending=lambda: None):
    """Payloads of data packets that a receiver gets while an emulator streams beside a page, and the
    report."""
    listener, other = Listener(), Listener()
    begun = threading.Event()

    class Watching(StreamPart):
        def ready(self):
            begun.set()

        def news(self, line):
            if line == "the page in the browser has ended; the stream goes on":
                ended()

    meanwhile = threading.Thread(target=lambda: begun.wait() and while_sending())
    meanwhile.start()
    options = StreamOptions(to=f"127.0.0.1:{listener.port}", position_port=other.port)
    stream = SceneStream(emulator, options)
    stream.add(Watching())
    page.follow(stream)
    stream.run()
    meanwhile.join()
    other.end()
    return listener.end(), stream.result


def test_a_page_that_hangs_or_is_killed_costs_no_packet(emulator, packets):
    """While its process is stopped, and when it is killed, each packet leaves in its order, none is skipped,
    and the stream ends.

    Its niceness is 10 above the stream's, and it has a session of its own, which Ctrl-C at the terminal does
    not reach.
    """
    expected = [payload.tobytes() for payload in data_payloads(packets)]
    gone = threading.Event()
    before = children()
    with live_page(emulator, 0) as page:
        assert urllib.request.urlopen(page.url).status == 200
        (process,) = children() - before
        assert os.getpriority(os.PRIO_PROCESS, process) == min(os.getpriority(os.PRIO_PROCESS, 0) + 10, 19)
        assert os.getsid(process) == process != os.getsid(0)
        os.kill(process, signal.SIGSTOP)
        payloads, streamed = received(emulator, page, gone.set)
        assert payloads == expected
        assert (streamed.packets, streamed.sent.skipped.total()) == (len(expected), 0)
        assert not gone.is_set()
    assert not children() - before
    with live_page(emulator, 0) as page:
        (process,) = children() - before
        payloads, streamed = received(emulator, page, gone.set, lambda: os.kill(process, signal.SIGKILL))
        assert gone.wait(30.0)
    assert payloads == expected
    assert not streamed.interrupted


def children():
    """Process identifiers of the pages that this process has started."""
    found = set()
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError, ValueError):
            parent = int(stat.read_text(encoding="utf-8").rpartition(")")[2].split()[1])
            if parent == os.getpid() and b"live_page" in (stat.parent / "cmdline").read_bytes():
                found.add(int(stat.parent.name))
    return found


def test_a_page_that_cannot_begin_is_one_error(emulator, monkeypatch):
    """If its process ends at once, the error says so."""
    monkeypatch.setattr("sys.executable", "/bin/false")
    with (
        pytest.raises(RunError, match="the page in the browser has ended before it began"),
        live_page(emulator, 0),
    ):
        pass


def batches_of(emulator, packets):
    """Messages as the stream sends them."""
    for first in range(0, len(packets), 16):
        some = tuple(with_labels(packet) for packet in packets[first : first + 16])
        poses = emulator.world_T_sensor(np.array([instant_ns(packet) for packet in some]))
        count = {kind: sum(packet.kind is kind for packet in packets[: first + 16]) for kind in PacketKind}
        yield Batch(some, poses, 0.1, count, 0, Lateness(len(some), 1, 2, 3), 0.0, ())


def seen_view(server, emulator, packets, ends):
    """View that has read the packets of an emulator to their end."""
    ours, theirs = ends
    view = LiveView(server, PageSetup("bench", 0, 1, {}))

    def send():
        with ours:
            for batch in batches_of(emulator, packets):
                ours.send(pickle.dumps(batch))

    sending = threading.Thread(target=send)
    sending.start()
    view.run(theirs)
    sending.join()
    return view


def test_sweeps_are_those_of_the_packets_in_the_world(server, emulator, packets, ends, tmp_path):
    """The page has the sweeps that a reader of a recording gets, each at its pose; odd values of controls
    draw the default."""
    view = seen_view(server, emulator, packets, ends)
    emulator.record(tmp_path / "bench.pcap")
    scans = list(vlp16emu.decode(tmp_path / "bench.pcap"))
    sweeps = [sweep for _, sweep in view._sweeps]
    assert len(sweeps) == len(scans) >= 5
    pose = emulator.world_T_sensor(np.array([emulator.scenario.start_ns]))[0]
    for sweep, scan in zip(sweeps, scans, strict=True):
        np.testing.assert_array_equal(sweep.scan.xyz_m, scan.xyz_m)
        np.testing.assert_allclose(sweep.world_m, scan.xyz_m @ pose[:3, :3].T, atol=1e-5)
    assert view._rpm == pytest.approx(600, rel=0.01)
    view._count.value, view._size.value, view._layer.value = 2, float("nan"), "no layer"
    view._draw_sweeps()
    nodes = server.scene._handle_from_node_name
    drawn = sorted(name for name in nodes if re.fullmatch("/world/sweep/[0-9]+", name))
    assert drawn == [f"/world/sweep/{number}" for number in range(len(scans) - 2, len(scans))]
    assert len(nodes[drawn[0]].points) > 5_000
    assert len(np.unique(nodes[drawn[0]].colors, axis=0)) > 5
    view._layer.value = "range"
    view._draw_sweeps()
    assert len(np.unique(nodes[drawn[0]].colors, axis=0)) > 20
    status = view._status(view._batch)
    for text in ("strongest (0x37)", "600.", "PPS absent", "100% of data packets"):
        assert text in status


def test_labels_of_packets_colour_the_points(server, ends):
    """Packets with ground truth give points a class, and the page offers the layers of labels."""
    emulator = Emulator("static_bench", {"duration_s": 0.3})
    emulator = emulator.with_engine(replace(emulator.engine, truth_of=TRUTH_OF_RECORDS.load()))
    view = seen_view(server, emulator, list(emulator.packets()), ends)
    view._draw_sweeps()
    assert {"class", "instance", "reflectivity", "ring"} <= set(view._layer.options)
    view._layer.value = "instance"
    view._draw_sweeps()
    colours = server.scene._handle_from_node_name["/world/sweep/0"].colors
    assert len(np.unique(colours, axis=0)) > 3


def test_states_are_read_from_packets():
    """Pulse and fix are those of the position packet, the return mode that of the data packet; other bytes
    have words too."""
    valid = b"$GPRMC,081802.00,A,3649.7478558,N,00224.4542928,W,0.034,212.5,210116,0.0,E,A*2E\r\n"
    assert gps_text(pack_position(0, PpsState.LOCKED, valid)) == "PPS locked, fix valid"
    lost = valid.replace(b",A,3", b",V,3")
    assert gps_text(pack_position(0, PpsState.SYNCHRONIZING, lost)) == "PPS synchronizing, no fix"
    assert gps_text(pack_position(0, PpsState.ABSENT, b"")) == "PPS absent, no sentence"
    assert gps_text(b"short") == "no position packet"
    payload = bytearray(DATA_BYTES)
    payload[MODE_AT] = 0x39
    assert mode_text(bytes(payload)) == "dual (0x39)"
    payload[MODE_AT] = 0
    assert mode_text(bytes(payload)) == "unknown (0x00)"
    assert mode_text(b"") == "no data packet"


def wait_until(is_so):
    """Wait for a state of another thread."""
    end_s = time.monotonic() + 60.0
    while not is_so():
        assert time.monotonic() < end_s
        time.sleep(0.01)


@pytest.fixture
def panel(server, monkeypatch):
    """Controls of a sensor on a page with one client."""
    monkeypatch.setattr(server.gui, "_resolve_client", lambda client_id: SimpleNamespace(id=client_id))
    panel = SettingsPanel(server)
    yield panel
    panel.end()


def move(panel, index, value):
    """Move a control, as a browser does."""
    gui = panel._controls[index].handle._impl.gui_api
    message = GuiUpdateMessage(panel._controls[index].handle._impl.uuid, {"value": value})
    asyncio.run_coroutine_threadsafe(gui._handle_gui_updates(1, message), panel._loop).result()


def connect(panel, live):
    """Control the sensor of a stream, and wait until its settings can be moved."""
    host, port = live.http.removeprefix("http://").rstrip("/").split(":")
    panel.connect((host, int(port)))
    wait_until(lambda: not panel._controls[0].handle.disabled)


def test_controls_set_the_sensor_and_show_what_others_set(panel):
    """A moved control arrives in the packets; a refused value gives its reason; a setting of another
    client moves the control."""
    rpm = panel._controls[0].handle
    assert rpm.disabled
    with vlp16emu.stream("static_bench", {"duration_s": 3000.0}, truth=False) as live:
        connect(panel, live)
        move(panel, 1, "Last")
        wait_until(lambda: live.packets(10)[-1][MODE_AT] == 0x38)
        for index, value in ((2, False), (3, 90), (4, 270), (5, True), (6, 45.0)):
            move(panel, index, value)
        wait_until(
            lambda: (
                panel._ask("GET", "/cgi/settings.json")["phaselock"] == {"enabled": "On", "offset": "4500"}
            )
        )
        settings = panel._ask("GET", "/cgi/settings.json")
        assert (settings["laser"], settings["fov"]) == ("Off", {"start": 90, "end": 270})
        live.set(rpm=1200)
        wait_until(lambda: rpm.value == "1200")
        move(panel, 0, "601")
        wait_until(lambda: "601" in panel._text.content)
        wait_until(lambda: rpm.value == "1200")
    move(panel, 0, "600")
    wait_until(lambda: "does not answer" in panel._text.content)


def test_a_moved_control_survives_a_reading_of_the_settings(panel, server):
    """While all threads of viser's pool are busy, a control is moved and the sensor's settings are read with
    the value of before; then the sensor gets the moved value."""
    with vlp16emu.stream("static_bench", {"duration_s": 3000.0}, truth=False) as live:
        connect(panel, live)
        free = threading.Event()
        pool = server._thread_executor
        busy = [pool.submit(free.wait) for _ in range(pool._max_workers)]
        values = [control.handle.value for control in panel._controls]
        move(panel, 1, "Dual")
        panel._show(values)
        free.set()
        assert all(task.result() for task in busy)
        wait_until(lambda: live.packets(10)[-1][MODE_AT] == 0x39)
        assert panel._controls[1].handle.value == "Dual"


def is_dual_at_1200_rpm(payload):
    """Whether a data packet is of dual return, with 0.796 degrees from one pair of blocks to the next."""
    if len(payload) != 1206 or payload[MODE_AT] != 0x39:
        return False
    azimuth_cdeg = np.frombuffer(payload, DATA_PAYLOAD)["blocks"]["azimuth_cdeg"][0].astype(int)
    return abs(np.median(np.diff(azimuth_cdeg[::2]) % 36_000) - 79.6) < 2


def test_a_browser_shows_the_stream_and_sets_the_sensor(in_browser):
    """Chromium shows points and state; the return mode and the speed that are chosen there arrive in the
    packets that leave."""
    listener = Listener()
    ports = "--view-port", "0", "--position-port", "0", "--to", f"127.0.0.1:{listener.port}"
    words = "stream", "static_bench", "--view", *ports, "--duration", "600", "--no-keep-up"
    program, page = in_browser(
        *words, width=1000, height=900, scale=0.25
    )  # what is drawn by software is not looked at
    page.get_by_text("strongest (0x37)").wait_for()
    page.get_by_text("as any client does").wait_for()
    for label, choice, shown in (
        ("return mode", "Dual", "dual (0x39)"),
        ("rpm", "1200", re.compile("1[12].. rpm|1[12]..[.]. rpm")),
    ):
        page.get_by_label(label, exact=True).click()
        page.get_by_role("option", name=choice, exact=True).click()
        page.get_by_text(shown).wait_for()
    assert listener.wait_for(is_dual_at_1200_rpm)
    program.send_signal(signal.SIGINT)
    assert program.wait(100) == 130
    assert listener.end()[0][MODE_AT] == 0x37
