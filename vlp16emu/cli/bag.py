"""`vlp16emu bag`: a capture and its ground truth into a bag for ROS."""

from pathlib import Path
from typing import Annotated

from vlp16emu.cli.arguments import AsJson, CaptureFile, UnitName, WhichClock
from vlp16emu.cli.printer import finish
from vlp16emu.cli.terminal import stop_on_ctrl_c
from vlp16emu.options import Option
from vlp16emu.run.options import BagOptions


def bag(
    file: CaptureFile,
    out: Annotated[
        Path,
        Option(
            "Bag to write: .mcap (ROS 2), .bag (ROS 1), or a new folder without ending (ROS 2, SQLite).", name="OUT"
        ),
    ],
    options: BagOptions,
    *,
    truth: Annotated[
        Path | None,
        Option(
            "Folder of truth of the same run: odometry, transforms, inertial unit and fixes go into the bag.", "DIR"
        ),
    ] = None,
    unit: UnitName = None,
    clock: WhichClock = None,
    as_json: AsJson = False,
) -> None:
    """Write a capture as a bag for ROS 1 or ROS 2, without ROS.

    Works on recordings of real sensors too. Topics and frames are those of the velodyne driver and of REP 105. All sensors are
    written unless --unit names one. Ctrl-C ends it early and leaves a valid bag.
    """
    from vlp16emu.extras.bag import write_bag

    with stop_on_ctrl_c() as stop:
        result = write_bag(file, out, truth, unit=unit, clock=clock, options=options, stop=stop)
    finish(result, as_json=as_json)
