"""A real GPS receiver on a serial port of a stream: pseudo-terminals, as no hardware is needed for that."""

import os
import pty
import threading
import time
import tty

import pytest
from listening import opened, port_of, waiting

from vlp16emu import Emulator
from vlp16emu.errors import OutputError
from vlp16emu.packets import decode_position
from vlp16emu.packets.nmea import rmc
from vlp16emu.run.options import GpsIn
from vlp16emu.types import GnssFix, PpsState
from vlp16emu.units import S_NS, US_NS

FIRST_NS = 1_900_000_000 * S_NS + 1234 * S_NS
"""UTC of the receiver's first second, far from that of the scene and of the host."""


@pytest.fixture
def wire():
    """Both ends of a serial line: the receiver's, and the name of the sensor's."""
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    yield ours, os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


@pytest.fixture
def listening():
    """A pair of sockets that a stream is sent to, and its settings."""
    with opened(60) as data, opened(60) as position:
        ports = {"sensor.data_port": port_of(data), "sensor.position_port": port_of(position)}
        yield (data, position), ports | {"beam.model": "none"}


def test_a_receiver_on_a_terminal_locks_the_sensor(wire, listening):
    """Sentences of a receiver are echoed, the state goes from absent over synchronizing to locked, and
    stamps are its time."""
    (ours, port), (sockets, settings) = wire, listening
    emulator = Emulator("static_bench", {**settings, "gps.pps_window_s": 1.5})
    stop, results = threading.Event(), []
    stream = threading.Thread(
        target=lambda: results.append(emulator.stream(duration_s=3600 * 24, stop=stop, gps_in=GpsIn(port)))
    )
    stream.start()
    states, second = [decode_position(sockets[1].recv(2048)).pps], 0
    begun_ns = time.monotonic_ns()
    while states[-1] is not PpsState.LOCKED and second < 20:
        # The receiver's second begins when ours does, and its sentence comes 0.35 s later.
        due_ns = begun_ns + second * S_NS + 350_000_000
        time.sleep(max(due_ns - time.monotonic_ns(), 0) / S_NS)  # a receiver's pace is that of real time
        sentence = rmc(GnssFix(FIRST_NS + second * S_NS, True, 62.0, 25.0, 1.0, 10.0))
        os.write(ours, sentence)
        waiting(sockets[1])
        for _ in range(20):  # 0.14 s
            last = decode_position(sockets[1].recv(2048))
        states.append(last.pps)
        second += 1
    stamps_us = int.from_bytes(sockets[0].recv(2048)[1200:1204], "little")
    stop.set()
    stream.join(30)
    assert states[0] is PpsState.ABSENT
    assert PpsState.SYNCHRONIZING in states
    assert states[-1] is PpsState.LOCKED
    assert last.sentence == sentence
    expected_us = (FIRST_NS + (second - 1) * S_NS) // US_NS % 3_600_000_000
    assert abs((last.time_ns // US_NS) - expected_us - 500_000) < 400_000
    assert stamps_us > 0
    assert results[0].gps_in.heard.sentences == second
    assert results[0].gps_in.state is PpsState.LOCKED


def test_a_line_that_is_not_there_is_refused(wire, listening):
    """A pseudo-terminal has no line for a pulse: the refusal names what does without."""
    emulator = Emulator("static_bench", listening[1])
    with pytest.raises(OutputError, match=r"no line CD; expected --gps-in-pulse sentence"):
        emulator.stream(duration_s=0.1, gps_in=GpsIn(wire[1], "cd"))
