"""The `$GPRMC` sentence that a GPS receiver sends each second and the sensor echoes.

Fields and their style follow what real units were seen to echo:
`$GPRMC,081802.00,A,3649.7478558,N,00224.4542928,W,0.034,212.5,210116,0.0,E,A*2E`.
"""

from datetime import UTC, datetime, timedelta

from vlp16emu.errors import PacketError
from vlp16emu.types import GnssFix
from vlp16emu.units import S_NS, US_NS

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
KNOT_M_S = 1852 / 3600  # A nautical mile per hour, exact by definition
_MINUTE_DECIMALS = 7  # decimals that real units echo; 0.2 mm on the ground


def rmc(fix: GnssFix) -> bytes:
    """Write the sentence of one whole second: 13 fields of NMEA 0183 version 2.3 with checksum, CR and LF (63-9243 Rev D, section 7.4).

    If `fix.valid` is false the status is V and the mode letter N, and the last known numbers stay.
    """
    import pynmea2  # here, since a sensor without a receiver does without it

    utc = _EPOCH + timedelta(seconds=fix.t_ns // S_NS)
    fields = (
        f"{utc:%H%M%S}.00",
        "A" if fix.valid else "V",
        _degrees_minutes(fix.latitude_deg, 2),
        "S" if fix.latitude_deg < 0 else "N",
        _degrees_minutes(fix.longitude_deg, 3),
        "W" if fix.longitude_deg < 0 else "E",
        _knots(fix.speed_m_s),
        f"{round(fix.course_deg, 1) % 360:.1f}",
        f"{utc:%d%m%y}",
        "0.0",  # magnetic variation: none known
        "E",
        "A" if fix.valid else "N",
    )
    sentence: str = pynmea2.RMC("GP", "RMC", fields).render(newline=True)
    return sentence.encode("ascii")


def rmc_time(sentence: bytes) -> tuple[int | None, bool]:
    """Read the second that a sentence names, UTC in ns, and whether its status is A; fields of the place may be empty.

    The second is None where a receiver that has just been switched on does not know it.

    Raises PacketError if it lacks `$GPRMC`, CR LF, a right checksum, or time, date and status where they belong.
    """
    fields = fields_of(sentence)
    try:
        valid = {"A": True, "V": False}[fields[1]]
        return (utc_ns(fields[8], fields[0]) // S_NS * S_NS if fields[0] and fields[8] else None), valid
    except (ValueError, KeyError, IndexError) as error:
        raise PacketError("NMEA sentence", repr(sentence), "time, status and date of RMC") from error


def fields_of(sentence: bytes) -> list[str]:
    """Return the fields of a sentence behind its name; errors as `rmc_time`."""
    import pynmea2

    if not (sentence.startswith(b"$GPRMC,") and sentence.endswith(b"\r\n")):
        raise PacketError("NMEA sentence", repr(sentence), "$GPRMC,... that ends with CR LF")
    try:
        fields: list[str] = pynmea2.parse(sentence.decode("ascii"), check=True).data
    except pynmea2.ChecksumError as error:
        raise PacketError("NMEA sentence", repr(sentence), "a right checksum") from error
    except ValueError as error:
        raise PacketError("NMEA sentence", repr(sentence), "the fields of RMC, all filled") from error
    return fields


def _knots(speed_m_s: float) -> str:
    """Write a speed; from 100 knots on a third decimal would take the sentence over the 82 characters of NMEA 0183."""
    knots = speed_m_s / KNOT_M_S
    return f"{knots:.{3 if knots < 99.999 else 2}f}"


def _degrees_minutes(angle_deg: float, width: int) -> str:
    """Write ddmm.mmmm or dddmm.mmmm without sign."""
    # Rounded as a whole: rounding the minutes alone would write 60 of them.
    steps = round(abs(angle_deg) * 60 * 10**_MINUTE_DECIMALS)
    degrees, minutes = divmod(steps, 60 * 10**_MINUTE_DECIMALS)
    whole, fraction = divmod(minutes, 10**_MINUTE_DECIMALS)
    return f"{degrees:0{width}d}{whole:02d}.{fraction:0{_MINUTE_DECIMALS}d}"


def utc_ns(date: str, time: str) -> int:
    """Read ddmmyy, 1969 to 2068, and hhmmss with or without decimals."""
    layout = "%d%m%y%H%M%S.%f" if "." in time else "%d%m%y%H%M%S"
    since = datetime.strptime(date + time, layout).replace(tzinfo=UTC) - _EPOCH
    return since // timedelta(microseconds=1) * US_NS
