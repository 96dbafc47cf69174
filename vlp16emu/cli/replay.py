"""`vlp16emu replay`: a capture over UDP again."""

import sys
from typing import TYPE_CHECKING, Annotated

from vlp16emu.cli.arguments import AsJson, CaptureFile, DataPort, PositionPort, option
from vlp16emu.cli.stream import (
    AsSensor,
    Interface,
    LatePolicy,
    Now,
    Speed,
    Strict,
    To,
    close,
    lateness_rows,
    moved_row,
    receiver_of,
)
from vlp16emu.cli.terminal import count, stop_on_ctrl_c

if TYPE_CHECKING:
    from vlp16emu.run.replay import Replay, Replayed


def replay(
    file: CaptureFile,
    *,
    to: To = None,
    data_port: DataPort = None,
    position_port: PositionPort = None,
    loop: Annotated[
        bool, option("--loop", "Begin again at the end, until Ctrl-C; time stamps and sentences go on.")
    ] = False,
    now: Now = False,
    speed: Speed = 1.0,
    late: LatePolicy = "pace",
    as_sensor: AsSensor = False,
    interface: Interface = None,
    strict: Strict = False,
    as_json: AsJson = False,
) -> None:
    """Send a capture over UDP again, ours or a real sensor's.

    Each packet leaves as long after the first one as its frame was captured after the first frame, to the ports
    of the capture. Nothing leaves this machine unless --to names another one. Ctrl-C ends it.
    """
    from vlp16emu.run.replay import replay as replayed_to

    to, data_port = receiver_of(to, data_port, interface)
    with stop_on_ctrl_c() as stop:
        replayed = replayed_to(
            file,
            to=to,
            data_port=data_port,
            position_port=position_port,
            loop=loop,
            now=now,
            speed=speed,
            late=late,
            as_sensor=as_sensor or interface is not None,
            interface=interface,
            opened=lambda capture: None if as_json else _announce(capture, to),
            notify=lambda behind: print(
                f"behind: {behind.behind_s:.3f} s late at {behind.at_s:.1f} s", file=sys.stderr, flush=True
            ),
            stop=stop,
        )
    close(replayed, f"{replayed.file} to {replayed.to}", _rows, strict=strict, as_json=as_json)


def _announce(capture: "Replay", to: str) -> None:
    units = ", ".join(map(str, capture.units))
    print(f"replaying {capture.path} to {to}: sensors {units}", flush=True)


def _rows(replayed: "Replayed") -> dict[str, str]:
    ports = "; ".join(f"{data} and {position}" for data, position in replayed.ports)
    rows = {
        "sensors": ", ".join(replayed.units),
        "to ports": ports,
        "data packets": count(replayed.packets),
        "position packets": count(replayed.position_packets),
        "replayed": f"{replayed.capture_s:.1f} s in {replayed.wall_s:.1f} s",
        **lateness_rows(replayed),
    }
    if replayed.skipped:
        rows["skipped"] = f"{count(replayed.skipped)} packets"
    if replayed.passes > 1:
        rows["passes"] = count(replayed.passes)
    if replayed.left_out:
        rows["left out"] = f"{count(replayed.left_out)} datagrams that are no packets of a VLP-16"
    if replayed.moved_s:
        rows["moved"] = moved_row(replayed)
    return rows
