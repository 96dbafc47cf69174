"""`vlp16emu bag`: a capture and its truth into a bag for ROS."""

from pathlib import Path
from typing import Annotated

from vlp16emu.cli.arguments import AsJson, CaptureFile, argument, option
from vlp16emu.cli.terminal import count, finish, stop_on_ctrl_c, tree_of


def bag(
    file: CaptureFile,
    out: Annotated[
        Path,
        argument("OUT", "Bag to write: .mcap (ROS 2), .bag (ROS 1), or a new folder without ending (ROS 2, SQLite)."),
    ],
    *,
    truth: Annotated[
        Path | None,
        option(
            "--truth",
            "Folder of truth of the same run: odometry, transforms, inertial unit and fixes go into the bag.",
            "DIR",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write a capture as a bag for ROS 1 or ROS 2, without ROS.

    Works on recordings of real sensors too. Topics and frames are those of the velodyne driver, with stamps of the sensor's
    clock. Ctrl-C ends it early and leaves a valid bag.
    """
    from vlp16emu.extras.bag import write_bag

    with stop_on_ctrl_c() as stop:
        made = write_bag(file, out, truth, stop=stop)
    rows = {topic: f"{count(number)} messages" for topic, number in made.messages.items()}
    finish(tree_of(made), made.file, {"duration": f"{made.duration_s:.3f} s", **rows}, as_json=as_json)
