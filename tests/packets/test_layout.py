"""Layout of both packets against the manual's numbers and the sensor room's."""

import doctest

from vlp16emu.packets import layout
from vlp16emu.sensor import beams as sensor
from vlp16emu.types import ReturnMode

OFFSETS = [
    # dtype, field, offset, size in bytes
    (layout.DATA_PAYLOAD, "blocks", 0, 1200),
    (layout.DATA_PAYLOAD, "timestamp_us", 0x4DA - 42, 4),
    (layout.DATA_PAYLOAD, "return_mode", 0x4DE - 42, 1),
    (layout.DATA_PAYLOAD, "factory", 0x4DF - 42, 1),
    (layout.BLOCK, "flag", 0, 2),
    (layout.BLOCK, "azimuth_cdeg", 2, 2),
    (layout.BLOCK, "records", 4, 96),
    (layout.RECORD, "distance_lsb", 0, 2),
    (layout.RECORD, "reflectivity", 2, 1),
    (layout.POSITION_PAYLOAD, "timestamp_us", 0xC6, 4),
    (layout.POSITION_PAYLOAD, "pps", 0xCA, 1),
    (layout.POSITION_PAYLOAD, "sentence", 0xCE, 128),
]


def test_doctest():
    """The sizes that the docstring shows are true."""
    failed, tried = doctest.testmod(layout)
    assert (failed, tried) == (0, 3)


def test_offsets():
    """Each field stands where the manual's tables put it (frame offsets less the 42 bytes of headers)."""
    for dtype, field, offset, size in OFFSETS:
        kind, at = dtype.fields[field]
        assert (at, kind.itemsize) == (offset, size), field


def test_byte_order_is_stated():
    """Multi-byte integers are little-endian whatever the machine is."""
    for dtype in (layout.RECORD, layout.BLOCK, layout.DATA_PAYLOAD, layout.POSITION_PAYLOAD):
        for kind, *_ in dtype.fields.values():
            if kind.kind in "ui" and kind.itemsize > 1:
                assert kind.str.startswith("<")


def test_periods():
    """A packet lasts 1327.104 us, in dual return 663.552 us, and the sensor fires at the same pace."""
    sequences = layout.SEQUENCES_PER_PACKET
    assert sequences[ReturnMode.STRONGEST] * sensor.SEQUENCE_NS == 1_327_104
    assert sequences[ReturnMode.LAST] == sequences[ReturnMode.STRONGEST]
    assert sequences[ReturnMode.DUAL] * sensor.SEQUENCE_NS == 663_552
