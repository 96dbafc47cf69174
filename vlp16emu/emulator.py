"""The program on one page: poses -> aim -> cast -> detect -> pack, in order of sending.

Blocks of firing sequences are always computed whole, and windows of the world are opened at fixed
blocks, so neither threads nor the span that is asked for can change a byte.
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
from vlp16emu.pipeline import BLOCK, STRETCH, ahead
from vlp16emu.raycast import Scene, caster
from vlp16emu.returns import detect
from vlp16emu.scenario import Scenario
from vlp16emu.sensor import SEQUENCE_NS
from vlp16emu.telemetry import position_number, position_packets
from vlp16emu.types import Packet, ReturnMode, Returns, SensorModel
from vlp16emu.units import seconds_to_ns

__all__ = ["Emulator"]

_BLOCK_NS = BLOCK * SEQUENCE_NS

T = TypeVar("T")


class Emulator:
    """A sensor in the world of a scenario.

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
        self._threads = threads or os.cpu_count() or 1
        self._mode, self._model = ReturnMode(scenario.sensor.return_mode), SensorModel(scenario.sensor.model)
        self._caster = caster(self._parts.world.shape, ThreadPoolExecutor(self._threads, "build"))

    def packets(self, start_s: float = 0.0, stop_s: float | None = None) -> Iterator[Packet]:
        """Packets that leave from `start_s` until before `stop_s` after the first pulse, in order of sending.

        Raises
        ------
        TrajectoryError
            where the walk is over before `stop_s`
        """
        span_ns = self._span_ns(start_s, stop_s)
        position = position_packets(self.scenario, self._parts, *span_ns)
        return heapq.merge(self._data_packets(*span_ns), position, key=lambda packet: packet.due_ns)

    def returns(self, start_s: float = 0.0, stop_s: float | None = None) -> Iterator[Returns]:
        """Give the returns of the same run before packing, in whole blocks that hold at least the same span."""
        start_ns, stop_ns = self._span_ns(start_s, stop_s)
        return self._blocks(self._scan, range(start_ns // _BLOCK_NS, -(-stop_ns // _BLOCK_NS)))

    def first_position_packet(self, start_s: float = 0.0) -> int:
        """Find the number of the first position packet from `start_s` on; the run's first has 0."""
        return position_number(self.scenario, seconds_to_ns(start_s))

    def _span_ns(self, start_s: float, stop_s: float | None) -> tuple[int, int]:
        """Check a span and put it into nanoseconds since the first pulse."""
        stop_s = self.scenario.duration_s if stop_s is None else stop_s
        if stop_s > (end_s := self._parts.motion.run_time_s):
            raise TrajectoryError("duration", f"found {stop_s:g} s", f"at most the walk's {end_s:.1f} s")
        return seconds_to_ns(start_s), seconds_to_ns(stop_s)

    def _scan(self, block: int, opened: Future[Scene]) -> Returns:
        """Emit and receive one block of pulses."""
        head, limits = self._parts.head, self.scenario.sensor
        firings = head.aim(block * BLOCK, BLOCK, self._parts.motion.poses_at)
        scene = opened.result()
        hits = scene.cast(firings, head.beams.near_m, limits.max_range_m)
        return detect(
            firings, hits, scene.surfaces, limits.min_range_m, limits.max_range_m, truth=self._truth
        )

    def _open(self, stretch: int) -> Scene:
        """Open what is within reach of a stretch of the walk."""
        blocks = np.arange(stretch * STRETCH, (stretch + 1) * STRETCH + 1)
        track = self._parts.motion.poses_at(self.scenario.start_ns + blocks * _BLOCK_NS)
        return self._caster.open(self._parts.world.window(track.world_p_body_m))

    def _blocks(self, work: Callable[[int, Future[Scene]], T], blocks: range) -> Iterator[T]:
        """Work on blocks with the windows that they need; one window serves all where nothing moves."""
        per_stretch = STRETCH if self._parts.motion.moves else None
        return ahead(work, self._open, blocks=blocks, per_stretch=per_stretch, threads=self._threads)

    def _data_packets(self, start_ns: int, stop_ns: int) -> Iterator[Packet]:
        """Yield the data packets due in a span since the first pulse."""
        period_ns = SEQUENCES_PER_PACKET[self._mode] * SEQUENCE_NS
        per_block = BLOCK // SEQUENCES_PER_PACKET[self._mode]

        def pack(block: int, opened: Future[Scene]) -> list[Packet]:
            return pack_data(self._scan(block, opened), self._mode, self._model)

        # Packet p is due at (p + 1) periods.
        first, last = (max(0, -(-ns // period_ns) - 1) for ns in (start_ns, stop_ns))
        blocks = range(first // per_block, -(-last // per_block))
        for block, packets in zip(blocks, self._blocks(pack, blocks), strict=True):
            number = block * per_block
            yield from packets[max(0, first - number) : last - number]
