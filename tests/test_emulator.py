"""The whole chain: the same bytes however the work is cut, and distances that are true."""

import hashlib
import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from woods import THIN

from vlp16emu import Emulator
from vlp16emu.errors import InputError, TrajectoryError
from vlp16emu.packets import DATA_PAYLOAD
from vlp16emu.scenario import find, load
from vlp16emu.types import PacketKind

BLOCK_S = 1920 * 55_296e-9
STRETCH_S = 64 * BLOCK_S
BLOWS = {"sensor.max_range_m": 8.0, "wind.speed_m_s": 9.0, "wind.towards_deg": 70.0}


def digest(packets):
    """Hash of everything that leaves: kinds, times and bytes."""
    sha = hashlib.sha256()
    for packet in packets:
        sha.update(f"{packet.kind} {packet.due_ns} ".encode() + packet.payload)
    return sha.hexdigest()


def hall(*settings):
    return load("static_bench", settings)


@pytest.fixture(scope="module")
def birch():
    """A short piece of forest, thin enough to be quick."""
    return load("birch_walk", THIN)


@pytest.mark.usefixtures("kept_woods")  # in what order they grow changes nothing: test_forest.py of the stand
@pytest.mark.parametrize("settings", [{}, BLOWS], ids=["still", "wind"])
def test_threads_and_cuts_do_not_change_a_byte(settings):
    """A run by three threads, across the change of a window and in pieces that begin anywhere, also in the
    middle of a packet, equals the run by one in one go."""
    scenario, start, stop = load("birch_walk", THIN | settings), STRETCH_S - 0.08, STRETCH_S + 0.08
    one = Emulator(scenario, threads=1)
    whole = digest(one.packets(start, stop))
    cuts = [start, start + 0.0004, STRETCH_S - BLOCK_S / 3, STRETCH_S + 0.0501, stop]
    spans = [Emulator(scenario, threads=3, like=one).packets(*span_s) for span_s in itertools.pairwise(cuts)]
    assert digest(itertools.chain.from_iterable(spans)) == whole


def test_a_path_is_a_file_whatever_its_name(tmp_path, monkeypatch):
    """A `Path` without a folder or a suffix is read, and spared as an input."""
    monkeypatch.chdir(tmp_path)
    (scene := Path("bench")).write_bytes(find("static_bench").read_bytes())
    assert Emulator(scene).files == (scene,)


def test_walk_ends_where_its_path_ends(birch):
    """A span beyond the walk's run time is refused before anything is computed."""
    with pytest.raises(
        TrajectoryError,
        match=r"duration: found 600 s; expected at most the walk's 7\d\.\d s; longer with motion.laps",
    ):
        Emulator(birch).packets(0, 600)


def test_nothing_is_before_the_first_pulse(birch):
    """A span that begins earlier is refused, of packets and of returns."""
    for span in (Emulator(birch).packets, Emulator(birch).returns):
        with pytest.raises(TrajectoryError, match=r"^start: found -0.5 s; expected 0 s or later$"):
            span(-0.5, 1.0)


@pytest.mark.parametrize("seconds", [math.nan, math.inf])
def test_a_time_that_is_none_is_refused(birch, seconds):
    """NaN and infinity are refused at either end of a span."""
    for span_s in ((seconds, 1.0), (0.0, seconds)):
        with pytest.raises(
            InputError, match=f"^time: found {seconds} s; expected a finite number$|^duration: "
        ):
            Emulator(birch).packets(*span_s)


@pytest.mark.parametrize("seconds", [1.3e6, 9.3e9, 1e300])
def test_a_time_beyond_the_longest_run_is_refused(seconds):
    """A span that begins or ends later than two weeks is refused, also where its nanoseconds would not fit
    int64."""
    for span_s in ((seconds, seconds + 0.01), (0.0, seconds)):
        with pytest.raises(InputError, match=r"^(duration|time): found \S+ s; expected at most \S+ s"):
            Emulator("static_bench").packets(*span_s)


ENCODER = "sensor.eccentricity_deg=0.06", "sensor.azimuth_noise_deg=0.005"
"""Errors that sensors have by default; the scene has none."""


@pytest.mark.parametrize("seed", range(3))
def test_a_run_begins_with_a_whole_scan(seed):
    """By default the first readings of the encoder are past north, so that readers make no first scan of
    one packet."""
    first = next(
        p
        for p in Emulator(load("static_bench", [f"seed={seed}", *ENCODER])).packets(0.0, 0.01)
        if p.kind is PacketKind.DATA
    )
    azimuth_deg = np.frombuffer(first.payload, DATA_PAYLOAD)["blocks"]["azimuth_cdeg"][0] / 100
    assert azimuth_deg[0] < 0.3
    assert (np.diff(azimuth_deg) > 0.3).all()
