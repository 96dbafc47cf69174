"""Every scene that ships."""

import numpy as np
import pytest
from kit import data_payloads

from vlp16emu import Emulator
from vlp16emu.packets import data_fields, decode_data
from vlp16emu.scenario import load, scene_files
from vlp16emu.units import S_NS

pytestmark = pytest.mark.usefixtures("kept_woods")

SCENES = list(scene_files().values())
NAMES = list(scene_files())


def test_the_plot_is_where_its_receiver_is():
    """The origin of `own_plot` in UTM zone 33N and its latitude and longitude are one place by PROJ,
    within a metre."""
    pyproj = pytest.importorskip("pyproj")
    scenario = load("own_plot")
    to_map = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:25833", always_xy=True)
    place_m = to_map.transform(scenario.gps.longitude_deg, scenario.gps.latitude_deg)
    assert place_m == pytest.approx(scenario.world.origin_m[:2], abs=1.0)


@pytest.mark.parametrize("path", SCENES, ids=NAMES)
def test_a_walk_is_as_long_as_its_scene(path):
    """Packets may be asked for to the end of a scene, and at each second of it the first sensor is
    somewhere."""
    emulator = Emulator(load(str(path)))
    emulator.packets(0.0, emulator.scenario.duration_s)
    t_ns = emulator.scenario.start_ns + np.arange(0, int(emulator.scenario.duration_s)) * S_NS
    assert np.isfinite(emulator.world_T_sensor(t_ns)).all()


FEW = ("stems_per_ha=15", "regeneration.stems_per_ha=0", "shrubs.per_ha=0", "storeys=[]")
"""Of a stand: how dense each is, `test_presets.py` looks at without a ray."""


@pytest.mark.parametrize("path", SCENES, ids=NAMES)
def test_a_scene_gives_valid_packets(path):
    """Data packets of a revolution in a scene's world, with few trees, decode, in the scene's mode and
    with returns in the sensor's range."""
    settings, kind = ["sensor.max_range_m=8.0"], load(str(path)).world.kind
    if kind != "hall":  # a small window, all of faces, is enough
        settings += ["world.near_m=8", "motion={kind='static', x_m=10.0, y_m=10.0, height_m=1.5}"]
        settings += [f"world.{one}" for one in FEW] if kind == "forest" else []
    scenario = load(str(path), settings)
    # A whole revolution: a single packet may look at the sky, or between stems.
    packets = list(Emulator(scenario).packets(0.0, 0.1))
    modes = {"strongest": 0x37, "last": 0x38, "dual": 0x39}
    for unit, sensor in enumerate((scenario.sensor, *scenario.rig)):
        payload = data_payloads(packet for packet in packets if packet.unit == unit)
        assert set(data_fields(payload)["return_mode"].tolist()) == {modes[sensor.return_mode]}
        points = decode_data(payload, keep_no_returns=False)
        assert len(points.ring) > 1000
        assert points.distance_m.min() >= sensor.min_range_m
        assert points.distance_m.max() <= 8.0
