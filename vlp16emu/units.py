"""Named factors between units, exact if the unit is exact.

Time inside the program is int64 nanoseconds since 1970-01-01 UTC without leap seconds.
"""

import math

from vlp16emu.errors import InputError

US_NS = 1_000
MS_NS = 1_000_000
S_NS = 1_000_000_000
HOUR_NS = 3_600 * S_NS
FOREVER_NS = (
    2**62
)  # end of what lasts until the run ends; half of int64, so that the sum of two times fits too
INCLUSIVE = 1.0 + 2.0**-21
"""Factor on a greatest range, so that a surface exactly there is included in spite of float32 rounding."""


def seconds_to_ns(seconds: float) -> int:
    """Return the nearest whole number of nanoseconds.

    Raises InputError for NaN, infinity, and numbers beyond int64.
    """
    if not math.isfinite(seconds):
        raise InputError("time", f"found {seconds} s", "a finite number")
    if abs(seconds) > FOREVER_NS / S_NS:
        raise InputError("time", f"found {seconds:g} s", f"at most {FOREVER_NS / S_NS:g} s")
    return round(seconds * S_NS)


def count_text(number: int) -> str:
    """Format a whole number in groups of three digits (ISO 80000-1, section 7.3.1)."""
    return f"{number:,}".replace(",", " ")
