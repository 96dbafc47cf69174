"""What `vlp16emu stream` takes and reports where poses come in while it runs."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from vlp16emu.cli.arguments import option
from vlp16emu.cli.terminal import Progress, count
from vlp16emu.errors import InputError, MissingExtraError

if TYPE_CHECKING:
    from vlp16emu.emulator import Emulator
    from vlp16emu.extras.live.flight import LiveReport
    from vlp16emu.extras.viewer.live import Watch
    from vlp16emu.run.options import PosesIn
    from vlp16emu.scenario import Scenario


PoseIn = Annotated[
    str | None,
    option(
        "--pose-in",
        'Where poses come in, of a scene with motion.kind = "live"; the stream waits for the first one.',
        "udp://HOST:PORT",
    ),
]
FlownFile = Annotated[
    Path | None,
    option("--flown", "Write what such a scene flew, to repeat the run with --set motion.flown=FILE.csv.", "FILE.csv"),
]
View = Annotated[
    bool,
    option(
        "--view",
        "Show stand, sensor, sweep and lateness in the browser while packets leave, by a process that they do not wait for. "
        "Needs the extra 'viewer'.",
    ),
]


@contextmanager
def watched(emulator: "Emulator", *, view: bool, duration_s: float, quiet: bool) -> "Iterator[Watch | None]":
    """Show a stream in the browser, and print where; None where that is not wanted.

    Raises
    ------
    MissingExtraError
        where viser is not there
    """
    if not view:
        yield None
        return
    if find_spec("viser") is None:
        raise MissingExtraError("viser", "viewer", "the page in the browser")
    from vlp16emu.extras.viewer.live import backdrop_of, watching

    with Progress(duration_s):
        backdrop = backdrop_of(emulator, duration_s)
    with watching(emulator, backdrop) as watch:
        print(f"page at {watch.url}", file=sys.stderr if quiet else sys.stdout, flush=True)
        yield watch


def poses_in(
    scenario: "Scenario", where: str | None, flown: Path | None, news: Callable[[str], None]
) -> "PosesIn | None":
    """Take where poses come in; None where they do not.

    Raises
    ------
    InputError
        where the scene wants them, and it is not said where from
    """
    from vlp16emu.motion.live_settings import takes_poses

    if takes_poses(scenario.motion) and where is None:
        raise InputError("--pose-in", 'found motion.kind = "live" without it', "udp://127.0.0.1:PORT")
    if where is None and flown is None:
        return None
    from vlp16emu.run.options import PosesIn

    return PosesIn(where, flown, news)


def late_of(scenario: "Scenario", late: str) -> str:
    """Give what happens to late packets; where poses come in they are dropped."""
    from vlp16emu.motion.live_settings import takes_poses

    return "skip" if takes_poses(scenario.motion) else late


def live_rows(live: "LiveReport | None") -> dict[str, str]:
    """Write what poses came in, and how soon packets followed."""
    if live is None:
        return {}
    left_out = f"{count(live.refused)} refused, {count(live.out_of_order)} out of order"
    rows = {
        "poses": f"{count(live.poses)}, {left_out}, longest gap {live.longest_gap_s:.3f} s",
        "pose to packet": (
            f"median {live.latency_median_us * 1e-3:.1f} ms, 95 % within {live.latency_p95_us * 1e-3:.1f} ms, "
            f"99 % within {live.latency_p99_us * 1e-3:.1f} ms, at most {live.latency_max_us * 1e-3:.1f} ms"
        ),
    }
    if live.left_out_s:
        rows["left out"] = f"{live.left_out_s:.2f} s of pulses, as the engine was late"
    if live.lost:
        times = ", ".join(f"{lost.lasted_s:.1f} s from {lost.at_s:.1f} s on" for lost in live.lost[:3])
        rows["poses lost"] = f"{count(len(live.lost))} x: {times}{', ...' if len(live.lost) > 3 else ''}"
    if live.flown:
        rows["flown"] = f"{live.flown}, repeated with --set motion.flown={live.flown}"
    return rows
