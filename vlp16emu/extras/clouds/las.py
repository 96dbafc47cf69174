"""Points in LAS 1.4, and compressed as LAZ.

Fields as the LAS specification 1.4 - R15 (ASPRS, 2019) has them, point format 6; what it has no field for is in extra
dimensions by the names of .ply.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from importlib.metadata import version
from importlib.resources import files
from typing import IO, Any, ClassVar

import numpy as np

from vlp16emu.errors import MissingExtraError
from vlp16emu.extras.clouds.cloud import Block, CloudAbout, Column, PointWriter, label_scheme
from vlp16emu.types import F8, I8, U1
from vlp16emu.units import S_NS

_SCALE_M = 1e-4
"""A tenth of what the other formats round to; with 32 bits that reaches 214 km to either side of the offset."""
_OFFSET_M = 100_000.0  # offsets are multiples of it: 0 wherever a world has its origin near
_INTENSITY = 256  # 65 536 over the 256 steps of the reflectivity (LAS 1.4 - R15, section 2.6, intensity)
_FIELDS = frozenset({*"xyz", "time", "intensity", "return_number", "is_last", "label"})
"""Properties that fields of the format hold."""
_NO_DATE = datetime(1970, 1, 1, tzinfo=UTC)
_EQUATOR_M, _FLATTENING = 6_378_137.0, 1 / 298.257223563  # ellipsoid of WGS 84


def _ns(year: int, month: int, day: int) -> int:
    return int(datetime(year, month, day, tzinfo=UTC).timestamp()) * S_NS


_GPS_EPOCH_NS = _ns(1980, 1, 6)
_LEAPS_NS = np.array(
    [_ns(year, 7, 1) for year in (1981, 1982, 1983, 1985, 1992, 1993, 1994, 1997, 2012, 2015)]
    + [_ns(year, 1, 1) for year in (1988, 1990, 1991, 1996, 1999, 2006, 2009, 2017)]
)  # instants after the leap seconds since GPS time began (IERS Bulletin C; none is announced after that of 2016-12-31)
_LEAPS_NS.sort()
_ADJUSTMENT_S = 1_000_000_000  # LAS specification 1.4 - R15, section 2.4, global encoding bit 0


class LasFile(PointWriter):
    """Takes points block by block; MissingExtraError where laspy, or for LAZ lazrs, is not installed.

    GPS time is adjusted standard GPS time. The return number counts the echoes of a pulse from the
    nearest. The classification is the column `label`, or without it the class of the scheme `asprs`. User data is the
    column `return_number` of a scene, `is_last` of a capture. Scanner channel and scan angle are 0: the head of a spinning
    sensor is one, and has no angle about a line of flight.
    """

    compressed: ClassVar[bool] = False

    def __init__(self, file: IO[bytes], columns: Sequence[Column], about: CloudAbout, _stack: ExitStack) -> None:
        try:
            import laspy

            if self.compressed:
                import lazrs  # laspy looks for it too late
        except ImportError:
            raise MissingExtraError("laspy[lazrs]", "cloud", "writing LAS and LAZ") from None
        self._laspy, self._file = laspy, file
        self._failures: tuple[type[Exception], ...] = (lazrs.LazrsError,) if self.compressed else ()
        self._about = about
        self._writer: Any = None
        self._columns = [column for column in columns if column.ply]
        self._extra = {
            name: (column.kind, header)
            for column in self._columns
            for name, header in zip(column.ply, column.csv, strict=True)
            if name not in _FIELDS
        }

    def write(self, block: Block) -> None:
        """Append points; the first one decides the offset."""
        values = {name: array for one in self._columns for name, array in one.properties(block[one.name]).items()}
        n = len(values["x"])
        if not n:
            return
        if self._writer is None:
            first_m = np.array([values[axis][0] for axis in "xyz"], np.float64)
            self._begin(np.rint(first_m / _OFFSET_M) * _OFFSET_M)
        record = self._laspy.ScaleAwarePointRecord.zeros(n, header=self._writer.header)
        for axis in "xyz":
            record[axis] = values[axis].astype(np.float64)
        number, count = echoes_of(block)
        record["return_number"], record["number_of_returns"] = number, count
        record["intensity"] = values["intensity"].astype(np.uint16) * _INTENSITY
        record["user_data"] = block["return_number" if "return_number" in block else "is_last"]
        record["point_source_id"] = np.full(n, self._about.unit)
        record["gps_time"] = adjusted_gps_s(block["t_ns"])
        if "label" in values:
            record["classification"] = values["label"]
        elif "semantic" in block:
            record["classification"] = label_scheme("asprs").codes(block["semantic"], block["part"])
        for name in self._extra:
            record[name] = values[name]
        with self._writing():
            self._writer.write_points(record)
        self.points += n

    def finish(self) -> None:
        """Write the number of points and their bounds into the header."""
        if self._writer is None:
            self._begin(np.zeros(3))
        with self._writing():
            self._writer.close()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Report a full disk as such: lazrs has an error of its own for it, without the cause."""
        try:
            yield
        except self._failures as error:
            self._file.flush()  # what could not be written cannot be flushed either
            raise OSError(str(error)) from error

    def _begin(self, offset_m: F8) -> None:
        laspy = self._laspy
        header = laspy.LasHeader(version="1.4", point_format=6)
        header.scales, header.offsets = np.full(3, _SCALE_M), offset_m
        header.creation_date = (self._about.start_utc or _NO_DATE).date()  # not today, on which no byte may depend
        header.system_identifier, header.generating_software = "vlp16emu", f"vlp16emu {version('vlp16emu')}"
        header.global_encoding.wkt = True
        header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
        header.add_extra_dims(
            [laspy.ExtraBytesParams(name, np.dtype(kind), text[:31]) for name, (kind, text) in self._extra.items()]
        )
        for extra in header.vlrs.get("ExtraBytesVlr")[0].extra_bytes_structs:
            extra.options = 0  # laspy 2.7 takes bounds from the first point of each block: they are not stated
        if self._about.origin is not None:
            header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(local_wkt(*self._about.origin)))
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
    """Return the number (n,) of each echo in its pulse, the nearest being 1, and how many (n,) the pulse has.

    The block has `t_ns`, `laser` and `distance_m`; the echoes of a pulse follow one another.
    """
    t_ns = block["t_ns"]
    new = np.append(True, (np.diff(t_ns) != 0) | (np.diff(block["laser"].astype(np.int64)) != 0))[: len(t_ns)]
    pulse = np.cumsum(new) - 1
    count = np.bincount(pulse)
    order = np.lexsort((block["distance_m"], pulse))
    number = np.empty(len(t_ns), np.int64)
    number[order] = np.arange(len(t_ns)) - np.flatnonzero(new)[pulse] + 1
    return number.astype(np.uint8), count[pulse].astype(np.uint8)


def local_wkt(latitude_deg: float, longitude_deg: float, height_m: float) -> str:
    """Coordinate system of the world: east and north on a transverse Mercator of its own about the origin, and up.

    A plane through the origin has no well-known text that other programs read. This projection differs from it by less than
    1 mm at 1 km: its scale is that of the origin's height, as surveyors set it for plots. Heights are over the
    origin, without the 78 mm by which the earth curves away at 1 km.
    """
    squared = _FLATTENING * (2 - _FLATTENING)
    bulge = 1 - squared * math.sin(math.radians(latitude_deg)) ** 2
    radius_m = _EQUATOR_M * math.sqrt(1 - squared) / bulge
    text = files(__package__).joinpath("local.wkt").read_text(encoding="utf-8").replace("\n", "")
    place = {"latitude_deg": latitude_deg, "longitude_deg": longitude_deg, "height_m": height_m}
    return text.format(scale=1 + height_m / radius_m, **place)


def adjusted_gps_s(t_ns: I8) -> F8:
    """Convert UTC instants (n,), ns since 1970 without leap seconds, to adjusted standard GPS time (n,) in s."""
    leaps = np.searchsorted(_LEAPS_NS, t_ns, side="right")
    # Whole seconds apart, as float64 keeps 60 ns of the sum and no more.
    whole, rest = np.divmod(t_ns - _GPS_EPOCH_NS, S_NS)
    return np.asarray((whole + leaps - _ADJUSTMENT_S) + rest / S_NS)
