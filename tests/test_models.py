"""The other sensor models: recorded, checked, and read by velodyne_decoder as the truth says."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import velodyne_decoder
from kit import data_payloads

from vlp16emu import Emulator, verify
from vlp16emu.errors import ScenarioError
from vlp16emu.packets import data_fields, points_in
from vlp16emu.packets.decode import layouts_of
from vlp16emu.packets.layout import PRODUCTS
from vlp16emu.run.options import TruthTo
from vlp16emu.scenario import load
from vlp16emu.sensor.beams import MODELS as MODELS_BY_NAME
from vlp16emu.types import PacketKind, SensorModel

parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is in the extra data")

ROOT = Path(__file__).resolve().parents[1]
MODELS = ["hdl-32e", "vlp-32c", "vls-128"]
SPAN_S = 0.12
WALK = 'motion={kind="walk", way_points_m=[[-10, 0], [0, 3], [10, 0]], gait={preset="none"}, harness={}}'
EACH = [(model, mode) for model in MODELS for mode in ("strongest", "last", "dual")]


@pytest.fixture(scope="module", params=EACH, ids="-".join)
def run(request, tmp_path_factory):
    """A tenth of a second in the hall: model, emulator, capture and truth of each return."""
    model, mode = request.param
    folder = tmp_path_factory.mktemp("model")
    settings = [WALK, f"sensor.model={model}", f"sensor.return_mode={mode}", "sensor.eccentricity_deg=0.0"]
    emulator = Emulator(load("static_bench", settings))
    to = TruthTo(folder / "truth", per_return=True)
    result = emulator.record(folder / "made.pcap", duration_s=SPAN_S, truth=to)
    return (
        SensorModel(model),
        result,
        folder / "made.pcap",
        parquet.read_table(folder / "truth/returns.parquet"),
    )


def test_it_is_what_a_sensor_sends(run):
    """`verify` finds nothing in it, and as many returns as were sent are read again."""
    model, result, path, _ = run
    checked = verify(path)
    assert (checked.findings, checked.model) == ((), model)
    points = points_in(data_fields(data_payloads(path)), keep_repeats=True)
    assert len(points.slot) == result.returns > 20_000


def test_each_record_has_its_truth(run):
    """Ranges of the truth, in the unit of the model, are the distances in the packets, all of them."""
    model, _, path, table = run
    fields = data_fields(data_payloads(path))
    distance_m = (
        fields["blocks"]["records"]["distance_lsb"].reshape(-1) * layouts_of(fields)[0].model.distance_lsb_m
    )
    range_m = table["range_m"].fill_null(0.0).to_numpy()
    assert np.abs(range_m - distance_m).max() <= layouts_of(fields)[0].model.distance_lsb_m / 2 + 1e-5
    assert (table["miss"].to_numpy() == (distance_m == 0)).all()
    assert (table["instance"].null_count == (distance_m == 0).sum()) or model is SensorModel.VLS_128


def test_another_decoder_sees_the_truth(run):
    """velodyne_decoder has the points of the truth: as many, in the same order, and as near as the codes of
    distance and azimuth allow; of a VLS-128 it knows no speed in the first packet."""
    model, _, path, table = run
    config = velodyne_decoder.Config(min_range=0, max_range=300)
    payloads = data_payloads(path)
    packets = [velodyne_decoder.VelodynePacket(i * 1e-3, one.tobytes()) for i, one in enumerate(payloads)]
    _, theirs = velodyne_decoder.ScanDecoder(config).decode(packets, as_pcl_structs=True)
    rows = table.filter(~(table["miss"].to_numpy() | table["repeat"].to_numpy()))
    copies = 1 + (payloads[0, 1204] == 0x39)
    packet, block, channel = (rows[name].to_numpy().astype(int) for name in ("packet", "block", "channel"))
    rows = rows.take(np.lexsort((block % copies, channel, block // copies, packet)))
    our_m = np.column_stack([rows[f"{axis}_m"].to_numpy() for axis in "xyz"])
    their_m = np.column_stack([theirs[axis] for axis in "xyz"])
    assert len(our_m) == len(their_m) > 20_000
    away_m = np.linalg.norm(their_m - our_m, axis=1)[rows["packet"].to_numpy() > 0]
    range_m = rows["range_m"].to_numpy()[rows["packet"].to_numpy() > 0]
    # Half a code of distance and a code of azimuth; of a VLS-128 the slot in which its times differ too.
    turned_deg = 0.03 if model is SensorModel.VLS_128 else 0.016
    assert (away_m < 0.0022 + np.radians(turned_deg) * range_m).all()


@pytest.mark.parametrize("model", MODELS)
def test_a_field_of_view(model, tmp_path):
    """With a field of view the packets that are counted are sent, and only azimuths inside are in them."""
    events = [{"kind": "setting", "at_s": 0.0, "fov_deg": [30, 120]}]
    emulator = Emulator("static_bench", {"sensor.model": model, "events": events})
    blocks = data_fields(data_payloads(emulator.packets(0.0, 0.15)))["blocks"]
    timeline = emulator.engine.parts.units[0].timeline
    assert len(blocks) == timeline.count(0, 150_000_000)
    azimuth_deg = blocks["azimuth_cdeg"] / 100
    assert ((azimuth_deg >= 30) & (azimuth_deg < 121)).all()
    assert len(np.unique(azimuth_deg.astype(int))) > 80


@pytest.mark.parametrize("model", MODELS)
def test_a_rig_of_two_models(model):
    """A model above a VLP-16: each sends the packets that it would send alone, in any number of threads, also
    where firing sequences last longer than the VLP-16's."""
    mount = "{lever_arm_m=[0.0, 0.0, -0.2]}"
    rig = f"rig=[{{name='below', model='vlp-16', mount={mount}, seed=9}}]"
    both = [
        list(
            Emulator(load("static_bench", [WALK, f"sensor.model={model}", rig]), threads=n).packets(0.0, 0.2)
        )
        for n in (1, 3)
    ]
    assert both[0] == both[1]
    upper = Emulator(load("static_bench", [WALK, f"sensor.model={model}"])).packets(0.0, 0.2)
    lower = Emulator(load("static_bench", [WALK, f"motion.mount={mount}", "seed=9"])).packets(0.0, 0.2)
    for number, alone in enumerate((upper, lower)):
        sent, expected = (
            [packet.payload for packet in packets if packet.kind is PacketKind.DATA and packet.unit == unit]
            for packets, unit in ((both[0], number), (list(alone), 0))
        )
        assert sent == expected
        assert len(sent) > 100


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (["sensor.max_range_m=140"], "at most 131.07 m as max_range_m, the largest distance code of vlp-16"),
        (["sensor.model=vls-64"], "vls-128"),
        (
            ["sensor.model=vlp-32c", 'events=[{kind="dead_laser", at_s=0.1, laser=32}]'],
            "laser of at most 31, the sensor's lasers",
        ),
    ],
)
def test_what_no_model_is_is_refused(settings, expected):
    """A range beyond the codes, an unknown name, and a laser that is not there are one clear line."""
    with pytest.raises(ScenarioError, match=expected):
        load("static_bench", settings)


MADE_UP = """
title = "Made-Up 64"
manual = "none"
[packet]
product = 0x77
flags = [0xEEFF, 0xDDFF]
distance_mm = 5
minimum_code = 100
stamp_after_first_ns = 0
[firing]
sequence_ns = 64_000
slot_ns = 3_000
slots = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15]
lasers_per_slot = 4
[frame]
is_known = false
[motor]
rpm = [300, 1_200]
[beams]
elevation_deg = [ELEVATIONS]
azimuth_offset_deg = [-3, -1, 1, 3]
vertical_correction_mm = [ZEROS]
lens_radius_mm = 40.0
"""
USE = """
import json
from vlp16emu import Emulator, decode, verify
from vlp16emu.scenario import schema
for mode in ("strongest", "dual"):
    emulator = Emulator("static_bench", {"sensor.model": "made-up-64", "sensor.return_mode": mode})
    emulator.record(f"{mode}.pcap", duration_s=0.25)
    checked = verify(f"{mode}.pcap")
    scan = next(decode(f"{mode}.pcap"))
    print(json.dumps([checked.findings, checked.model, sorted(set(scan.ring.tolist())), len(scan.ring)]))
print(json.dumps("made-up-64" in json.dumps(schema())))
"""


def test_a_new_model_is_a_table(tmp_path):
    """A table more in the folder is a model of 64 lasers in two blocks, four at once: scenes may name it, its
    packets are recorded, verified and decoded, and the schema for editors lists it."""
    checkout = tmp_path / "checkout"
    (checkout / "protocol/models").mkdir(parents=True)
    for name in ("vlp16emu", "pyproject.toml", "scenes"):
        (checkout / name).symlink_to(ROOT / name)
    for path in (ROOT / "protocol").iterdir():
        if path.name != "models":
            (checkout / "protocol" / path.name).symlink_to(path)
    for path in (ROOT / "protocol/models").iterdir():
        (checkout / "protocol/models" / path.name).symlink_to(path)
    elevations = ", ".join(f"{-25 + 0.625 * n}" for n in range(64))
    table = MADE_UP.replace("ELEVATIONS", elevations).replace("ZEROS", ", ".join(["0.0"] * 64))
    (checkout / "protocol/models/made-up-64.toml").write_text(table)
    environment = os.environ | {"PYTHONPATH": str(checkout)}
    done = subprocess.run(
        [sys.executable, "-c", USE],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    *records, is_listed = map(json.loads, done.stdout.splitlines())
    assert is_listed
    for findings, model, rings, points in records:
        assert (findings, model, rings) == ([], "made-up-64", [*range(64)])
        assert points == pytest.approx(
            64 * 0.1 / 64e-6, rel=0.01
        )  # each pulse of a turn has a return, in the hall


def test_each_product_byte_is_read_as_one_model():
    """Models with the same product byte agree on the one that packets are taken for, which has that byte."""
    for model in MODELS_BY_NAME.values():
        read_as = MODELS_BY_NAME[model.read_as]
        assert (read_as.product, read_as.read_as) == (model.product, model.read_as)
        assert PRODUCTS[model.product] is model.read_as


@pytest.mark.parametrize(
    ("model", "beat_m", "counts"), [("vlp-16", 0.006, True), ("hdl-32e", 0.0, False), ("vls-128", 0.0, True)]
)
def test_a_model_has_the_noise_of_its_units(model, beat_m, counts):
    """A unit of a model without a beat or counts has none, whatever the VLP-16 has; what a scene sets and the
    other presets stay."""
    scenario = load("static_bench", [f"sensor.model={model}", "noise.preset=unit"])
    noise = scenario.noise.of_model(scenario.sensor.unit_noise)
    assert (noise.range_beat_m, noise.range_counts) == (beat_m, counts)
    (unit,) = Emulator(scenario).engine.parts.units
    assert unit.detector.range_beat_m.any() == (beat_m > 0)
    own = load("static_bench", [f"sensor.model={model}", "noise.preset=unit", "noise.range_beat_m=0.004"])
    assert own.noise.of_model(own.sensor.unit_noise).range_beat_m == 0.004
    typical = load("static_bench", [f"sensor.model={model}", "noise.preset=typical"]).noise
    assert typical.of_model(scenario.sensor.unit_noise) == typical
