"""The lint for VLP-16 traffic: one damage for each rule, and traffic that breaks none."""

import struct

import pytest

from vlp16emu.extras.verify import Rule, verify_capture

HOUR_US = 3_600_000_000


def rules(verification):
    """Give the rules that are broken."""
    return set(verification.counts)


@pytest.mark.parametrize("dual", [False, True])
@pytest.mark.parametrize("rpm", [300, 600, 1200])
def test_clean_traffic_breaks_no_rule(tmp_path, traffic, rpm, dual):
    """Traffic of single and dual return at three speeds is clean, over the full hour and the azimuth's wrap."""
    made = traffic(2.2, rpm, dual=dual)
    result = verify_capture(made.save(tmp_path / "clean.pcap"))
    assert (result.findings, result.is_clean) == ((), True)
    assert result.data_packets == sum(len(frame) == 1248 for frame in made.frames)
    assert result.position_packets == sum(len(frame) == 554 for frame in made.frames)
    assert result.rpm == pytest.approx(rpm, rel=2e-4)
    assert result.span_s == pytest.approx(2.2, abs=0.01)
    assert (result.lost_packets, result.other_frames, result.is_cut) == (0, 0, False)


def put(offset, content):
    """Overwrite bytes of data frame 900; returns the damage."""

    def damage(made):
        i = made.data(900)
        made.frames[i][offset : offset + len(content)] = content
        return i

    return damage


def set_fields(change):
    """Change fields of the payload of data frame 900."""

    def damage(made):
        i = made.data(900)
        change(made.payload(i)[0])
        return i

    return damage


def position(offset, content):
    """Overwrite bytes in the payload of position frame 200."""

    def damage(made):
        i = made.position(200)
        made.write_position(i, offset, content)
        return i

    return damage


def wrong_length(made):
    """Report a UDP length that is one short."""
    i = made.data(900)
    made.frames[i][38:40] = struct.pack(">H", 1213)
    return i


def vast_length(made):
    """Report a UDP length beyond the frame."""
    i = made.data(900)
    made.frames[i][38:40] = b"\xff\xff"
    return i


def trailer(made):
    """Append a frame check sequence."""
    i = made.data(900)
    made.frames[i] += b"\1\2\3\4"
    return i


def position_checksum(made):
    """Break a UDP checksum."""
    i = made.position(200)
    made.frames[i][41] ^= 1
    return i


def no_position_checksum(made):
    """Leave a UDP checksum out."""
    i = made.position(200)
    made.frames[i][40:42] = b"\0\0"
    return i


def position_beyond_the_hour(made):
    """Report the same time an hour later."""
    i = made.position(200)
    timestamp_us = int.from_bytes(made.frames[i][42 + 198 : 42 + 202], "little")
    made.write_position(i, 198, struct.pack("<I", timestamp_us + HOUR_US))
    return i


def line_end(made):
    """Leave the carriage return out."""
    i = made.position(200)
    made.write_position(i, made.frames[i].index(b"\r\n") - 42, b"\n\0")
    return i


def stamp_back(made):
    """Stamp a packet 3 ms early."""
    i = made.data(900)
    made.stamps_us[i] -= 3000
    return i


def azimuths(change):
    """Change the azimuths of data frame 900, as a plain array."""

    def edit(fields):
        change(fields["blocks"]["azimuth_cdeg"])

    return set_fields(edit)


def back(azimuth_cdeg):
    """Put block 5 behind block 4."""
    azimuth_cdeg[5] = azimuth_cdeg[4] - 1


def stand(azimuth_cdeg):
    """Repeat an azimuth in the middle of the packet."""
    azimuth_cdeg[5] = azimuth_cdeg[4]


def jump(azimuth_cdeg):
    """Put all blocks from 5 on 10 degrees ahead; time does not explain it."""
    azimuth_cdeg[5:] = (azimuth_cdeg[5:].astype(int) + 1000) % 36_000


def over(azimuth_cdeg):
    """Write the same angle one turn ahead."""
    azimuth_cdeg[7] += 36_000 - azimuth_cdeg[7] + azimuth_cdeg[7]


def add(name, amount):
    """Add to a field of the payload."""

    def edit(fields):
        fields[name] = int(fields[name]) + amount

    return set_fields(edit)


def block(field, number, value):
    """Set a field of one block."""

    def edit(fields):
        fields["blocks"][field][number] = value

    return set_fields(edit)


def short_distance(fields):
    """Send a distance of 0.498 m."""
    fields["blocks"]["records"]["distance_lsb"][3, 1, 9] = 249


DAMAGES = {
    "UDP length": (Rule.FRAMING, wrong_length),
    "vast UDP length": (Rule.HEADER, vast_length),
    "frame check sequence": (Rule.FRAMING, trailer),
    "source port of an older sensor": (Rule.PORTS, put(34, b"\x01\xbb")),
    "identification": (Rule.HEADER, put(18, b"\x00\x01")),
    "don't fragment": (Rule.HEADER, put(20, b"\x00\x00")),
    "time to live": (Rule.HEADER, put(22, b"\x40")),
    "type of service": (Rule.HEADER, put(15, b"\x08")),
    "IP checksum": (Rule.HEADER, put(24, b"\x00\x00")),
    "data with UDP checksum": (Rule.HEADER, put(40, b"\x12\x34")),
    "position UDP checksum": (Rule.HEADER, position_checksum),
    "position without UDP checksum": (Rule.HEADER, no_position_checksum),
    "capture stamp": (Rule.STAMP_ORDER, stamp_back),
    "flag": (Rule.FLAG, block("flag", 3, 0xDDFF)),
    "product": (Rule.FACTORY, add("factory", -1)),
    "return mode": (Rule.FACTORY, add("return_mode", 3)),
    "time beyond the hour": (Rule.TIME_RANGE, add("timestamp_us", HOUR_US)),
    "position time beyond the hour": (Rule.TIME_RANGE, position_beyond_the_hour),
    "late time stamp": (Rule.TIME_STEP, add("timestamp_us", 2)),
    "early time stamp": (Rule.TIME_STEP, add("timestamp_us", -2)),
    "azimuth a turn too far": (Rule.AZIMUTH_RANGE, azimuths(over)),
    "azimuth back": (Rule.AZIMUTH_STEP, azimuths(back)),
    "azimuth repeated": (Rule.AZIMUTH_STEP, azimuths(stand)),
    "azimuth ahead": (Rule.AZIMUTH_STEP, azimuths(jump)),
    "short distance": (Rule.DISTANCE_CODE, set_fields(short_distance)),
    "byte in the zeros": (Rule.POSITION_HEAD, position(13, b"\x01")),
    "state of the pulse": (Rule.PPS, position(202, b"\x04")),
    "other sentence": (Rule.NMEA_FORMAT, position(206, b"$GPGGA")),
    "no sentence while locked": (Rule.NMEA_FORMAT, position(206, bytes(100))),
    "digit of the sentence": (Rule.NMEA_CHECKSUM, position(226, b"7")),
    "line end": (Rule.NMEA_END, line_end),
    "remains behind the sentence": (Rule.NMEA_END, position(400, b"x")),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_found_by_its_rule_at_its_packet(tmp_path, traffic, name):
    """One damaged packet among some two thousand is named by number, under the rule it breaks and no other."""
    rule, damage = DAMAGES[name]
    made = traffic()
    number = damage(made) + 1
    result = verify_capture(made.save(tmp_path / "damaged.pcap"))
    assert rules(result) == {rule}
    assert next(finding.packet for finding in result.findings if finding.rule is rule) == number
    assert not result.is_clean


def unequal(fields):
    """Give the odd blocks another reflectivity."""
    fields["blocks"]["records"]["reflectivity"][1::2] ^= 1


def swapped(fields):
    """Put the farther of two returns into the odd block."""
    distance_lsb = fields["blocks"]["records"]["distance_lsb"]
    distance_lsb[4, 0, 0], distance_lsb[5, 0, 0] = 3000, 4000


@pytest.mark.parametrize(
    ("rule", "damage"),
    [
        (Rule.DUAL_AZIMUTH, azimuths(lambda azimuth_cdeg: azimuth_cdeg.__setitem__(3, azimuth_cdeg[3] - 1))),
        (Rule.DUAL_ORDER, set_fields(swapped)),
        (Rule.DUAL_REFLECTIVITY, set_fields(unequal)),
    ],
)
def test_damaged_pairs_are_found(tmp_path, traffic, rule, damage):
    """A broken pair in one dual packet is named by number, under its rule and no other."""
    made = traffic(1.0, dual=True)
    number = damage(made) + 1
    result = verify_capture(made.save(tmp_path / "damaged.pcap"))
    assert [(finding.rule, finding.packet) for finding in result.findings] == [(rule, number)]


def test_a_product_before_release_is_a_note(tmp_path, traffic):
    """Product 0x21 in all packets is a note, as a unit of 2014 sent it; from one packet on it is an error."""
    made = traffic(0.3, 600)
    whole, part = [i for i, frame in enumerate(made.frames) if len(frame) == 1248], made.data(100)
    made.frames[part][-1] = 0x21
    assert rules(verify_capture(made.save(tmp_path / "part.pcap"))) == {Rule.FACTORY}
    for i in whole:
        made.frames[i][-1] = 0x21
    result = verify_capture(made.save(tmp_path / "old.pcap"))
    assert (result.is_clean, result.notes) == (True, {Rule.FACTORY: 1})
    assert str(result.findings[0]) == "packet 1: factory (note): product 0x21; expected 0x22 or 0x24"


def test_one_azimuth_of_36000_is_a_note(tmp_path, traffic):
    """Old firmware sent it for 0; the next code is an error."""
    for code, is_clean in ((36_000, True), (36_001, False)):
        made = traffic(0.3, 600)
        blocks = [made.payload(i)[0]["blocks"]["azimuth_cdeg"] for i, f in enumerate(made.frames) if len(f) == 1248]
        north_cdeg = int(blocks[100][5])
        for azimuth_cdeg in blocks:
            azimuth_cdeg[:] = (azimuth_cdeg.astype(int) - north_cdeg) % 36_000
        blocks[100][5] = code
        result = verify_capture(made.save(tmp_path / f"{code}.pcap"))
        assert (result.is_clean, Rule.AZIMUTH_RANGE in result.notes) == (is_clean, is_clean)


def test_headers_of_veloview_are_notes(tmp_path, traffic):
    """Position packets behind the header of data packets, which old VeloView writes, are taken with notes."""
    made = traffic(0.3, 600)
    canned = bytes.fromhex("607688000000 0800 4500 04d2 0000 4000 ff11 b4aa c0a801c8")
    positions = [i for i, frame in enumerate(made.frames) if len(frame) == 554]
    for i in positions:
        made.frames[i][6:30] = canned
        made.frames[i][40:42] = bytes(2)
    result = verify_capture(made.save(tmp_path / "veloview.pcap"))
    assert (result.is_clean, result.notes) == (True, {Rule.HEADER: len(positions)})
    made.frames[made.data(50)][22] = 64
    assert rules(verify_capture(made.save(tmp_path / "damaged.pcap"))) == {Rule.HEADER}
