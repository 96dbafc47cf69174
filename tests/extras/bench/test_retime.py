"""Stamps and sentences moved by whole seconds."""

import numpy as np
import pytest
from listening import parse_rmc
from pynmea2 import NMEASentence

from vlp16emu.extras.bench.retime import age_ns, shift_packet, stamp_ns
from vlp16emu.packets import data_fields, decode_position
from vlp16emu.types import Packet, PacketKind

SENTENCE = b"$GPRMC,235958.00,A,4026.1234567,N,08655.7654321,W,0.900,12.3,311225,0.0,E,A*"


def with_checksum(body):
    return body + f"{NMEASentence.checksum(body[1:-1].decode()):02X}\r\n".encode()


def position(sentence=None, stamp_us=3_598_250_000):
    """A position packet half a second after its second."""
    payload = bytearray(512)
    payload[198:202] = stamp_us.to_bytes(4, "little")
    sentence = with_checksum(SENTENCE) if sentence is None else sentence
    payload[206 : 206 + len(sentence)] = sentence
    return Packet(PacketKind.POSITION, 0, bytes(payload))


def test_a_position_packet_is_moved_over_midnight():
    """Two seconds later are the hour's beginning, and in the sentence the next year, with a right
    checksum."""
    packet = shift_packet(position(), 2)
    assert stamp_ns(packet) == 250_000_000
    fields = decode_position(packet.payload)
    assert fields.sentence == with_checksum(
        SENTENCE.replace(b"235958", b"000000").replace(b"311225", b"010126")
    )
    assert parse_rmc(fields.sentence).t_ns == parse_rmc(with_checksum(SENTENCE)).t_ns + 2_000_000_000
    changed = np.flatnonzero(np.frombuffer(packet.payload, "u1") != np.frombuffer(position().payload, "u1"))
    assert ((changed < 202) | (changed >= 206)).all()


def test_a_move_there_and_back_changes_nothing():
    """Moving by some seconds and back gives the same bytes."""
    for by_s in (1, -1, 86_399, 342_026_366):
        assert shift_packet(shift_packet(position(), by_s), -by_s) == position()


def test_the_date_of_another_clock_is_put_right():
    """Where the capture's clock was a day off the receiver's, the sentence comes to the hour at which it
    is sent."""
    sent_ns = parse_rmc(with_checksum(SENTENCE)).t_ns + 100 * 86_400_000_000_000
    fields = decode_position(shift_packet(position(), 99 * 86_400, sent_ns).payload)
    assert parse_rmc(fields.sentence).t_ns == sent_ns


@pytest.mark.parametrize(
    "sentence", [b"", b"$GPRMC,,V,,,,,,,,,,N*53\r\n", b"$GPGGA,235958.00,4026.1,N*5A\r\n", b"\xff" * 128]
)
def test_what_is_no_dated_sentence_stays(sentence):
    """A sensor without a receiver, a receiver without a fix, another sentence: only the stamp is moved."""
    packet = shift_packet(position(sentence), 1)
    assert packet.payload[206:] == position(sentence).payload[206:]
    assert stamp_ns(packet) == 3_599_250_000_000


def test_a_data_packet_keeps_all_but_its_stamp():
    """Four bytes of a data packet change; it is as old as it takes to fill, in strongest return."""
    packet = Packet(PacketKind.DATA, 0, bytes(1200) + (3_599_999_000).to_bytes(4, "little") + b"\x37\x22")
    after = shift_packet(packet, 7)
    assert after.payload[:1200] == packet.payload[:1200]
    assert after.payload[1204:] == packet.payload[1204:]
    assert stamp_ns(after) == (stamp_ns(packet) + 7_000_000_000) % 3_600_000_000_000
    assert age_ns(packet) == 1_327_104
    assert data_fields(np.frombuffer(after.payload, "u1")[None])["return_mode"] == 0x37
