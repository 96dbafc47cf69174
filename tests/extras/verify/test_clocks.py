"""`verify` where clocks are set: the host's, the sensor's and UTC itself; and what recorders leave."""

import struct
import zlib

import pytest

from vlp16emu import Emulator
from vlp16emu.captures import Capture
from vlp16emu.extras.verify.frames import Level, Rule
from vlp16emu.extras.verify.run import verify

HOUR_US = 3_600_000_000


@pytest.mark.parametrize("by_s", [18_000, -3_600, -7, 12])
def test_a_host_clock_that_is_set_is_one_note(traffic, by_s):
    """Stamps that step while the sensor's clock goes on are one note; duration and rates are the sensor's."""
    made = traffic(2.5)
    made.stamps_us[900:] = [stamp_us + by_s * 10**6 for stamp_us in made.stamps_us[900:]]
    result = made.verified()
    assert (result.counts, result.notes) == ({}, {Rule.HOST_CLOCK: 1})
    assert result.span_s == pytest.approx(2.5, abs=0.01)
    assert result.findings[0].packet == 901


@pytest.mark.parametrize("gone_s", [2, 1800, 9000])
def test_a_gap_of_both_clocks_is_silence(traffic, gone_s):
    """A suspended computer is silence by both clocks, also over hours, which time stamps do not name."""
    made = traffic(1.2)
    for i in range(600, len(made.frames)):
        made.stamps_us[i] += gone_s * 10**6
        if len(made.frames[i]) == 1248:
            fields = made.payload(i)[0]
            fields["timestamp_us"] = (int(fields["timestamp_us"]) + gone_s * 10**6) % HOUR_US
        else:
            later_us = int.from_bytes(made.frames[i][240:244], "little") + gone_s * 10**6
            made.write_position(i, 198, struct.pack("<I", later_us % HOUR_US))
    result = made.verified()
    assert result.counts[Rule.SILENCE] == 1
    assert Rule.HOST_CLOCK not in result.notes
    assert result.span_s == pytest.approx(gone_s + 1.2, abs=0.02)


def test_stamps_that_are_missing_do_not_shorten_the_duration(traffic):
    """The duration is that of the sensor's clock, where a converter has written stamps of one microsecond
    after the other."""
    made = traffic(1.2)
    made.stamps_us = [made.stamps_us[0] + i for i in range(len(made.frames))]
    assert made.verified().span_s == pytest.approx(1.2, abs=0.01)


@pytest.mark.parametrize("by_us", [1_234_567_890, -765_432_100, 180_000])
@pytest.mark.parametrize("has_state", [True, False])
def test_a_clock_that_gps_sets_loses_no_packets(traffic, by_us, has_state):
    """A step of the sensor's clock is a note where the pulse's state rises, else an error, never lost
    packets."""
    made = traffic(1.2)
    begin = made.data(400)
    for i in range(begin):
        if len(made.frames[i]) == 1248:
            fields = made.payload(i)[0]
            fields["timestamp_us"] = (int(fields["timestamp_us"]) - by_us) % HOUR_US
        else:
            stamp_us = int.from_bytes(made.frames[i][240:244], "little") - by_us
            made.write_position(i, 198, struct.pack("<IB", stamp_us % HOUR_US, 0 if has_state else 2))
    result = made.verified()
    assert result.lost_packets == 0 or not has_state
    assert result.lost_packets < 200
    assert (Rule.TIME_STEP in result.notes) == has_state
    if has_state:
        assert result.counts == {}


@pytest.mark.parametrize("kind", ["data", "position"])
@pytest.mark.parametrize("first", [0, 1, 40])
def test_a_pair_swapped_at_the_start_is_a_change_of_order(traffic, kind, first):
    """Two packets of a kind that have overtaken each other are named, also where the capture begins."""
    made = traffic(0.5)
    i, j = getattr(made, kind)()[first : first + 2]
    made.frames[i], made.frames[j] = made.frames[j], made.frames[i]
    result = made.verified()
    late = {Rule.CLOCK_DRIFT} if kind == "position" else set()  # by 7 ms
    assert set(result.counts) - late == {Rule.PACKET_ORDER}
    assert (result.counts[Rule.PACKET_ORDER], result.lost_packets) == (1, 0)


@pytest.mark.parametrize("is_taken", [True, False])
def test_a_leap_second_is_a_time(traffic, is_taken):
    """23:59:60 is a time of UTC (ITU-R TF.460-6), whether the sensor's clock takes the second or not."""
    made = traffic(3.2)

    def sentence(second):
        time = ("235959", "235960", "000000", "000001", "000002")[max(second, -1) + 1]
        body = f"GPRMC,{time}.00,A,6214.4000000,N,02545.0000000,E,1.100,90.0,311216,0.0,E,A".encode()
        checksum = 0
        for character in body:
            checksum ^= character
        return b"$%b*%02X\r\n" % (body, checksum)

    begin_us = made.stamps_us[0]
    for i, stamp_us in enumerate(made.stamps_us):
        late_us = 10**6 if is_taken and stamp_us - begin_us >= 2 * 10**6 + 2000 else 0
        since_us = stamp_us - begin_us - 350
        if len(made.frames[i]) == 1248:
            fields = made.payload(i)[0]
            if late_us and int(fields["timestamp_us"]) > 10**6 - 2000:
                fields["timestamp_us"] = int(fields["timestamp_us"]) - late_us
        else:
            own_us = int.from_bytes(made.frames[i][240:244], "little")
            text = sentence((since_us - 400_000) // 10**6 - 1)
            made.write_position(i, 206, text)
            if late_us:
                made.write_position(i, 198, struct.pack("<I", own_us - late_us))
    result = made.verified()
    assert not set(result.counts) & {Rule.NMEA_FORMAT, Rule.NMEA_TIME, Rule.NMEA_SECOND, Rule.CLOCK_DRIFT}
    assert Rule.LOST_PACKETS not in result.counts


def test_frames_that_were_cut_are_named(traffic, tmp_path):
    """A frame of which the recorder kept a part is named with both lengths, and with the way out."""
    path = traffic(0.3).save(tmp_path / "whole.pcap")
    content = path.read_bytes()
    short = [content[:24]]
    at = 24
    while at < len(content):
        seconds, fraction, length, wire = struct.unpack_from("<4I", content, at)
        short.append(struct.pack("<4I", seconds, fraction, 96, wire) + content[at + 16 : at + 112])
        at += 16 + length
    path.write_bytes(b"".join(short))
    result = verify(path)
    assert set(result.counts) == {Rule.FRAMING}
    assert "a data frame, 96 of 1248 bytes captured; expected whole frames (`tcpdump -s 0`)" in str(
        result.findings[0]
    )
    assert result.span_s == pytest.approx(0.3, abs=0.01)


def test_a_check_sequence_that_the_header_declares_is_no_part_of_the_packet(traffic, tmp_path):
    """Cards that keep the Ethernet FCS are declared in the link type field (draft-ietf-opsawg-pcap)."""
    made = traffic(0.3)
    made.frames = [frame + struct.pack("<I", zlib.crc32(frame)) for frame in made.frames]
    path = made.save(tmp_path / "fcs.pcap")
    assert set(verify(path).counts) == {Rule.FRAMING}
    content = bytearray(path.read_bytes())
    struct.pack_into("<I", content, 20, 0x2400_0001)  # two words of 16 bits, Ethernet
    path.write_bytes(content)
    assert verify(path).is_clean
    assert {each.wire_bytes for each in Capture(path)} == {1248, 554}


def test_a_speed_that_is_no_multiple_of_60_is_a_note_if_it_is_held(tmp_path):
    """A unit that is set to 500 rpm, as a real one is, gives a clean capture and a note."""
    emulator = Emulator("static_bench", {"beam.model": "none", "sensor.rpm": 500})
    emulator.record(tmp_path / "set.pcap", duration_s=1.0)
    result = verify(tmp_path / "set.pcap")
    assert result.is_clean
    assert result.notes[Rule.SPEED] > 0


def test_a_change_of_speed_is_a_note(tmp_path):
    """A rotor that goes from one held speed to another is a note, revolution by revolution."""
    events = [{"kind": "setting", "at_s": 0.5, "rpm": 900}]
    emulator = Emulator("static_bench", {"beam.model": "none", "events": events})
    emulator.record(tmp_path / "change.pcap", duration_s=4.0)
    result = verify(tmp_path / "change.pcap")
    assert result.is_clean
    assert result.notes[Rule.SPEED] > 0
    assert {finding.level for finding in result.findings if finding.rule is Rule.SPEED} == {Level.NOTE}
