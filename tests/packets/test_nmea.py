"""The $GPRMC sentence: style, rounding, both directions, bad input."""

import dataclasses
import functools
import operator
from datetime import UTC, datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st
from listening import parse_rmc

from vlp16emu.errors import PacketError
from vlp16emu.packets import rmc
from vlp16emu.packets.nmea import rmc_time
from vlp16emu.types import GnssFix

REAL = b"$GPRMC,081802.00,A,3649.7478558,N,00224.4542928,W,0.034,212.5,210116,0.0,E,A*2E\r\n"
OTHER = b"$GPRMC,214106,A,3707.8178,N,12139.2690,W,010.3,188.2,230715,013.8,E,D*05\r\n"
FIX = GnssFix(
    t_ns=1_453_364_282 * 10**9,
    valid=True,
    latitude_deg=62.24,
    longitude_deg=25.75,
    speed_m_s=1.2,
    course_deg=90.0,
)


def signed(body):
    """A sentence with its checksum, the exclusive or of all between $ and *."""
    return b"$" + body + f"*{functools.reduce(operator.xor, body):02X}\r\n".encode()


def fields(**changes):
    return rmc(dataclasses.replace(FIX, **changes)).decode().split(",")


def test_real_sentences_are_read():
    """What a real unit echoed is written back byte for byte; one of another receiver, without decimals in
    its time, is read too."""
    assert rmc(parse_rmc(REAL)) == REAL
    fix = parse_rmc(OTHER)
    assert fix.t_ns == int(datetime(2015, 7, 23, 21, 41, 6, tzinfo=UTC).timestamp()) * 10**9
    assert fix.latitude_deg == pytest.approx(37 + 7.8178 / 60)
    assert fix.longitude_deg == pytest.approx(-(121 + 39.2690 / 60))
    assert fix.speed_m_s == pytest.approx(10.3 * 0.514444, rel=1e-5)


def test_by_hand():
    """Each field and the checksum are what arithmetic on paper gives; without a fix V and N; what rounds
    up to 60 minutes or 360 degrees goes on."""
    assert rmc(FIX) == signed(b"GPRMC,081802.00,A,6214.4000000,N,02545.0000000,E,2.333,90.0,210116,0.0,E,A")
    void = fields(valid=False)
    assert (void[2], void[12][0]) == ("V", "N")
    assert not parse_rmc(rmc(dataclasses.replace(FIX, valid=False))).valid
    assert fields(latitude_deg=36.9999999999999, longitude_deg=-9.9999999999999)[3:7] == [
        "3700.0000000",
        "N",
        "01000.0000000",
        "W",
    ]
    assert fields(course_deg=359.97)[8] == "0.0"


@pytest.mark.parametrize(
    ("knots", "field"),
    [(0, "0.000"), (99.998, "99.998"), (99.9996, "100.00"), (100, "100.00"), (999, "999.00")],
)
def test_speed_takes_six_characters_at_most(knots, field):
    """From 100 knots on a speed has two decimals, so that the longest sentence has the 82 characters of
    NMEA 0183."""
    longest = dataclasses.replace(FIX, speed_m_s=knots * 1852 / 3600, course_deg=212.5)
    assert rmc(longest).decode().split(",")[7] == field
    assert len(rmc(longest)) <= 82


@given(
    st.integers(0, 2**32 // 2 - 1),
    st.booleans(),
    st.floats(-90, 90),
    st.floats(-180, 180),
    st.floats(0, 513.9),
    st.floats(0, 359.9),
)
def test_round_trip(second, valid, latitude_deg, longitude_deg, speed_m_s, course_deg):
    """What is written is read back to its resolution, in 13 fields and at most 82 characters."""
    fix = GnssFix(second * 10**9, valid, latitude_deg, longitude_deg, speed_m_s, course_deg)
    sentence = rmc(fix)
    assert sentence.count(b",") == 12
    assert len(sentence) <= 82  # NMEA 0183
    read = parse_rmc(sentence)
    assert (read.t_ns, read.valid) == (fix.t_ns, fix.valid)
    assert read.latitude_deg == pytest.approx(latitude_deg, abs=1e-9)
    assert read.longitude_deg == pytest.approx(longitude_deg, abs=1e-9)
    assert read.speed_m_s == pytest.approx(speed_m_s, abs=3e-4 if speed_m_s < 51 else 3e-3)
    assert read.course_deg == pytest.approx(course_deg, abs=0.05001)


@pytest.mark.parametrize(
    "damaged",
    [
        b"",
        REAL.replace(b"*2E", b"*2F"),
        REAL.replace(b"*2E", b""),
        REAL[:-2],
        REAL.replace(b"GPRMC", b"GPGGA"),
        b"$GPRMC,081802,A*3D\r\n",
        b"\xff\xfe",
    ],
)
def test_refuses_damaged_sentences(damaged):
    """A sentence that is cut, changed or of another kind is an error that shows it."""
    with pytest.raises(PacketError) as error:
        rmc_time(damaged)
    assert error.value.found == repr(damaged)
