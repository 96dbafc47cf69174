"""The receiver wired to the sensor."""

from vlp16emu.device import GpsInput
from vlp16emu.types import PpsState
from vlp16emu.units import MS_NS, S_NS


def test_sentence_names_the_preceding_second():
    """Until the delay has passed the buffer still holds the sentence of the second before."""
    gps = GpsInput(True, 350 * MS_NS)
    assert gps.second_ns(100 * S_NS + 349 * MS_NS) == 99 * S_NS
    assert gps.second_ns(100 * S_NS + 350 * MS_NS) == 100 * S_NS
    assert gps.second_ns(101 * S_NS) == 100 * S_NS
    assert gps.pps is PpsState.LOCKED


def test_without_receiver_there_is_no_second():
    """No receiver: pulse absent and no sentence at any time."""
    gps = GpsInput(False, 350 * MS_NS)
    assert gps.pps is PpsState.ABSENT
    assert gps.second_ns(100 * S_NS) is None
