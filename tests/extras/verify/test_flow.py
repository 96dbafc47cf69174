"""The lint for VLP-16 traffic: what only shows from packet to packet, and whole captures."""

import functools
import operator
import tracemalloc

import pytest

from vlp16emu.errors import CaptureError
from vlp16emu.extras.verify.frames import Rule
from vlp16emu.extras.verify.run import verify

HOUR_US = 3_600_000_000


@pytest.mark.parametrize(("kind", "first", "count"), [("data", 800, 7), ("position", 160, 2)])
def test_lost_packets_are_one_finding_and_no_cascade(traffic, kind, first, count):
    """Packets missing in a row are found once, by time stamps or by the count in the header, at the packet
    after the hole."""
    made = traffic(1.2)
    of_kind = getattr(made, kind)()
    made.drop(of_kind[first : first + count])
    result = made.verified()
    assert [(f.rule, f.packet) for f in result.findings] == [
        (Rule.LOST_PACKETS, of_kind[first + count] - count + 1)
    ]
    assert result.findings[0].found == f"{count} {kind} packets missing before it"
    assert result.lost_packets == count


def test_outage_of_a_second_breaks_no_other_rule(traffic):
    """When both streams are silent for a second, each reports its lost packets once, rates count them, and
    silence is named."""
    made = traffic(3.4)
    silent = [i for i, t in enumerate(made.stamps_us) if 10**6 < t - made.stamps_us[0] < 2 * 10**6]
    made.drop(silent)
    result = made.verified()
    assert result.counts == {Rule.LOST_PACKETS: 2, Rule.SILENCE: 1}
    assert result.lost_packets == len(silent)
    assert [f.found for f in result.findings if f.rule is Rule.SILENCE] == ["no packet for 1.00 s before it"]


@pytest.mark.parametrize("first_block", [0, 6])
@pytest.mark.parametrize("dual", [False, True])
def test_limited_field_of_view_is_a_gap_and_no_cascade(traffic, first_block, dual):
    """60 degrees and their 16.667 ms left out, inside a packet or between two, are one gap in the
    revolution."""
    made = traffic(1.0, dual=dual)
    made.drop(made.position())
    for i in range(400, len(made.frames)):
        fields = made.payload(i)[0]
        first = first_block if i == 400 else 0
        azimuth_cdeg = fields["blocks"]["azimuth_cdeg"]
        azimuth_cdeg[first:] = (azimuth_cdeg[first:].astype(int) + 6000) % 36_000
        made.stamps_us[i] += 16_667
        if first == 0:
            fields["timestamp_us"] = (int(fields["timestamp_us"]) + 16_667) % HOUR_US
    result = made.verified()
    assert [(f.rule, f.packet) for f in result.findings] == [(Rule.AZIMUTH_GAP, 401)]
    assert result.findings[0].found == "16.7 ms of the revolution left out"
    assert result.is_clean  # a setting of the manual, section 10.1


def test_equal_azimuths_at_the_head_of_a_single_packet_are_found(traffic):
    """Blocks 0 and 1 with one azimuth, which some software takes for dual return, have a rule of their
    own."""
    made = traffic(1.2)
    i = made.data(800)
    azimuth_cdeg = made.payload(i)[0]["blocks"]["azimuth_cdeg"]
    azimuth_cdeg[1] = azimuth_cdeg[0]
    result = made.verified()
    assert result.counts[Rule.SINGLE_AS_DUAL] == 1
    assert set(result.counts) <= {Rule.SINGLE_AS_DUAL, Rule.AZIMUTH_STEP}  # the step behind is twice as wide
    assert {finding.packet for finding in result.findings} == {i + 1}


@pytest.mark.parametrize("rpm", [240, 1320])
def test_speed_outside_the_range_is_found(traffic, rpm):
    """Rotor speeds that no VLP-16 can be set to are reported from the first packet on."""
    result = traffic(0.5, rpm).verified()
    assert set(result.counts) == {Rule.RPM}
    assert result.findings[0].packet == 1
    assert float(result.findings[0].found.split()[0]) == pytest.approx(rpm, rel=1e-3)


def test_old_sentence_is_found_only_while_locked(traffic):
    """A sentence of three seconds before is an error with lock, and without lock a note beside the error
    that lock is lost."""
    lost = {Rule.PPS}
    for pps, broken, notes in (
        (2, {Rule.NMEA_SECOND}, set()),
        *((pps, lost, {Rule.NMEA_SECOND}) for pps in (0, 1, 3)),
    ):
        made = traffic(1.2)
        i = made.position(160)
        made.write_position(i, 206, made.sentence(-2))
        made.write_position(i, 202, bytes([pps]))
        result = made.verified()
        assert (set(result.counts), set(result.notes)) == (broken, notes)
        assert {finding.packet for finding in result.findings} == {i + 1}


@pytest.mark.parametrize(
    ("text", "void", "notes"),
    [
        (b"$GPRMC,095959.00,V,,,,,,,211126,,,N*73", 1, set()),
        (b"$GPRMC,,V,,,,,,,,,,N*53", 0, set()),
        (b"$GPRMC,214106,A,3707.8178,N,12139.2690,W,010.3,188.2,230715,013.8,E,D*05", 0, {Rule.NMEA_SECOND}),
        (b"$GPRMC,095958.,A,3707.,N,12139.,W,,,230715,,,A,V*00", 0, set()),
        (b"$GNRMC,095958,A,3707.8178,N,12139.2690,W,010.3,188.2,230715,,,A*00", 0, {Rule.NMEA_FORMAT}),
    ],
)
def test_sentences_that_nmea_0183_allows_are_accepted(traffic, text, void, notes):
    """Empty fields (u-blox and Arduino-NMEA#10), no decimals (a real unit), status of version 4.1 and
    other talkers break no rule."""
    checksum = functools.reduce(operator.xor, text[1:-3])
    text = text[:-2] + f"{checksum:02X}".encode()
    made = traffic(0.5)
    i = made.position(3)
    made.write_position(i, 202, b"\1\0\0\0" + text + b"\r\n" + bytes(80 - len(text)))
    result = made.verified()
    assert (set(result.counts), set(result.notes)) == ({Rule.PPS}, notes)  # the sensor was locked before
    assert result.void_sentences == void


def test_repeated_identification_is_found(traffic):
    """A position header that does not count on is a header fault, at this packet and at the one that goes
    on."""
    made = traffic(1.2)
    i = made.position(160)
    made.frames[i][18:20] = made.frames[made.position(159)][18:20]
    made.write_position(i, 0, b"\0")
    result = made.verified()
    assert result.findings[0].packet == i + 1
    assert result.findings[0].rule is Rule.HEADER
    assert "one more than before" in result.findings[0].expected


def test_rates_are_found(traffic):
    """Every second position packet, numbered on, is too few; stamps at twice the speed are too many of
    both."""
    made = traffic(2.5)
    positions = made.position()
    for n, i in enumerate(positions[::2]):
        made.frames[i][18:20] = n.to_bytes(2)
        made.write_position(i, 0, b"\0")
    made.drop(positions[1::2])
    result = made.verified()
    assert [(f.rule, f.packet) for f in result.findings] == [(Rule.POSITION_RATE, made.position(-1) + 1)]
    made = traffic(5.0)
    made.stamps_us = [made.stamps_us[0] + (t - made.stamps_us[0]) // 2 for t in made.stamps_us]
    result = made.verified()
    assert set(result.counts) == {Rule.DATA_RATE, Rule.POSITION_RATE, Rule.CLOCK_DRIFT}
    assert {f.found for f in result.findings if f.rule is Rule.DATA_RATE} == {
        "1507.0 data packets per second"
    }


def test_change_of_mode_is_found_once(traffic):
    """A sensor that a user switches from strongest to last gives one note, as the manual (section 10.1)
    lets users do so."""
    made = traffic(1.0)
    for i in (switched := made.data(slice(300, None))):
        made.payload(i)["return_mode"] = 0x38
    result = made.verified()
    assert [(f.rule, f.packet, f.level) for f in result.findings] == [(Rule.FACTORY, switched[0] + 1, "note")]


def test_all_findings_are_counted_and_the_first_ones_kept(traffic):
    """Of 50 broken packets the first three are reported, and 50 are counted."""
    made = traffic(1.2)
    broken = [made.data(k) for k in range(300, 350)]
    for i in broken:
        made.payload(i)[0]["blocks"]["flag"][0] = 0
    result = made.verified(limit_per_rule=3)
    assert result.counts == {Rule.FLAG: 50}
    assert [f.packet for f in result.findings] == [i + 1 for i in broken[:3]]
    assert str(result.findings[0]) == f"packet {broken[0] + 1}: flag: 0000 at block 0; expected ffee"


def test_cut_file_is_reported_and_checked_up_to_there(tmp_path, traffic):
    """A file that ends within a packet is no broken traffic, but the result says that it is cut."""
    path = traffic(0.5).save(tmp_path / "cut.pcap")
    path.write_bytes(path.read_bytes()[:-100])
    result = verify(path)
    assert (result.is_cut, result.is_clean) == (True, True)


def test_capture_without_packets_is_refused(traffic):
    """A capture that holds no VLP-16 packets at all is bad input."""
    made = traffic(0.5)
    made.drop(range(len(made.frames)))
    with pytest.raises(CaptureError, match="no VLP-16 packets; expected data packets on UDP port 2368"):
        made.verified()


def test_memory_does_not_grow_with_the_capture(tmp_path, traffic):
    """A capture twice as long takes no more memory, but for the odd object."""
    peaks = []
    for name, seconds in (("short", 4.0), ("long", 8.0)):  # a chunk of position packets is 3.5 s long
        path = traffic(seconds).save(tmp_path / name)
        tracemalloc.start()
        verify(path)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.1 * peaks[0]
