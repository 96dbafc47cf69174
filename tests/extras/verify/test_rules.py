"""The lint for VLP-16 traffic: one damage for each rule, and traffic that breaks none."""

import struct

import pytest

from vlp16emu.extras.verify.frames import Rule

HOUR_US = 3_600_000_000


@pytest.mark.parametrize("dual", [False, True])
@pytest.mark.parametrize("rpm", [300, 600, 1200])
def test_clean_traffic_breaks_no_rule(traffic, rpm, dual):
    """Traffic of single and dual return at three speeds is clean, over the full hour and the azimuth's
    wrap."""
    made = traffic(2.2, rpm, dual=dual)
    result = made.verified()
    assert (result.findings, result.is_clean) == ((), True)
    assert (result.data_packets, result.position_packets) == (len(made.data()), len(made.position()))
    assert result.rpm == pytest.approx(rpm, rel=2e-4)
    assert result.span_s == pytest.approx(2.2, abs=0.01)
    assert (result.lost_packets, result.other_frames, result.is_cut) == (0, 0, False)


def frame(offset, content, kind="data"):
    """Overwrite bytes of data frame 800, or of position frame 160; returns the damage."""

    def damage(made):
        i = made.data(800) if kind == "data" else made.position(160)
        made.frames[i][offset : offset + len(content)] = content
        return i

    return damage


def field(*path, to):
    """Change a field of the payload of data frame 800: to a value, or to what a function makes of the old
    one."""

    def damage(made):
        i = made.data(800)
        *names, last = path
        at = made.payload(i)[0]
        for name in names:
            at = at[name]
        at[last] = to(at[last]) if callable(to) else to
        return i

    return damage


def azimuths(change):
    return field("blocks", "azimuth_cdeg", slice(None), to=change)


def position(offset, content):
    """Overwrite bytes in the payload of position frame 160; both may be functions of the payload."""

    def damage(made):
        i = made.position(160)
        payload = bytes(made.frames[i][42:])
        at, what = (each(payload) if callable(each) else each for each in (offset, content))
        made.write_position(i, at, what)
        return i

    return damage


def an_hour_later(payload):
    return struct.pack("<I", int.from_bytes(payload[198:202], "little") + HOUR_US)


def stamp_back(made):
    i = made.data(800)
    made.stamps_us[i] -= 3000
    return i


DAMAGES = {
    "UDP length": (Rule.FRAMING, frame(38, struct.pack(">H", 1213))),
    "vast UDP length": (Rule.HEADER, frame(38, b"\xff\xff")),
    "frame check sequence": (Rule.FRAMING, frame(1248, b"\1\2\3\4")),
    "source port of an older sensor": (Rule.PORTS, frame(34, b"\x01\xbb")),
    "identification": (Rule.HEADER, frame(18, b"\x00\x01")),
    "don't fragment": (Rule.HEADER, frame(20, b"\x00\x00")),
    "time to live": (Rule.HEADER, frame(22, b"\x40")),
    "type of service": (Rule.HEADER, frame(15, b"\x08")),
    "IP checksum": (Rule.HEADER, frame(24, b"\x00\x00")),
    "data with UDP checksum": (Rule.HEADER, frame(40, b"\x12\x34")),
    "position UDP checksum": (Rule.HEADER, frame(40, b"\x12\x34", "position")),
    "position without UDP checksum": (Rule.HEADER, frame(40, b"\0\0", "position")),
    "capture stamp": (Rule.STAMP_ORDER, stamp_back),
    "flag": (Rule.FLAG, field("blocks", "flag", 3, to=0xDDFF)),
    "product": (Rule.FACTORY, field("factory", to=0x21)),
    "return mode": (Rule.FACTORY, field("return_mode", to=0x3A)),
    "time beyond the hour": (Rule.TIME_RANGE, field("timestamp_us", to=lambda us: int(us) + HOUR_US)),
    "position time beyond the hour": (Rule.TIME_RANGE, position(198, an_hour_later)),
    "late time stamp": (Rule.TIME_STEP, field("timestamp_us", to=lambda us: us + 2)),
    "early time stamp": (Rule.TIME_STEP, field("timestamp_us", to=lambda us: us - 2)),
    "azimuth a turn too far": (
        Rule.AZIMUTH_RANGE,
        field("blocks", "azimuth_cdeg", 7, to=lambda a: int(a) + 36_000),
    ),
    "azimuth back": (Rule.AZIMUTH_STEP, azimuths(lambda a: [*a[:5], a[4] - 1, *a[6:]])),
    "azimuth repeated": (Rule.AZIMUTH_STEP, azimuths(lambda a: [*a[:5], a[4], *a[6:]])),
    # Time does not explain ten degrees.
    "azimuth ahead": (
        Rule.AZIMUTH_STEP,
        azimuths(lambda a: [*a[:5], *((a[5:].astype(int) + 1000) % 36_000)]),
    ),
    "short distance": (Rule.DISTANCE_CODE, field("blocks", "records", "distance_lsb", (3, 25), to=249)),
    "byte in the zeros": (Rule.POSITION_HEAD, position(13, b"\x01")),
    "state of the pulse": (Rule.PPS, position(202, b"\x04")),
    "other sentence": (Rule.NMEA_FORMAT, position(206, b"$GPGGA")),
    "no sentence while locked": (Rule.NMEA_FORMAT, position(206, bytes(100))),
    "digit of the sentence": (Rule.NMEA_CHECKSUM, position(226, b"7")),
    "line end": (Rule.NMEA_END, position(lambda payload: payload.index(b"\r\n"), b"\n\0")),
    "remains behind the sentence": (Rule.NMEA_END, position(400, b"x")),
    "azimuth of a pair": (Rule.DUAL_AZIMUTH, azimuths(lambda a: [*a[:3], a[3] - 1, *a[4:]])),
    "last return nearer": (
        Rule.DUAL_ORDER,
        field("blocks", "records", "distance_lsb", ([4, 5], 0), to=[3000, 4000]),
    ),
    "reflectivity of pairs": (
        Rule.DUAL_REFLECTIVITY,
        field("blocks", "records", "reflectivity", slice(1, None, 2), to=lambda old: old ^ 1),
    ),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_found_by_its_rule_at_its_packet(traffic, name):
    """One damaged packet among a thousand is named by number, under the rule it breaks and no other."""
    rule, damage = DAMAGES[name]
    made = traffic(1.0, dual=True) if rule.startswith("dual") else traffic(1.2)
    number = damage(made) + 1
    result = made.verified()
    assert set(result.counts) == {rule}
    assert next(finding.packet for finding in result.findings if finding.rule is rule) == number
    assert not result.is_clean
    if name == "azimuth of a pair":  # quoted as they are in the packet
        even, odd = made.payload(number - 1)[0]["blocks"]["azimuth_cdeg"][2:4]
        assert result.findings[0].found == f"azimuths {even} and {odd} at blocks 2 and 3"


def test_one_azimuth_of_36000_is_a_note(traffic):
    """Old firmware sent it for 0; the next code is an error."""
    for code, is_clean in ((36_000, True), (36_001, False)):
        made = traffic(0.3, 600)
        blocks = [made.payload(i)[0]["blocks"]["azimuth_cdeg"] for i in made.data()]
        north_cdeg = int(blocks[100][5])
        for azimuth_cdeg in blocks:
            azimuth_cdeg[:] = (azimuth_cdeg.astype(int) - north_cdeg) % 36_000
        blocks[100][5] = code
        result = made.verified()
        assert (result.is_clean, Rule.AZIMUTH_RANGE in result.notes) == (is_clean, is_clean)
