"""Windows of `tools/unmask`: features of made-up records."""

import numpy as np
import pytest
from unmask_windows import SEQUENCES, features_of, windows

from vlp16emu.extras.compare import Sequences


@pytest.fixture
def wall():
    """A wall at 5 m in 75 packets, of which the 30th is missing; each tenth record of it is lost, its laser has 7 there."""
    packet = np.delete(np.arange(76), 30)
    number = (24 * packet[:, None] + np.arange(24)).ravel()
    distance, code = np.full((len(number), 16), 2500), np.full((len(number), 16), 40)
    distance[number % 10 == 0], code[number % 10 == 0] = 0, 7
    block = number[::2] // 2
    return Sequences(
        number=number,
        distance_lsb=distance,
        reflectivity=code,
        azimuth_cdeg=np.floor(39.8131 * block).astype(int),
        block=block,
        clock_ns=np.floor(1327.104 * packet).astype(int) * 1000,
        stamp_ns=packet * 1_327_104,
        packet=packet,
        last=None,
    )


def test_a_window_has_25_packets_in_a_row(wall):
    """Of three stretches of 25 packets the one with a gap is left out."""
    found = list(windows(wall))
    assert [int(window.packet[0]) for window in found] == [0, 51]
    assert all(len(window.number) == SEQUENCES and len(window.azimuth_cdeg) == SEQUENCES / 2 for window in found)


def test_features_count_what_is_there(wall):
    """A tenth of the records is lost, one at a time, so one of eight between two returns; their codes are those of the laser and never raised."""
    found = features_of(next(windows(wall)))
    assert found["scene.returns"] == pytest.approx(0.9)
    assert found["loss.at_step_0"] == pytest.approx(1 / 8, abs=0.005)
    assert found["loss.silent_run.1"] == 1
    assert found["no_return.beside.0.9"] == 1
    assert found["no_return.above_100"] == 0
    assert np.isnan(found["loss.at_step_150"])
