"""What a pulse's width and the detector make of a step edge, from the scene file to the packets."""

import numpy as np
import pytest

from vlp16emu import Emulator
from vlp16emu.packets import DATA_PAYLOAD, DISTANCE_LSB_M
from vlp16emu.scenario import load
from vlp16emu.types import PacketKind

PLATE_M = 10.0
LASER = 1
"""It looks up by 1 degree."""
EXACT = ("sensor.azimuth_noise_deg=0.0", "sensor.eccentricity_deg=0.0", "noise.preset=ideal")


def distances_m(scenario, stop_s):
    """Distances (blocks, 2, 16) as the packets have them."""
    packets = Emulator(scenario).packets(0.0, stop_s)
    payload = b"".join(packet.payload for packet in packets if packet.kind is PacketKind.DATA)
    records = np.frombuffer(payload, DATA_PAYLOAD)["blocks"]["records"]
    return records["distance_lsb"].reshape(-1, 2, 16) * DISTANCE_LSB_M


@pytest.mark.parametrize(
    ("gap_m", "behind_m"),
    [(0.3, [(0.1, 0.2)]), (0.7, [(0.0, 0.7)]), (1.5, [(0.0, 0.0), (1.5, 1.5)]), (5.0, [(0.0, 0.0), (5.0, 5.0)])],
)
def test_a_step_edge_is_one_return_or_two(gap_m, behind_m):
    """With the beam half on each of two plates, packets show one return between them below 1.4 m, and both plates above."""
    middle_m = PLATE_M + 0.05
    near = f"{{ name = 'near', centre_m = [{middle_m}, -2.5, 3.0], size_m = [0.1, 5.0, 6.0] }}"
    far = f"{{ name = 'far', centre_m = [{middle_m + gap_m}, 0.0, 3.0], size_m = [0.1, 10.0, 6.0] }}"
    # The rotor turns by 3600 degrees per second until laser 1 fires in sequence 10, so that it stands at 0.
    own = [f"sensor.start_azimuth_deg={360 - 3600 * (10 * 55.296e-6 + 2.304e-6)}", "world.length_m=40.0"]
    scenario = load(
        "static_bench",
        [*EXACT, "sensor.return_mode=dual", *own, f"world.boxes=[{near}, {far}]", "world.poles=[]", "beam={}"],
    )
    last_m, other_m = distances_m(scenario, 0.001)[10:12, 0, LASER]
    found_m = np.unique([other_m, last_m]) * np.cos(np.radians(1.0)) - PLATE_M
    assert len(found_m) == len(behind_m)
    for at_m, (low_m, high_m) in zip(found_m, behind_m, strict=True):
        assert low_m - 0.02 < at_m < high_m + 0.02
