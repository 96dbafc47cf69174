"""Ground truth of each record of data packets as a Parquet table: writer, and reader beside the capture."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import matvec
from vlp16emu.engine import Unit
from vlp16emu.errors import InputError, RunError
from vlp16emu.inputs import readable
from vlp16emu.libraries import of_extra
from vlp16emu.output import OutputFile
from vlp16emu.packets.data import distance_lsb, odd_column
from vlp16emu.packets.layout import DATA_BYTES, DATA_PAYLOAD, RECORDS_PER_PACKET, layout_of
from vlp16emu.sensor.beams import BLOCK_RECORDS, Model
from vlp16emu.types import I8, SURFACE, U4, AnyArray, Packet, ReturnMode, Returns, SensorModel

_ONLY_COLUMN = {ReturnMode.STRONGEST: 0, ReturnMode.LAST: 1}
_LABELS = ("semantic", "part", "instance", "species")


def slots_of(unit: Unit, returns: Returns, mode: ReturnMode) -> NDArray[np.void]:
    """Return `SLOT` (n, 384) of whole packets, in the order of their records: by block, then by channel.

    Parameters
    ----------
    returns : returns with ground truth, as `pack_data` takes them
    mode : return mode
    """
    shape = returns.distance_m.shape[:2]
    of_model = layout_of(SensorModel(unit.section.model), mode)
    if mode is ReturnMode.DUAL:
        last = np.ones(shape, np.int64)
        odd = odd_column(returns)
        pairs = [_rows(unit, returns, column, of_model.model) for column in (last, odd)]
        of_last = returns.distance_m[..., 1] == returns.distance_m[..., 0]
        pairs[1]["repeat"] = (odd == 0) & of_last & (pairs[1]["echo"] != NO_ECHO)
        rows = np.stack([pair.reshape(-1, BLOCK_RECORDS) for pair in pairs], axis=1)  # pairs of blocks
    else:
        rows = _rows(unit, returns, np.full(shape, _ONLY_COLUMN[mode]), of_model.model)
    rows = rows.reshape(-1, of_model.blocks * BLOCK_RECORDS)
    nothing = np.zeros((len(rows), RECORDS_PER_PACKET - rows.shape[1]), SLOT)
    nothing["t_ns"] = rows["t_ns"][:, -1:]
    nothing["echo"] = NO_ECHO
    return np.concatenate([rows, nothing], axis=1)


def _rows(unit: Unit, returns: Returns, column: I8, model: Model) -> NDArray[np.void]:
    """Return `SLOT` (k, L) of one return of each pulse, given by its index (k, L) on the last axis."""

    def taken(values: AnyArray | None) -> AnyArray:
        """Return the values of the returns that are sent."""
        assert values is not None
        return np.take_along_axis(values, column[..., None], axis=-1)[..., 0]

    firings = returns.firings
    rows = np.zeros(column.shape, SLOT)
    is_sent = distance_lsb(taken(returns.distance_m), model) > 0
    rows["t_ns"] = firings.t_ns
    rows["echo"] = np.where(is_sent, column, NO_ECHO)
    range_m = np.where(is_sent, taken(returns.range_m), 0.0)
    rows["range_m"] = range_m
    rows["share"] = np.where(is_sent, taken(returns.share), 0.0)
    poses = unit.motion.poses_at(firings.t_ns.reshape(-1))
    world_m = firings.origin_m + firings.direction * range_m[..., None]
    away_m = world_m.reshape(-1, 3) - poses.world_p_body_m
    rows["world_m"] = world_m
    rows["sensor_m"] = matvec(poses.world_R_body.swapaxes(-1, -2), away_m).reshape(world_m.shape)
    assert returns.surfaces is not None
    surfaces = np.append(returns.surfaces, np.zeros(1, SURFACE))  # the last row stands for no surface
    met = surfaces[
        np.minimum(np.where(is_sent, taken(returns.surface), len(returns.surfaces)), len(returns.surfaces))
    ]
    for name in _LABELS:
        rows[name] = met[name]
    return rows


SLOT = np.dtype(
    [
        ("t_ns", "<i8"),  # UTC of the pulse
        ("echo", "u1"),  # index of the return on the last axis of `Returns`; `NO_ECHO` for none
        ("range_m", "<f4"),  # before errors of range and the 2 mm of the wire
        ("sensor_m", "<f4", 3),  # at this range, in the sensor's frame at the instant of the pulse
        ("world_m", "<f8", 3),
        ("semantic", "u1"),
        ("part", "u1"),
        ("instance", "<u4"),
        ("species", "<u2"),
        ("share", "<f4"),  # share of the footprint on the surface of the return
        ("repeat", "?"),  # in dual return: the same return as in the record of the block before
    ]
)  # ground truth of one record of a data packet

NO_ECHO = 255  # echo of a record without distance
LEAF_OR_WOOD = np.array([0, 1, 1, 1, 2, 1, 1], np.uint8)  # leaf (2) or wood (1) by `PlantPart`; 0 neither

_GROUP = 256  # packets of a row group, 98 304 rows: some 20 MB in memory
_LATE = 64  # greatest lateness of a packet in a capture, in packets
_EXPECTED = "the returns.parquet of the run that made the capture (`record --truth DIR --truth-returns`)"

SLOT_COLUMNS = {
    **dict.fromkeys(("packet", "stamp_us"), "uint32"),
    **dict.fromkeys(("block", "channel"), "uint8"),
    "t_ns": "int64",
    "echo": "uint8",
    **dict.fromkeys(("range_m", "x_m", "y_m", "z_m"), "float32"),
    **dict.fromkeys(("world_x_m", "world_y_m", "world_z_m"), "float64"),
    **dict.fromkeys(("semantic", "part", "leaf_wood"), "uint8"),
    "instance": "uint32",
    "species": "uint16",
    "share": "float32",
    **dict.fromkeys(("miss", "repeat"), "bool"),
}  # columns with their types; in a record without distance the columns from `echo` to `share` are null
_OF_RETURNS = tuple(SLOT_COLUMNS)[5:-2]
_FLOATS = [name for name in _OF_RETURNS if SLOT_COLUMNS[name].startswith("float")]


class SlotTable:
    """Writer of a row for each record of data packets; a context manager, after which the file is readable.

    Raises MissingExtraError if pyarrow is not installed; OutputError if the file cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        pa, parquet = _pyarrow()
        self._arrow = pa
        self._path = path
        self._schema = pa.schema([(name, pa.type_for_alias(kind)) for name, kind in SLOT_COLUMNS.items()])
        self._output = OutputFile(path)
        self._file = parquet.ParquetWriter(
            self._output.file,
            self._schema,
            compression="zstd",
            use_dictionary=[name for name in SLOT_COLUMNS if name not in (*_FLOATS, "t_ns")],
            column_encoding={"t_ns": "DELTA_BINARY_PACKED", **dict.fromkeys(_FLOATS, "BYTE_STREAM_SPLIT")},
        )
        self._held = list[Packet]()
        self._number = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is not None and not isinstance(error, KeyboardInterrupt):
            self._output.discard()
            return
        with self._output, self._output.writing():
            self._flush()
            self._file.close()

    def add(self, packet: Packet) -> None:
        """Add the records of the next data packet; `RunError` if they cannot be written."""
        self._held.append(packet)
        if len(self._held) == _GROUP:
            try:
                self._flush()
            except OSError as error:
                raise RunError(f"{self._path}: {error.strerror or error}; no file is written") from error

    def _flush(self) -> None:
        packets = self._held
        self._held = []
        if not packets:
            return
        rows = np.array([packet.slots for packet in packets]).reshape(-1)
        slot = np.tile(np.arange(RECORDS_PER_PACKET), len(packets))
        miss = rows["echo"] == NO_ECHO
        columns = {name: rows[name] for name in SLOT.names or () if rows[name].ndim == 1}
        for i, axis in enumerate("xyz"):
            columns |= {f"{axis}_m": rows["sensor_m"][:, i], f"world_{axis}_m": rows["world_m"][:, i]}
        columns |= {
            "packet": np.repeat(np.arange(len(packets)) + self._number, RECORDS_PER_PACKET),
            "stamp_us": np.repeat([_stamp_us(packet.payload) for packet in packets], RECORDS_PER_PACKET),
            "block": slot // BLOCK_RECORDS,
            "channel": slot % BLOCK_RECORDS,
            "leaf_wood": LEAF_OR_WOOD[rows["part"]],
            "miss": miss,
        }
        arrays = [
            self._arrow.array(
                np.ascontiguousarray(columns[field.name]).astype(field.type.to_pandas_dtype()),
                field.type,
                mask=miss if field.name in _OF_RETURNS else None,
            )
            for field in self._schema
        ]
        self._file.write_table(self._arrow.table(arrays, schema=self._schema), row_group_size=len(rows))
        self._number += len(packets)


class SlotReader:
    """Rows of a table behind the records of a capture of the same run, in the order of the capture.

    A packet of the capture is found by its time stamp, starting from the packet before, so packets of the run
    may be missing, repeated, or late by up to 64.

    Raises MissingExtraError if pyarrow is not installed; InputError if the file is not such a table.
    """

    def __init__(self, path: Path) -> None:
        pa, parquet = _pyarrow()
        self._path = path
        self._next = 0
        try:
            with readable(path, _EXPECTED, InputError):
                self._file = parquet.ParquetFile(path)
            groups = range(self._file.num_row_groups)
            stamps = [self._read(group, ["stamp_us"])["stamp_us"][::RECORDS_PER_PACKET] for group in groups]
            if missing := set(SLOT_COLUMNS) - set(self._file.schema_arrow.names):
                raise InputError(str(path), f"no column {min(missing)}", _EXPECTED)
        except pa.ArrowException as error:
            raise InputError(str(path), str(error).splitlines()[0], _EXPECTED) from None
        self._begin = np.cumsum([0, *map(len, stamps)])  # first packet of each row group
        self._stamps_us = np.concatenate([np.zeros(0, np.uint32), *stamps])
        self._held: tuple[int, dict[str, AnyArray]] = (-1, {})

    def rows(self, stamp_us: U4, packet: I8, slot: I8) -> dict[str, AnyArray]:
        """Return the columns (n,) from `echo` to `share` of records that have a distance.

        Parameters
        ----------
        stamp_us : (p,) time stamps of the packets, which follow the packets of the call before
        packet : (n,) row of `stamp_us`, ascending
        slot : (n,) index in the packet, 32 times the block plus the channel

        Raises InputError if the table does not hold such a packet, or has no return there: the capture
        belongs to another run.
        """
        number = self._numbers(stamp_us)[packet]
        group = np.searchsorted(self._begin, number, side="right") - 1
        found: dict[str, AnyArray] = {}
        for one in np.unique(group).tolist():
            if self._held[0] != one:
                self._held = one, self._read(one, [*_OF_RETURNS, "miss"])
            inside = np.flatnonzero(group == one)
            row = (number[inside] - self._begin[one]) * RECORDS_PER_PACKET + slot[inside]
            for name, array in self._held[1].items():
                found.setdefault(name, np.empty(len(number), array.dtype))[inside] = array[row]
        if found and found["miss"].any():
            first = int(found["miss"].argmax())
            block, channel = divmod(int(slot[first]), BLOCK_RECORDS)
            what = f"no return in packet {number[first]}, block {block}, channel {channel}"
            raise InputError(str(self._path), what, "one as in the capture, which is of another run")
        return found

    def returns(self, names: list[str]) -> Iterator[dict[str, AnyArray]]:
        """Return columns of all records that have a distance, some packets at a time."""
        for group in range(self._file.num_row_groups):
            columns = self._read(group, [*names, "miss"])
            yield {name: columns[name][~columns["miss"]] for name in names}

    def _numbers(self, stamp_us: U4) -> I8:
        expected = self._stamps_us[self._next : self._next + len(stamp_us)]
        if np.array_equal(expected, stamp_us):
            self._next += len(stamp_us)
            return np.arange(self._next - len(stamp_us), self._next)
        numbers = np.empty(len(stamp_us), np.int64)
        for i, stamp in enumerate(stamp_us.tolist()):
            begin = max(0, self._next - _LATE)
            same = np.flatnonzero(self._stamps_us[begin:] == stamp)
            if not len(same):
                found = f"no packet of time stamp {stamp} us, which the capture has"
                raise InputError(str(self._path), found, _EXPECTED)
            numbers[i] = begin + same[0]
            self._next = max(self._next, int(numbers[i]) + 1)
        return numbers

    def _read(self, group: int, names: list[str]) -> dict[str, AnyArray]:
        """Return columns of a row group; 0 for records without a return."""
        table = self._file.read_row_group(group, columns=names)
        columns = ((name, table[name]) for name in names)
        return {
            name: (column.fill_null(0) if column.null_count else column).to_numpy()
            for name, column in columns
        }


def _pyarrow() -> tuple[Any, Any]:  # it has no types
    with of_extra("data", "truth of each return"):
        import pyarrow as pa
        from pyarrow import parquet
    return pa, parquet


def _stamp_us(payload: bytes) -> int:
    """Return the time stamp of a packet; 0 for a truncated packet."""
    at = DATA_PAYLOAD.fields["timestamp_us"][1]  # type: ignore[index]  # it has fields
    return int.from_bytes(payload[at : at + 4], "little") if len(payload) == DATA_BYTES else 0
