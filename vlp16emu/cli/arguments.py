"""Options shared by several verbs; options of runs are in `vlp16emu.run.options`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from vlp16emu.run.options import Option, Options

_SCENE = "Name of a scene (see `vlp16emu scenes`) or path of a .toml file"

SceneName = Annotated[str, Option(f"{_SCENE}.", name="SCENE")]
SceneOrCapture = Annotated[
    str, Option(f"{_SCENE}; or a capture, ours or a real sensor's.", name="SCENE|FILE.pcap")
]
CaptureFile = Annotated[
    Path,
    Option(
        "Capture with VLP-16 packets: pcap or pcapng, also .gz, .bz2, .xz, .zst; or a bag with "
        "/velodyne_packets (.bag, .mcap, a folder of ROS 2).",
        name="FILE.pcap",
    ),
]
Settings = Annotated[
    list[str] | None,
    Option(
        "Change a value of the scene, for instance sensor.rpm=1200. Files are found from the current "
        "folder. May be repeated.",
        "KEY=VALUE",
        "--set",
    ),
]
Threads = Annotated[
    int,
    Option("Workers, 0 for one per core. Changes the speed, never a byte.", "N", ge=0, le=1024, shown=False),
]


@dataclass(frozen=True)
class SceneOptions(Options):
    """Options that change a scene."""

    settings: Settings = None
    ideal: Annotated[bool, Option("A sensor without errors: beams without width, no noise, clear air.")] = (
        False
    )


@dataclass(frozen=True)
class EmulatorOptions(SceneOptions):
    """Options that make an emulator; fields as the parameters of `Emulator`."""

    threads: Threads = 0


@dataclass(frozen=True)
class RunOptions(EmulatorOptions):
    """Options that make an emulator, with the audit that estimates the error of each run."""

    audit: Annotated[
        bool,
        Option("Do not cast 0.05 % of the pulses again to estimate the error of the run.", name="--no-audit"),
    ] = True


TrajectoryFile = Annotated[
    Path | None,
    Option(
        "For a capture: the folder of `record --truth`, for the true trajectory, or any trajectory in "
        "TUM format.",
        "DIR|FILE.tum",
    ),
]
UnitName = Annotated[
    str | None,
    Option(
        "Sensor, if the capture holds several: its number, or its address and data port.", "N|ADDRESS:PORT"
    ),
]
WhichClock = Annotated[
    str | None,
    Option(
        "Clock of all stamps: the sensor's, in the hour nearest to the capture's stamps (sensor) or in "
        "the hour of the GPS sentences (gps), the recording host's (host), or the host's as a line over the "
        "sensor's (fitted). By default the sensor's if it is locked to GPS, else the fitted one.",
        words=("sensor", "gps", "fitted", "host"),
        shown=False,
    ),
]
PlotFile = Annotated[
    Path | None,
    Option("Also draw the report into a file, .png, .svg or .pdf; needs the extra 'plot'.", "FILE", "--plot"),
]
AsJson = Annotated[bool, Option("Print one JSON object and nothing else.", name="--json")]
