"""Bags of ROS 1 and ROS 2, written without ROS."""

import heapq
import logging
import sqlite3
from collections.abc import Iterable
from itertools import count
from pathlib import Path
from typing import Any, Self

from vlp16emu.errors import OutputError, RunError
from vlp16emu.libraries import check_extra
from vlp16emu.output import Staged, opening
from vlp16emu.trees import Tree
from vlp16emu.units import S_NS

_log = logging.getLogger(__name__)

_SUFFIXES = (".mcap", ".bag", "")
"""MCAP of ROS 2, bag of ROS 1, and a folder with SQLite of ROS 2, which each ROS 2 reads without a plugin."""
_OWN_TYPES = {
    "velodyne_msgs/msg/VelodynePacket": "builtin_interfaces/Time stamp\nuint8[1206] data\n",
    "velodyne_msgs/msg/VelodyneScan": "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets\n",
    "nmea_msgs/msg/Sentence": "std_msgs/Header header\nstring sentence\n",
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
}
"""Definitions in github.com/ros-drivers/velodyne (velodyne_msgs/msg) and nmea_msgs (msg), and in
github.com/ros/geometry2 (tf2_msgs/msg), which rosbags lacks among the types of ROS 1."""
_HELD_NS = S_NS  # time for which messages wait for earlier ones
_FAILURES = (OSError, sqlite3.Error)  # errors for a full disk, the second one in a folder of ROS 2
LATEST_NS = (2**31 - 1) * S_NS
"""Latest stamp of builtin_interfaces/Time, whose seconds are an int32; stamps of ROS 1 reach farther."""
_METADATA_VERSION = 8  # last metadata version of rosbag2 with the quality of service as a string


def check_bag(path: Path) -> None:
    """Refuse a path that no bag can be written to.

    Raises OutputError if the suffix is no bag's, or the folder exists; MissingExtraError if rosbags is not
    installed.
    """
    suffix = path.suffix.lower()
    if suffix not in _SUFFIXES or not path.name:
        raise OutputError(str(path), f"found the ending {suffix!r}", ".mcap, .bag or a folder without ending")
    if path.exists() and (not suffix or not path.is_file()):
        raise OutputError(str(path), "is there already", "a new name")
    check_extra("ros", "writing bags")


class BagFile:
    """A bag that gets its name when it is closed without error; a context manager.

    It is .mcap (ROS 2), .bag (ROS 1), or a folder without suffix (ROS 2, SQLite); a file is replaced, a
    folder is not. Messages may come in any order within a second, and are written in the order of their
    times.

    Raises OutputError if the suffix is no bag's, the folder exists, or nothing can be written there;
    MissingExtraError if rosbags is not installed.
    """

    def __init__(self, path: Path) -> None:
        check_bag(path)
        from rosbags.rosbag1 import Writer as Writer1
        from rosbags.rosbag2 import StoragePlugin
        from rosbags.rosbag2 import Writer as Writer2
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.path = path
        suffix = path.suffix.lower()
        self.is_ros1 = suffix == ".bag"
        self._store = get_typestore(Stores.ROS1_NOETIC if self.is_ros1 else Stores.ROS2_HUMBLE)
        for name, text in _OWN_TYPES.items():
            self._store.register(get_types_from_msg(text, name))
        plugin = StoragePlugin.MCAP if suffix else StoragePlugin.SQLITE3
        with opening(str(path), "a place that can be written"):
            self._staged = Staged(path, str(path), lambda _: check_bag(path), is_folder=True)
        self._made = self._staged.path / path.stem
        try:
            if self.is_ros1:
                self._writer: Any = Writer1(self._made)
            else:
                self._writer = Writer2(self._made, version=_METADATA_VERSION, storage_plugin=plugin)
            self._writer.open()
        except _FAILURES as error:
            self._staged.discard()
            found = getattr(error, "strerror", None) or str(error)
            raise OutputError(str(path), found, "a place that can be written") from error
        self._connections: Tree = {}
        self._inner = dict[str, list[tuple[str | None, bool]]]()  # by type, as `_inner_types` returns it
        self._held: list[tuple[int, int, str, Any]] = []
        self._number = count()
        self.counts: dict[str, int] = {}  # messages by topic
        self.span_ns: tuple[int, int] | None = None  # UTC of the first and the last message

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        try:
            self._finish(is_whole=error is None)
        except _FAILURES as failed:
            raise self._failed(failed) from failed
        finally:
            self._staged.discard()

    def _finish(self, *, is_whole: bool) -> None:
        """Close the bag, and give it its name if it is whole."""
        try:
            while self._held and is_whole:
                self._append()
        finally:
            self._writer.close()
        if not is_whole:
            return
        is_mcap = self.path.suffix.lower() == ".mcap"
        self._staged.keep(self._made / f"{self._made.name}.mcap" if is_mcap else self._made)
        if not self.counts:
            found = "a bag without messages: no revolution is whole from the first packet to the last"
            _log.warning("%s: %s", self.path, found)

    @staticmethod
    def time(t_ns: int) -> tuple[int, int]:
        """Return the fields of the stamp of a UTC instant."""
        return divmod(t_ns, S_NS)

    def header(self, t_ns: int, frame: str, topic: str) -> tuple[object, ...]:
        """Return the fields of a header; headers of ROS 1 number the messages of their topic."""
        fields = self.time(t_ns), frame
        return (self.counts.get(topic, 0), *fields) if self.is_ros1 else fields

    def write(self, topic: str, t_ns: int, name: str, *fields: object) -> None:
        """Write a message of a type such as `sensor_msgs/msg/Imu`, stamped with a UTC instant.

        Fields are in the order of the type's definition, also in nested messages.

        Raises RunError if the disk is full, or the stamp is out of the range of bags.
        """
        if not 0 <= t_ns <= LATEST_NS:
            raise RunError(
                f"{self.path}: a message at {t_ns / S_NS:.3f} s since 1970 fits no bag; no bag is written"
            )
        heapq.heappush(self._held, (t_ns, next(self._number), topic, self._message(name, fields)))
        self.counts[topic] = self.counts.get(topic, 0) + 1
        first_ns, last_ns = self.span_ns or (t_ns, t_ns)
        self.span_ns = min(first_ns, t_ns), max(last_ns, t_ns)
        while self._held[0][0] < self.span_ns[1] - _HELD_NS:
            self._append()

    def _message(self, name: str, fields: Iterable[Any]) -> Any:
        made = []
        for (inner, is_list), value in zip(self._inner_types(name), fields, strict=True):
            if inner is None:
                made.append(value)
            elif is_list:
                made.append([self._message(inner, one) for one in value])
            else:
                made.append(self._message(inner, value))
        return self._store.types[name](*made)

    def _inner_types(self, name: str) -> list[tuple[str | None, bool]]:
        """Return the message type of each field of a type, None for plain ones, and whether it is a list."""
        found = self._inner.get(name)
        if found is None:
            from rosbags.interfaces import Nodetype

            found = self._inner[name] = []
            for _, (node, kind) in self._store.fielddefs[name][1]:
                is_list = node not in (Nodetype.NAME, Nodetype.BASE)
                of_one, inner = kind[0] if is_list else (node, kind)
                found.append((inner if of_one == Nodetype.NAME else None, is_list))
        return found

    def _append(self) -> None:
        t_ns, _, topic, message = heapq.heappop(self._held)
        name = message.__msgtype__
        if topic not in self._connections:
            self._connections[topic] = self._connection(topic, name)
        serialize = self._store.serialize_ros1 if self.is_ros1 else self._store.serialize_cdr
        try:
            self._writer.write(self._connections[topic], t_ns, serialize(message, name))
        except _FAILURES as error:
            raise self._failed(error) from error

    def _failed(self, error: Exception) -> RunError:
        return RunError(f"{self.path}: {getattr(error, 'strerror', None) or error}; no bag is written")

    def _connection(self, topic: str, name: str) -> Any:
        """Announce a topic: reliable, depth ten; fixed transforms are latched, as in tf2_ros."""
        from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

        is_fixed = topic == "/tf_static"
        any_time = QosTime(0, 0)
        more: dict[str, object] = {"latching": 1} if is_fixed else {}
        if not self.is_ros1:
            depth, durability = (
                (1, QosDurability.TRANSIENT_LOCAL) if is_fixed else (10, QosDurability.VOLATILE)
            )
            kept = QosHistory.KEEP_LAST, depth, QosReliability.RELIABLE, durability
            times = any_time, any_time, QosLiveliness.SYSTEM_DEFAULT, any_time
            qos = Qos(*kept, *times, avoid_ros_namespace_conventions=False)
            more = {"offered_qos_profiles": [qos]}
        return self._writer.add_connection(topic, name, typestore=self._store, **more)
