"""The byte tables against the dtypes and headers of packets/, offset by offset."""

import numpy as np

from vlp16emu.extras.bench.imu_frame import IMU_FRAME
from vlp16emu.packets import layout
from vlp16emu.packets.frames import FACTORY_LINK, data_header, position_frame
from vlp16emu.sensor.beams import MODELS
from vlp16emu.types import PpsState, ReturnMode, SensorModel

DTYPES = {
    "u1": "u1",
    "u2": "<u2",
    "u4": "<u4",
    "i2": "<i2",
    "S3": "S3",
    "u8": "<u8",
    "i8": "<i8",
    "f8": "<f8",
}
UNIT_SUFFIXES = ("_us", "_cdeg", "_lsb")


def bare(name):
    """Field name of layout.py without its unit, which the tables keep in a column of its own."""
    for suffix in UNIT_SUFFIXES:
        name = name.removesuffix(suffix)
    return name


def size_bytes(row):
    if "count" in row:
        return row["count"] * row["size_bytes"]
    kind = row["type"]
    return int(kind[1:])


def row_of(table, name):
    return next(row for row in table if row["name"] == name)


def leaves(dtype, base=0):
    """Every scalar of a nested dtype as (name, offset, dtype)."""
    if dtype.names is None:
        raise TypeError(dtype)
    for name in dtype.names:
        sub, offset = dtype.fields[name][:2]
        count = int(np.prod(sub.shape, dtype=int))
        for i in range(count):
            at = base + offset + i * sub.base.itemsize
            if sub.base.names:
                yield from leaves(sub.base, at)
            else:
                yield bare(name), at, sub.base


def table_leaves(tables, table, base=0):
    """Every scalar of a byte table as (name, offset, dtype)."""
    for row in tables[table]:
        if "count" in row:
            for i in range(row["count"]):
                yield from table_leaves(tables, row["type"], base + row["offset"] + i * row["size_bytes"])
        else:
            yield row["name"], base + row["offset"], np.dtype(DTYPES[row["type"]])


def test_rows_fill_the_position_packet(position_packet):
    """The rows follow each other without gap or overlap, to the end; those of the other tables are the
    dtypes themselves."""
    end = 0
    for row in position_packet["payload"]:
        assert row["offset"] == end, row["name"]
        end += size_bytes(row)
    assert end == position_packet["size_bytes"] == layout.POSITION_BYTES


def test_imu_rows_are_the_frame(imu_frame):
    """The rows of the inertial frame are the dtype of packets/."""
    stated = [(row["offset"], np.dtype(DTYPES[row["type"]])) for row in imu_frame["payload"]]
    assert [(offset, dtype) for _, offset, dtype in leaves(IMU_FRAME)] == stated


def test_every_row_names_its_source(data_packet, position_packet):
    """No field stands without a document and a page, or a recording."""
    for packet in (data_packet, position_packet):
        rows = [row for name in ("payload", "block", "record") for row in packet.get(name, [])]
        assert [row["name"] for row in rows if not row.get("source")] == []


def test_data_dtype_is_the_table(data_packet):
    """The dtype of the data payload has the fields, offsets and types of data_packet.toml, all 795 of
    them."""
    stated = list(table_leaves(data_packet, "payload"))
    assert list(leaves(layout.DATA_PAYLOAD)) == stated
    assert len(stated) == 12 * (2 + 32 * 2) + 3
    assert data_packet["size_bytes"] == layout.DATA_BYTES


def test_position_dtype_is_the_table(position_packet):
    """The dtype of the position payload has the table's fields, and leaves out only bytes that are zero."""
    rows = {row["name"]: row for row in position_packet["payload"]}
    zero = {
        at
        for row in rows.values()
        if row.get("before_2018") == 0
        for at in range(row["offset"], row["offset"] + size_bytes(row))
    }
    for name in layout.POSITION_PAYLOAD.names:
        dtype, offset = layout.POSITION_PAYLOAD.fields[name][:2]
        covered = range(offset, offset + dtype.itemsize)
        if name.startswith("unused"):
            assert set(covered) <= zero, name
        else:
            row = rows[bare(name)]
            assert (offset, dtype.itemsize) == (row["offset"], size_bytes(row)), name
            zero -= set(covered)
    named = {row for row in rows if rows[row].get("before_2018") != 0}
    assert named == {bare(name) for name in layout.POSITION_PAYLOAD.names if not name.startswith("unused")}


def test_codes_are_those_of_the_table(data_packet, position_packet):
    """Flag, factory bytes and states of the pulse per second have the table's values."""
    flags = {
        "block": 0xEEFF,
        "lasers 32 to 63": 0xDDFF,
        "lasers 64 to 95": 0xCCFF,
        "lasers 96 to 127": 0xBBFF,
    }
    assert row_of(data_packet["block"], "flag")["values"] == flags
    assert set(flags.values()) == layout.BLOCK_FLAGS
    modes = {mode.value: layout.RETURN_MODE_BYTE[mode] for mode in ReturnMode}
    assert row_of(data_packet["payload"], "return_mode")["values"] == modes
    products = {model.value: MODELS[model].product for model in SensorModel}
    assert row_of(data_packet["payload"], "factory")["values"] == products
    states = {state.name.lower(): state.value for state in PpsState}
    assert row_of(position_packet["payload"], "pps")["values"] == states


def test_scales_and_bounds_are_those_of_the_table(data_packet):
    """Least count and least code of the distance, and the number of azimuth codes, are the table's."""
    distance, azimuth = row_of(data_packet["record"], "distance"), row_of(data_packet["block"], "azimuth")
    vlp_16 = MODELS[SensorModel.VLP_16]
    assert (distance["scale"], distance["minimum"]) == (vlp_16.distance_lsb_m, vlp_16.minimum_lsb)
    assert azimuth["maximum"] == layout.AZIMUTH_CODES - 1


def header_bytes(frame):
    """Header of a frame table, whose rows follow each other."""
    rows = [bytes.fromhex(row["bytes"]) for row in frame["header"]]
    assert [row["offset"] for row in frame["header"]] == np.cumsum([0, *map(len, rows[:-1])]).tolist()
    assert sum(map(len, rows)) == frame["payload_offset"]
    return b"".join(rows)


def test_data_header_is_the_table(data_packet):
    """A data frame carries the table's header byte by byte, but for the unit's own three bytes of MAC."""
    stated = header_bytes(data_packet["frame"])
    made = data_header(FACTORY_LINK)
    assert made[:9] + made[12:] == stated[:9] + stated[12:]
    assert len(made) + data_packet["size_bytes"] == data_packet["frame"]["size_bytes"]


def test_position_header_is_the_table(position_packet):
    """A position frame carries the table's header byte by byte, but for MAC and UDP checksum."""
    stated = header_bytes(position_packet["frame"])
    made = position_frame(FACTORY_LINK, bytes(512), 0)
    assert made[:9] + made[12:40] == stated[:9] + stated[12:40]
    assert made[40:42] != bytes(2)
    assert len(made) == position_packet["frame"]["size_bytes"]
