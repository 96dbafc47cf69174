"""Points in LAS 1.4, and compressed as LAZ.

Fields follow the LAS specification 1.4 - R15 (ASPRS, 2019), point format 6; columns without a field are extra
dimensions with the names of .ply.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from importlib.metadata import version
from importlib.resources import files
from typing import IO, Any, ClassVar

import numpy as np

from vlp16emu.extras.clouds.cloud import Block, CloudMetadata, Column, PointWriter, label_scheme
from vlp16emu.extras.clouds.epochs import ADJUSTMENT_S, GPS_EPOCH_NS, leap_seconds
from vlp16emu.libraries import of_extra
from vlp16emu.types import F8, I8, U1, AnyArray
from vlp16emu.units import S_NS

_SCALE_M = 1e-4
"""A tenth of the rounding of other formats; with 32 bits the range is 214 km to either side of the offset."""
_OFFSET_M = 100_000.0  # offsets are multiples of it: 0 if the world's origin is near
_INTENSITY = 256  # 65 536 over the 256 steps of the reflectivity (LAS 1.4 - R15, section 2.6, intensity)
_FIELDS = frozenset({*"xyz", "time", "intensity", "return_number", "is_last", "label"})
"""Properties that have a field in the format."""
_NO_DATE = datetime(1970, 1, 1, tzinfo=UTC)
_EQUATOR_M = 6_378_137.0  # ellipsoid of WGS 84
_FLATTENING = 1 / 298.257223563


class LasFile(PointWriter):
    """Writer of LAS; MissingExtraError if laspy, or lazrs for LAZ, is not installed.

    GPS time is adjusted standard GPS time. The return number counts the echoes of a pulse from the nearest.
    The classification is the column `label`, or without it the class of the scheme `asprs`. User data is the
    column `return_number` of a scene, `is_last` of a capture. Scanner channel and scan angle are 0: a
    spinning sensor has one head, and no angle about a line of flight.
    """

    compressed: ClassVar[bool] = False

    def __init__(
        self, file: IO[bytes], columns: Sequence[Column], metadata: CloudMetadata, _stack: ExitStack
    ) -> None:
        needed = ("laspy", "lazrs") if self.compressed else ("laspy",)
        with of_extra("cloud", "writing LAS and LAZ", *needed):
            import laspy

            if self.compressed:
                import lazrs  # laspy looks for it too late
        self._laspy = laspy
        self._file = file
        self._failures: tuple[type[Exception], ...] = (lazrs.LazrsError,) if self.compressed else ()
        self._metadata = metadata
        self._writer: Any = None
        self._columns = [column for column in columns if column.ply]
        self._extra = {
            name: (column.property_dtype, header)
            for column in self._columns
            for name, header in zip(column.ply, column.csv, strict=True)
            if name not in _FIELDS
        }

    def write(self, block: Block) -> None:
        """Append points; the first one determines the offset."""
        values = dict[str, AnyArray]()
        for column in self._columns:
            values |= column.properties(block[column.name])
        count = len(values["x"])
        if not count:
            return
        if self._writer is None:
            first_m = np.array([values[axis][0] for axis in "xyz"], np.float64)
            self._write_header(np.rint(first_m / _OFFSET_M) * _OFFSET_M)
        record = self._laspy.ScaleAwarePointRecord.zeros(count, header=self._writer.header)
        for axis in "xyz":
            record[axis] = values[axis].astype(np.float64)
        number, echo_count = echoes_of(block)
        record["return_number"] = number
        record["number_of_returns"] = echo_count
        record["intensity"] = values["intensity"].astype(np.uint16) * _INTENSITY
        record["user_data"] = block["return_number" if "return_number" in block else "is_last"]
        record["point_source_id"] = np.full(count, self._metadata.unit)
        record["gps_time"] = adjusted_gps_s(block["t_ns"])
        if "label" in values:
            record["classification"] = values["label"]
        elif "semantic" in block:
            record["classification"] = label_scheme("asprs").codes(block["semantic"], block["part"])
        for name in self._extra:
            record[name] = values[name]
        with self._writing():
            self._writer.write_points(record)
        self.points += count

    def finish(self) -> None:
        """Write the number of points and their bounds into the header."""
        if self._writer is None:
            self._write_header(np.zeros(3))
        with self._writing():
            self._writer.close()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Raise OSError for a full disk, with the cause that the error of lazrs lacks."""
        try:
            yield
        except self._failures as error:
            self._file.flush()  # bytes that could not be written fail here too
            raise OSError(str(error)) from error

    def _write_header(self, offset_m: F8) -> None:
        laspy = self._laspy
        header = laspy.LasHeader(version="1.4", point_format=6)
        header.scales = np.full(3, _SCALE_M)
        header.offsets = offset_m
        start_utc = self._metadata.start_utc or _NO_DATE  # not today: bytes must not depend on it
        header.creation_date = start_utc.date()
        header.system_identifier = "vlp16emu"
        header.generating_software = f"vlp16emu {version('vlp16emu')}"
        header.global_encoding.wkt = True
        header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
        extra_dims = [
            laspy.ExtraBytesParams(name, np.dtype(dtype), description[:31])
            for name, (dtype, description) in self._extra.items()
        ]
        header.add_extra_dims(extra_dims)
        for extra in header.vlrs.get("ExtraBytesVlr")[0].extra_bytes_structs:
            extra.options = 0  # laspy 2.7 takes bounds from the first point of each block: none are written
        if self._metadata.origin is not None:
            header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(local_wkt(*self._metadata.origin)))
        self._writer = laspy.LasWriter(
            self._file,
            header,
            do_compress=self.compressed,
            laz_backend=laspy.LazBackend.Lazrs if self.compressed else None,  # one thread, block by block
            closefd=False,
        )


class LazFile(LasFile):
    """LAS compressed as LAZ, by lazrs."""

    compressed = True


def echoes_of(block: Block) -> tuple[U1, U1]:
    """Return the number (n,) of each echo in its pulse, and the count (n,) of echoes in the pulse.

    The nearest echo has number 1. The block has `t_ns`, `laser` and `distance_m`; the echoes of a pulse
    follow one another.
    """
    t_ns = block["t_ns"]
    differs = (np.diff(t_ns) != 0) | (np.diff(block["laser"].astype(np.int64)) != 0)
    is_first = np.append(True, differs)[: len(t_ns)]
    pulse = np.cumsum(is_first) - 1
    count = np.bincount(pulse)
    order = np.lexsort((block["distance_m"], pulse))
    number = np.empty(len(t_ns), np.int64)
    number[order] = np.arange(len(t_ns)) - np.flatnonzero(is_first)[pulse] + 1
    return number.astype(np.uint8), count[pulse].astype(np.uint8)


def local_wkt(latitude_deg: float, longitude_deg: float, height_m: float) -> str:
    """Return the coordinate system of the world as WKT: transverse Mercator about the origin, and height.

    No well-known text that other programs read describes a plane through the origin. This projection differs
    from the plane by less than 1 mm at 1 km: its scale fits the origin's height, as surveyors choose it for
    plots. Heights are above the origin, without the 78 mm of the earth's curvature at 1 km.
    """
    eccentricity2 = _FLATTENING * (2 - _FLATTENING)  # squared
    divisor = 1 - eccentricity2 * math.sin(math.radians(latitude_deg)) ** 2
    mean_radius_m = _EQUATOR_M * math.sqrt(1 - eccentricity2) / divisor  # of curvature, in all directions
    text = files(__package__).joinpath("local.wkt").read_text(encoding="utf-8").replace("\n", "")
    origin = {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg, "height_m": height_m}
    return text.format(scale=1 + height_m / mean_radius_m, **origin)


def adjusted_gps_s(t_ns: I8) -> F8:
    """Convert UTC (n,), ns since 1970 without leap seconds, to adjusted standard GPS time (n,) in s."""
    # Whole seconds are added separately, as float64 resolves only 60 ns of the sum.
    seconds, rest_ns = np.divmod(t_ns - GPS_EPOCH_NS, S_NS)
    return np.asarray((seconds + leap_seconds(t_ns) - ADJUSTMENT_S) + rest_ns / S_NS)
