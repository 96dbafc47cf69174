"""The truth behind each record of the data packets of a run, as a table in Parquet."""

from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import MissingExtraError, RunError
from vlp16emu.output import OutputFile
from vlp16emu.packets.layout import DATA_BYTES, DATA_PAYLOAD, NO_ECHO
from vlp16emu.sinks.columns import LEAF_OR_WOOD
from vlp16emu.types import Packet

__all__ = ["SLOT_COLUMNS", "SlotTable"]

_GROUP = 256
"""Packets of a row group, 98 304 rows: what is held in memory, some 20 MB."""
_CHANNELS = 32
_BLOCKS = 12

SLOT_COLUMNS = {
    "packet": "uint32",
    "stamp_us": "uint32",
    "block": "uint8",
    "channel": "uint8",
    "t_ns": "int64",
    "echo": "uint8",
    "range_m": "float32",
    "x_m": "float32",
    "y_m": "float32",
    "z_m": "float32",
    "world_x_m": "float64",
    "world_y_m": "float64",
    "world_z_m": "float64",
    "semantic": "uint8",
    "part": "uint8",
    "leaf_wood": "uint8",
    "instance": "uint32",
    "species": "uint16",
    "share": "float32",
    "miss": "bool",
    "repeat": "bool",
}
"""Columns with their types; of a record without distance those from `echo` to `share` are null."""
_OF_RETURNS = tuple(SLOT_COLUMNS)[5:-2]
_FLOATS = [name for name in _OF_RETURNS if SLOT_COLUMNS[name].startswith("float")]


class SlotTable:
    """Writes a row for each record of the data packets that it is given; a context manager.

    Parameters
    ----------
    path : of the file, which is readable when this has been left

    Raises
    ------
    MissingExtraError
        where pyarrow is not installed
    OutputError
        where the file cannot be opened
    """

    def __init__(self, path: Path) -> None:
        try:
            import pyarrow as pa
            from pyarrow import parquet
        except ImportError:
            raise MissingExtraError("pyarrow", "data", "truth of each return") from None
        self._arrow, self._path = pa, path
        self._schema = pa.schema([(name, pa.type_for_alias(kind)) for name, kind in SLOT_COLUMNS.items()])
        self._output = OutputFile(path)
        self._file = parquet.ParquetWriter(
            self._output.file,
            self._schema,
            compression="zstd",
            use_dictionary=[name for name in SLOT_COLUMNS if name not in (*_FLOATS, "t_ns")],
            column_encoding={"t_ns": "DELTA_BINARY_PACKED", **dict.fromkeys(_FLOATS, "BYTE_STREAM_SPLIT")},
        )
        self._held, self._number = list[Packet](), 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._output, self._output.writing():
            self._flush()
            self._file.close()

    def add(self, packet: Packet) -> None:
        """Add the records of a data packet, whose number is how many came before it.

        Raises
        ------
        RunError
            where they cannot be written
        """
        self._held.append(packet)
        if len(self._held) == _GROUP:
            try:
                self._flush()
            except OSError as error:
                raise RunError(f"{self._path}: {error.strerror}; no file is written") from error

    def _flush(self) -> None:
        """Write the packets that are held as a row group."""
        packets, self._held = self._held, []
        if not packets:
            return
        rows = np.array([packet.slots for packet in packets]).reshape(-1)
        slot = np.tile(np.arange(_BLOCKS * _CHANNELS), len(packets))
        miss = rows["echo"] == NO_ECHO
        columns = {
            "packet": np.repeat(np.arange(len(packets)) + self._number, _BLOCKS * _CHANNELS),
            "stamp_us": np.repeat([_stamp_us(packet.payload) for packet in packets], _BLOCKS * _CHANNELS),
            "block": slot // _CHANNELS,
            "channel": slot % _CHANNELS,
            **{
                name: rows[name]
                for name in ("t_ns", "echo", "range_m", "semantic", "part", "instance", "species", "share")
            },
            **{f"{axis}_m": rows["sensor_m"][:, i] for i, axis in enumerate("xyz")},
            **{f"world_{axis}_m": rows["world_m"][:, i] for i, axis in enumerate("xyz")},
            "leaf_wood": LEAF_OR_WOOD[rows["part"]],
            "miss": miss,
            "repeat": rows["repeat"],
        }
        self._file.write_table(
            self._arrow.table(
                [
                    self._column(name, columns[name], miss if name in _OF_RETURNS else None)
                    for name in SLOT_COLUMNS
                ],
                schema=self._schema,
            ),
            row_group_size=len(rows),
        )
        self._number += len(packets)

    def _column(
        self, name: str, values: NDArray[Any], miss: NDArray[np.bool_] | None
    ) -> Any:  # of pyarrow, which has no types
        """Make a column, null where there is no return."""
        kind = self._schema.field(name).type
        return self._arrow.array(np.ascontiguousarray(values).astype(kind.to_pandas_dtype()), kind, mask=miss)


def _stamp_us(payload: bytes) -> int:
    """Read the time stamp of a packet; 0 of one that was cut short."""
    at = DATA_PAYLOAD.fields["timestamp_us"][1]  # type: ignore[index]  # it has fields
    return int.from_bytes(payload[at : at + 4], "little") if len(payload) == DATA_BYTES else 0
