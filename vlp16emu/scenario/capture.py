"""The `[capture]` table: when the host that records packets takes them to have come."""

from typing import Annotated, Literal

from pydantic import Field

from vlp16emu.settings import Preset

_PRESETS: dict[str, dict[str, object]] = {
    "ideal": {},
    # On mrpt and nebula half of all stamps are within 1 us of an even spacing, and 6 % of nebula's are 10 to 230 us late.
    "quiet_pc": {"jitter_us": 1.3, "late_share": 0.06, "late_us": 60.0, "host_spread": 0.4},
    # Up to 640 us were seen; the law of it is an assumption.
    "busy_pc": {"jitter_us": 40.0, "late_share": 0.04, "late_us": 1500.0, "host_spread": 0.4},
}


class CaptureClock(Preset):
    """The clock of the host that records; only stamps of pcap files follow it."""

    presets = _PRESETS

    preset: Literal["ideal", "quiet_pc", "busy_pc"] = "quiet_pc"
    """Values of the keys that are not given beside it; `ideal` stamps packets when they are due."""
    ppm: Annotated[float, Field(ge=-100, le=100)] | None = None
    """How much the host's clock is fast; drawn unless given, as in captures of real units, where it is -15 to 20 against the sensor's.
    0 with `ideal`."""
    ahead_ms: Annotated[float, Field(ge=-1000, le=1000)] | None = None
    """How far the host's clock is ahead when the first pulse is fired; drawn unless given, one sigma of 3 ms as of a host on NTP
    (assumption). 0 with `ideal`."""
    jitter_us: Annotated[float, Field(ge=0, le=500)] = 0.0
    """Delay of a stamp, one sigma of the normal law whose absolute value it has."""
    late_share: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    """Share of packets that the host is late with; those behind them come in a burst."""
    late_us: Annotated[float, Field(ge=0, le=3000)] = 0.0
    """Mean of that delay, exponential, up to 4.5 ms."""
    host_spread: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Host-to-host spread of jitter, share and delay, one sigma of the logarithm; drawn from the
    seed. 0 for exactly these."""
