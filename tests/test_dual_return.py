"""Dual return in a forest: each pair of records in the packets against the rules of 63-9243 Rev D, section
9.3.2, p. 57."""

import numpy as np
import pytest
from kit import data_payloads
from woods import LINES

from vlp16emu import Emulator
from vlp16emu.packets import DATA_PAYLOAD, DISTANCE_LSB_M

pytestmark = pytest.mark.usefixtures("kept_woods")

OWN = ("sensor.return_mode=dual", "noise.reflectivity_noise=0.0", "noise.gain_spread=0.0")
RESOLUTION_M, NOISE_M, ERROR_M = 1.0, 0.3, 0.05
"""How far apart two returns are; by how much noise may bring them together, at the detection threshold six
sigmas of each are 0.38 m; and the error of a range that is bright enough to be strongest: bias, at most 3
cm, and noise.
"""


@pytest.fixture(scope="module", params=["typical", "ideal"])
def pairs(request):
    """Blocks (n, 12) of more than one revolution as on the wire, and strongest, last and second strongest
    (n, 6, 32, 3) in steps of distance."""
    emulator = Emulator("birch_walk", [*LINES, *OWN, f"noise.preset={request.param}"])
    sent = data_payloads(emulator.packets(0.0, 0.12))
    returned = np.concatenate([r.distance_m for r in emulator.returns(0.0, 0.12)])[: 12 * len(sent)]
    steps = np.rint(returned.astype(float) / DISTANCE_LSB_M).reshape(len(sent), 6, 32, 3)
    return sent.view(DATA_PAYLOAD)[:, 0]["blocks"], steps


def broken(blocks, returned):
    """Count the pairs that break a rule of dual return, by rule."""
    last, other = blocks[:, 0::2], blocks[:, 1::2]
    last_m, other_m = (half["records"]["distance_lsb"].reshape(-1) * DISTANCE_LSB_M for half in (last, other))
    last_r, other_r = (half["records"]["reflectivity"].reshape(-1).astype(float) for half in (last, other))
    returned_m = returned.reshape(-1, 3) * DISTANCE_LSB_M
    two = (last_m > 0) & (other_m > 0) & (last_m != other_m)
    is_strongest = returned_m[:, 0] == returned_m[:, 1]
    expected_m = np.where(two & is_strongest, returned_m[:, 2], returned_m[:, 0])
    # Amplitudes, from the reported reflectivity and range, as low and as high as rounding and noise allow.
    low_last, low_other = ((r - 0.5) / (m + ERROR_M) ** 2 for r, m in ((last_r, last_m), (other_r, other_m)))
    high_last, high_other = (
        (r + 0.5) / np.maximum(m - ERROR_M, ERROR_M) ** 2 for r, m in ((last_r, last_m), (other_r, other_m))
    )
    rules = {
        "azimuths differ": last["azimuth_cdeg"] != other["azimuth_cdeg"],
        "the last return is nearer": last_m < other_m,
        "two nearer to each other than the resolution": two & (last_m - other_m < RESOLUTION_M - NOISE_M),
        "one return, but its records differ": ~two & (other_m > 0) & (last_r != other_r),
        "no return, but reflectivities differ": (last_m == 0) & (last_r != other_r),
        "half a pair, and none blanked": (last_m > 0) & (other_m == 0) & (other_r == 0),
        "nearer than 0.5 m": ((last_m > 0) & (last_m < 0.5)) | ((other_m > 0) & (other_m < 0.5)),
        "even block is not the last": np.abs(last_m - returned_m[:, 1]) > 1e-6,
        "odd block is not the one it has to be": two & (np.abs(other_m - expected_m) > 1e-6),
        "the strongest is outshone": two
        & np.where(is_strongest, high_last < low_other, high_other < low_last),
    }
    return {rule: int(pairs.sum()) for rule, pairs in rules.items()}


def test_every_pair_of_a_forest_is_lawful(pairs):
    """No pair breaks a rule, and there are hundreds with no, one and two returns; were odd blocks even
    ones, rules would break."""
    blocks, returned = pairs
    assert set(broken(blocks, returned).values()) == {0}
    last, other = (blocks[:, half::2]["records"]["distance_lsb"].reshape(-1) for half in (0, 1))
    kinds = (last == 0), (last > 0) & (last == other), (other > 0) & (last != other)
    assert min(int(kind.sum()) for kind in kinds) > 200
    wrong = broken(blocks.reshape(-1, 6, 2)[:, :, ::-1].reshape(blocks.shape), returned)
    for rule in ("the last return is nearer", "even block is not the last", "the strongest is outshone"):
        assert wrong[rule] > 100
