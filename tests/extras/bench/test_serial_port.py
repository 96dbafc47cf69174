"""Serial ports that vanish, hang and come back; pulses on their lines."""

import os
import socket
import threading
import time
import tty

import pytest

from vlp16emu.errors import OutputError
from vlp16emu.extras.bench import outlets
from vlp16emu.extras.bench.outlets import SerialPort, SerialSink
from vlp16emu.types import Packet, PacketKind

SENTENCE = b"$GPRMC,081802.00,A,3649.7478558,N,00224.4542928,W,0.034,212.5,210116,0.0,E,A*2E\r\n"


def sentence(payload=SENTENCE):
    return Packet(PacketKind.NMEA, 0, payload)


def until(condition):
    """Wait for what another thread does."""
    end_s = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.005)


class Device:
    """A pseudo-terminal behind a name that stays when it goes."""

    def __init__(self, path):
        self.path = path
        self.plug_in()

    def plug_in(self):
        self.master, slave = os.openpty()
        tty.setraw(slave)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(slave))
        self.slave = slave

    def pull_out(self):
        os.close(self.slave)
        os.close(self.master)
        self.path.unlink()

    def read(self, count):
        data = b""
        while len(data) < count:
            data += os.read(self.master, count - len(data))
        return data


@pytest.fixture
def device(tmp_path):
    return Device(tmp_path / "gps")


@pytest.mark.parametrize(("line", "felt"), [("rts", "cts"), ("dtr", "dsr")])
def test_pulses_are_on_the_line(monkeypatch, line, felt):
    """The line is low when the port opens, high by a pulse, low after it, and low when the stream ends in
    a pulse."""
    monkeypatch.setattr(
        outlets, "_SCHEMES", ("loop",)
    )  # of pyserial: lines of the port are wired to each other
    port = SerialPort("loop://lines", 9600, "--gps-out", line)
    opened = port.use(lambda opened: opened)
    seen = [getattr(opened, felt)]
    with SerialSink(port) as sink:
        for level in (b"\1", b"\0", b"\1"):
            sink.send(Packet(PacketKind.PPS, 0, level))
            until(lambda level=level: getattr(opened, felt) == any(level))
            seen.append(getattr(opened, felt))
        lowered = threading.Event()
        opened.close = lambda: getattr(opened, felt) or lowered.set()
    assert lowered.wait(5.0)
    assert seen == [False, True, False, True]
    assert sink.result.pulses == 2


def test_a_device_that_comes_back_is_found(device, monkeypatch):
    """While it is away sentences are dropped, and the next one after its return is the first that comes
    out."""
    monkeypatch.setattr("vlp16emu.extras.bench.outlets._RETRY_S", 0.05)
    sent = []

    def send(text=SENTENCE):
        sent.append(text)
        sink.send(sentence(text))

    def is_idle():  # a sentence still in the queue would be the first out
        return sink.result.messages + sink.result.dropped == len(sent)

    with SerialSink(SerialPort(str(device.path), 9600, "--gps-out")) as sink:
        for times in (1, 2):
            send()
            device.read(len(SENTENCE))
            device.pull_out()
            until(lambda times=times: send() or sink.result.dropped > 4 * times)
            until(is_idle)
            device.plug_in()
            until(lambda times=times: send(b"back") or len(sink.result.away) == times)
            assert device.read(4) == b"back"
            until(is_idle)
            tty.tcflush(device.master, tty.TCIFLUSH)
    assert len(sink.result.away) == 2
    assert all(0.0 < away.away_s < 5.0 for away in sink.result.away)
    assert sink.result.dropped >= 8


def test_a_port_that_takes_no_more_holds_up_nobody_and_takes_no_core(device):
    """Without a reader sending goes on at once, memory stays bounded, every lost packet is counted, and
    waiting costs next to nothing."""
    with SerialSink(SerialPort(str(device.path), 9600, "--gps-out")) as sink:
        begun_s = time.monotonic()
        for _ in range(10_000):  # 0.8 MB, into a buffer of 4 KB
            sink.send(sentence())
        assert time.monotonic() - begun_s < 10.0  # waiting for each would take 0.25 s
        until(lambda: sink.result.messages + sink.result.dropped == 10_000)
        clock = time.pthread_getcpuclockid(sink._thread.ident)
        begun_s = time.clock_gettime(clock)
        for _ in range(3):
            sink.send(sentence())
        until(
            lambda: sink.result.messages + sink.result.dropped == 10_003
        )  # the buffer may find room for one more
        assert time.clock_gettime(clock) - begun_s < 0.3  # of some 0.75 s, by its own thread
    sink._thread.join()
    result = sink.result
    assert 0 < result.messages < 400


@pytest.mark.filterwarnings(
    "ignore::pytest.PytestUnraisableExceptionWarning"
)  # pyserial leaves the socket to Python
def test_a_url_is_a_port_too():
    """socket:// sends to a server; it has no line, and a server that ends is a device that is away."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        name = f"socket://127.0.0.1:{server.getsockname()[1]}"
        with SerialSink(SerialPort(name, 9600, "--gps-out", "rts")) as sink:
            there, _ = server.accept()
            sink.send(sentence())
            assert there.recv(200) == SENTENCE
            there.close()
            until(lambda: sink.send(sentence()) or sink.result.dropped > 0)
    sink._thread.join()
    assert sink.result.pulses is None
    assert len(sink.result.away) == 1


@pytest.mark.parametrize(
    ("name", "found"),
    [("/dev/nothing", "No such file"), ("socket://127.0.0.1:1", "refused"), ("/dev/null", "ioctl")],
)
def test_what_cannot_be_opened_is_refused(name, found):
    """The line names option, port and reason; other URLs of pyserial, which may open files, are not taken."""
    with pytest.raises(OutputError, match=rf"--gps-out {name}.*{found}.*; expected"):
        SerialPort(name, 9600, "--gps-out")
    with pytest.raises(OutputError, match="--gps-out: found 'spy://x'; expected a serial port"):
        SerialPort("spy://x", 9600, "--gps-out")


def test_ports_are_8n1(device):
    """The terminal is at 9600 baud, eight bits, no parity, one stop bit, no flow control."""
    port = SerialPort(str(device.path), 9600, "--gps-out")
    control, speed = tty.tcgetattr(device.slave)[2], tty.tcgetattr(device.slave)[4]
    assert speed == tty.B9600
    assert control & tty.CSIZE == tty.CS8
    assert not control & (tty.PARENB | tty.CSTOPB | tty.CRTSCTS)
    port.close()
