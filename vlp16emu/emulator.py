"""The program on one page: poses -> aim -> cast -> detect -> pack, in order of sending.

Work is cut into blocks of firing sequences that are always computed whole, and windows of the world are
opened at fixed blocks. So neither threads nor the span that is asked for can change a byte.
"""

import heapq
import os
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from vlp16emu.assembly import assemble
from vlp16emu.errors import TrajectoryError
from vlp16emu.packets import SEQUENCES_PER_PACKET, pack_data
from vlp16emu.pipeline import ahead
from vlp16emu.raycast import Scene, caster
from vlp16emu.returns import detect
from vlp16emu.scenario import Scenario
from vlp16emu.sensor import SEQUENCE_NS
from vlp16emu.telemetry import position_number, position_packets
from vlp16emu.types import Packet, Returns, ReturnMode, SensorModel, Window
from vlp16emu.units import seconds_to_ns

__all__ = ["BLOCK", "Emulator"]

BLOCK = 1_920
"""Firing sequences computed at once, 106 ms: whole packets in every return mode, whole packets of 8 rays."""
_BLOCK_NS = BLOCK * SEQUENCE_NS
_STRETCH = 64
"""Blocks that share a window of the world, 6.8 s or some 8 m of walking."""

T = TypeVar("T")


class Emulator:
    """A VLP-16 in the world of a scenario.

    Parameters
    ----------
    scenario : decides every byte
    threads : workers, 0 for one per core; they change the speed only
    truth : keep the surface behind each return

    Raises
    ------
    InputError
        where a part of the scenario cannot be made
    """

    def __init__(self, scenario: Scenario, *, threads: int = 0, truth: bool = False) -> None:
        self.scenario = scenario
        self._parts = assemble(scenario)
        self._truth = truth
        self._threads = threads or len(os.sched_getaffinity(0))
        self._mode, self._model = ReturnMode(scenario.sensor.return_mode), SensorModel(scenario.sensor.model)
        self._builders = ThreadPoolExecutor(self._threads, "build")
        self._caster = caster(self._parts.world.shape, self._builders)

    def packets(self, start_s: float = 0.0, stop_s: float | None = None) -> Iterator[Packet]:
        """Packets that leave from `start_s` until before `stop_s` after the first pulse, in order of sending.

        Raises
        ------
        TrajectoryError
            where the walk is over before `stop_s`
        """
        start_ns, stop_ns = self._span(start_s, stop_s)
        streams = (
            self._data_packets(start_ns, stop_ns),
            position_packets(self.scenario, self._parts, start_ns, stop_ns),
        )
        return heapq.merge(*streams, key=lambda packet: packet.due_ns)

    def returns(self, start_s: float = 0.0, stop_s: float | None = None) -> Iterator[Returns]:
        """Returns of the same run before packing, in whole blocks that hold at least the same span."""
        start_ns, stop_ns = self._span(start_s, stop_s)
        return self._blocks(self._scan, start_ns // _BLOCK_NS, -(-stop_ns // _BLOCK_NS))

    def first_position_packet(self, start_s: float = 0.0) -> int:
        """Find the number of the first position packet from `start_s` on; the run's first has 0."""
        return position_number(self.scenario, seconds_to_ns(start_s))

    def _span(self, start_s: float, stop_s: float | None) -> tuple[int, int]:
        """Nanoseconds since the first pulse."""
        stop_s = self.scenario.duration_s if stop_s is None else stop_s
        if stop_s > (end_s := self._parts.motion.run_time_s):
            raise TrajectoryError(
                "duration", f"found {stop_s:g} s", f"at most {end_s:.1f} s, when the walk is over"
            )
        return seconds_to_ns(start_s), seconds_to_ns(stop_s)

    def _scan(self, block: int, opened: Future[tuple[Window, Scene]]) -> Returns:
        """One block of pulses, from poses to returns."""
        head, sensor = self._parts.head, self.scenario.sensor
        t_ns = head.times_ns(block * BLOCK, BLOCK)
        poses = self._parts.motion.poses_at(t_ns.reshape(-1))
        firings = head.aim(block * BLOCK, t_ns, poses)
        window, scene = opened.result()
        hits = scene.cast(firings, head.beams.near_m, sensor.max_range_m)
        return detect(
            firings,
            hits,
            window.surfaces,
            min_range_m=sensor.min_range_m,
            max_range_m=sensor.max_range_m,
            truth=self._truth,
        )

    def _pack(self, block: int, opened: Future[tuple[Window, Scene]]) -> list[Packet]:
        """One block of pulses, from poses to packets."""
        return pack_data(self._scan(block, opened), self._mode, self._model)

    def _open(self, stretch: int) -> tuple[Window, Scene]:
        """Open what is within reach of a stretch of the walk."""
        blocks = np.arange(stretch * _STRETCH, (stretch + 1) * _STRETCH + 1)
        track = self._parts.motion.poses_at(self.scenario.start_ns + blocks * _BLOCK_NS)
        window = self._parts.world.window(track.world_p_body_m)
        return window, self._caster.open(window)

    def _blocks(
        self, work: Callable[[int, Future[tuple[Window, Scene]]], T], first: int, last: int
    ) -> Iterator[T]:
        """Work on blocks first .. last - 1 with the windows that they need; one window serves all where nothing moves."""
        per_stretch = _STRETCH if self._parts.motion.moves else None
        return ahead(
            work, self._open, blocks=range(first, last), per_stretch=per_stretch, threads=self._threads
        )

    def _data_packets(self, start_ns: int, stop_ns: int) -> Iterator[Packet]:
        """Data packets due in a span since the first pulse."""
        period_ns = SEQUENCES_PER_PACKET[self._mode] * SEQUENCE_NS
        # Packet p is due at (p + 1) periods.
        first, last = (max(0, -(-ns // period_ns) - 1) for ns in (start_ns, stop_ns))
        per_block = BLOCK // SEQUENCES_PER_PACKET[self._mode]
        number = first // per_block * per_block
        for packets in self._blocks(self._pack, first // per_block, -(-last // per_block)):
            yield from packets[max(0, first - number) : last - number]
            number += per_block
