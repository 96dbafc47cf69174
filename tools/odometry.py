"""SLAM programs on bags by their own command lines, for the tools that score their trajectories."""

import os
import re
import resource
import subprocess
import textwrap
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from toolbox import program, set_words

PACKAGES = (
    *(
        "kiss-icp==1.3.0",
        "kiss-slam==0.0.2",
        "genz-icp==0.3.2",
        "rko-lio==0.4.0",
        "genz-lio==0.1.1",
        "se3-lio==0.2.0",
    ),
    *("evalio==0.6.1", "rosbags==0.11.9", "mcap-ros2-support==0.6.0", "pyyaml"),
)
SETTINGS = ("imu.preset=consumer", "imu.attitude=true", "motion.stand_s=3", "beam.model=none")
SE3_LIO = """\
/**:
  ros__parameters:
    sensors:
      t_exts: [0.0, 0.0, 0.0]
      q_exts: [1.0, 0.0, 0.0, 0.0]
"""
"""SE3-LIO needs a file; this one keeps its defaults, and has the extrinsics of the default rig."""
EVALIO = """\
from enum import auto
from pathlib import Path
import numpy as np
from evalio.datasets import Dataset
from evalio.datasets.botanic_garden import MAP_ROW_TO_IDX, fill_col_by_map
from evalio.datasets.loaders import LidarDensity, LidarFormatParams, LidarMajor
from evalio.datasets.loaders import LidarPointStamp, LidarStamp, RosbagIter
from evalio.types import SE3, ImuParams, LidarParams

class Ours(Dataset):
    walk = auto()
    def data_iter(self):
        starts = LidarStamp.Start, LidarPointStamp.Start
        form = LidarFormatParams(*starts, LidarMajor.Column, LidarDensity.OnlyValidPoints)
        columns = lambda scan: fill_col_by_map(scan, MAP_ROW_TO_IDX)
        topics = "/velodyne_points", "/imu/data"
        return RosbagIter(Path("walk"), *topics, self.lidar_params(), None, form, columns)
    def imu_T_lidar(self): return SE3.identity()
    def imu_params(self):
        return ImuParams(gyro=2.4e-4, accel=1.2e-3, gravity=np.array([0, 0, -9.81]), rate=200.0)
    def lidar_params(self): return LidarParams(num_rows=16, num_columns=1825, min_range=1.0, max_range=100.0)
    def files(self): return [Path("walk")]
"""
"""A custom data set of evalio; its BotanicGarden has a VLP-16 too."""
FORMS = {"folder": "walk", ".bag": "walk.bag"}


@dataclass(frozen=True)
class Run:
    """A program with a configuration, as a user calls it."""

    program: str
    settings: str
    command: str  # command line with {bag}, {folder} of the walk and {out}
    form: str = "folder"  # format of its bag, a key of `FORMS`

    @property
    def name(self) -> str:
        """Name of its folder."""
        return re.sub(r"\W+", "_", f"{self.program} {self.settings}")


KISS = "kiss_icp_pipeline --dataloader rosbag --topic /velodyne_points"
GENZ = "genz_icp_pipeline --dataloader rosbag --topic /velodyne_points"
RKO = "rko_lio -d rosbag --imu /imu/data --lidar /velodyne_points --base_frame velodyne -o {out} -n walk -l"
SE3 = "se3_lio_pipeline {bag} --config {folder}/se3-lio.yaml --output {out} --no-progress"
SE3 += " --imu-topic /imu/data --lidar-topic /velodyne_points"
RUNS = (
    Run("KISS-ICP", "its own", KISS + " {bag}"),
    Run("KISS-ICP", "ours", KISS + " --config {folder}/walk.kiss-icp.yaml {bag}"),
    Run("KISS-SLAM", "its own", KISS.replace("icp", "slam") + " {bag}"),
    Run("KISS-SLAM", "ours", KISS.replace("icp", "slam") + " --config {folder}/kiss-slam.yaml {bag}"),
    Run("GenZ-ICP", "its own", GENZ + " {bag}"),
    Run("GenZ-ICP", "ours", GENZ + " --config {folder}/walk.genz-icp.yaml {bag}"),
    Run("RKO-LIO", "its own", RKO + " {bag}"),
    Run("RKO-LIO", "ours", RKO + " -c {folder}/walk.rko-lio.yaml {bag}"),
    Run("GenZ-LIO", "its velodyne.yaml", "genz_lio_pipeline run {bag} -c {velodyne} -o {out}"),
    Run("SE3-LIO", "its own", SE3, ".bag"),
    *(
        Run("evalio", name, f"evalio run -d ours/walk -p {name} -o {{out}}")
        for name in ("kiss", "genz", "mad", "ct", "form", "loam", "liosam", "dlio")
    ),
)


def recorded(
    scene: str,
    folder: Path,
    duration_s: float,
    settings: Iterable[str],
    forms: Iterable[str],
    pulses: Path | None = None,
) -> Path:
    """Record a walk, and write its bags in these formats.

    `pulses` is a capture of the same walk, where the settings concern the inertial unit alone.
    """
    folder.mkdir(parents=True, exist_ok=True)
    capture, truth = folder / "walk.pcap", folder / "truth"
    words = ["--duration", str(duration_s), *set_words((*SETTINGS, *settings))]
    if not capture.exists() and pulses:
        program("truth", scene, truth, *words)
        capture.hardlink_to(pulses)
    if not capture.exists():
        program("record", scene, capture, "--truth", truth, "--no-audit", *words)
    for form in forms:
        if not (folder / FORMS[form]).exists():
            program("bag", capture, folder / FORMS[form], "--truth", truth, "--for", "all")
    (folder / "se3-lio.yaml").write_text(SE3_LIO)
    (folder / "ours.py").write_text(EVALIO)
    odometry = (folder / "walk.kiss-icp.yaml").read_text().replace("data:", "preprocessing:")
    (folder / "kiss-slam.yaml").write_text("odometry:\n" + textwrap.indent(odometry, "  "))
    return folder


def followed(run: Run, folder: Path, venv: Path) -> tuple[Path | None, float, str]:
    """Run a program on a walk; return its trajectory or None, CPU seconds, and its last line."""
    out = folder / run.name
    velodyne = next(venv.glob("lib/*/site-packages/genz_lio/configs/default/velodyne.yaml"), "")
    places = {"bag": folder / FORMS[run.form], "folder": folder, "out": out, "velodyne": velodyne}
    words = run.command.format(**places).split()
    own = {f"{name}_out_dir": str(out) for name in ("kiss_icp", "kiss_slam", "genz_icp")}
    own |= {**os.environ, "PYTHONPATH": str(folder), "EVALIO_CUSTOM": "ours", "EVALIO_DATA": str(folder)}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    words[0] = str(venv / "bin" / words[0])
    done = subprocess.run(words, check=False, env=own, cwd=folder, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    found = next((file for form in ("*.tum", "*_tum.txt", "*.csv") for file in sorted(out.rglob(form))), None)
    said = (done.stderr.strip() or done.stdout.strip() or "nothing").splitlines()[-1]
    return found, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, said
