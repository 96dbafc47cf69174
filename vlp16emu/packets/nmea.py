"""The `$GPRMC` sentence that a GPS receiver sends each second and the sensor echoes.

Fields and their format follow the echoes of real units:
`$GPRMC,081802.00,A,3649.7478558,N,00224.4542928,W,0.034,212.5,210116,0.0,E,A*2E`.
"""

from datetime import UTC, datetime, timedelta

from vlp16emu.errors import PacketError
from vlp16emu.types import GnssFix
from vlp16emu.units import S_NS, US_NS

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
KNOT_M_S = 1852 / 3600  # A nautical mile per hour, exact by definition
_MINUTE_DECIMALS = 7  # decimals in echoes of real units; 0.2 mm on the ground


def rmc(fix: GnssFix) -> bytes:
    """Write the sentence of one whole second (63-9243 Rev D, section 7.4).

    It has 13 fields of NMEA 0183 v2.3, checksum, CR and LF. If `fix.valid` is false, the status is V and the
    mode letter N, with the last known numbers.
    """
    import pynmea2  # here: a sensor without a receiver does not need it

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
    """Read the second of a sentence, UTC in ns, and whether its status is A; position fields may be empty.

    The second is None if a receiver that has just been switched on does not know it.

    Raises PacketError without `$GPRMC`, CR LF, a correct checksum, or time, date and status in their fields.
    """
    fields = fields_of(sentence)
    try:
        valid = {"A": True, "V": False}[fields[1]]
        return (utc_ns(fields[8], fields[0]) // S_NS * S_NS if fields[0] and fields[8] else None), valid
    except (ValueError, KeyError, IndexError) as error:
        raise PacketError("NMEA sentence", repr(sentence), "time, status and date of RMC") from error


def fields_of(sentence: bytes) -> list[str]:
    """Return the fields of a sentence after its name; errors as in `rmc_time`."""
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
    """Format a speed; from 100 knots on, a third decimal would exceed the 82 characters of NMEA 0183."""
    knots = speed_m_s / KNOT_M_S
    return f"{knots:.{3 if knots < 99.999 else 2}f}"


def _degrees_minutes(angle_deg: float, width: int) -> str:
    """Format ddmm.mmmm or dddmm.mmmm without sign."""
    # The angle is rounded as a whole: rounding the minutes alone could give 60.
    steps = round(abs(angle_deg) * 60 * 10**_MINUTE_DECIMALS)
    degrees, minutes = divmod(steps, 60 * 10**_MINUTE_DECIMALS)
    whole_minutes, fraction = divmod(minutes, 10**_MINUTE_DECIMALS)
    return f"{degrees:0{width}d}{whole_minutes:02d}.{fraction:0{_MINUTE_DECIMALS}d}"


def utc_ns(date: str, time: str) -> int:
    """Read ddmmyy, 1969 to 2068, and hhmmss with or without decimals."""
    layout = "%d%m%y%H%M%S.%f" if "." in time else "%d%m%y%H%M%S"
    since = datetime.strptime(date + time, layout).replace(tzinfo=UTC) - _EPOCH
    return since // timedelta(microseconds=1) * US_NS
