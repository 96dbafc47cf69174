"""A scene made ready to run, its recording, and the ground truth beside it."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any

from vlp16emu.accuracy import Audit
from vlp16emu.chain.chain import Chain
from vlp16emu.device.host_clock import CaptureClock, HostClock
from vlp16emu.errors import InputError, OutputError, spare
from vlp16emu.motion.live_settings import takes_poses
from vlp16emu.recording import FileSinks, Recording, paths_of_units, pcap_files, record_packets
from vlp16emu.scenario import Scenario, find, load
from vlp16emu.scenario.find import named_files
from vlp16emu.sinks import TruthTo, check_ending
from vlp16emu.sinks.bag import check_bag, is_bag
from vlp16emu.types import Packet

if TYPE_CHECKING:
    from vlp16emu.truth import Truth


class Run(Chain):
    """The chain of a scene that is read, and what is written of it; parameters and errors as of `Emulator`."""

    def __init__(
        self,
        scene: str | Path | Mapping[str, Any] | Scenario,
        settings: Mapping[str, object] | Sequence[str] = (),
        *,
        ideal: bool = False,
        threads: int = 0,
        audit: bool = False,
        like: Chain | None = None,
    ) -> None:
        scenario = load(scene, settings, ideal=ideal)
        self.audit = Audit.of(scenario) if audit and not takes_poses(scenario.motion) else None
        world_of = (like.scenario, like.parts) if like else None
        super().__init__(scenario, threads=threads, audit=self.audit, like=world_of)
        self.name = str(scene) if isinstance(scene, str | Path) else scenario.title
        own = [find(str(scene))] if isinstance(scene, str | Path) else []
        self._files = [*own, *named_files(scenario)]

    def record(
        self,
        path: str | Path,
        *,
        start_s: float = 0.0,
        duration_s: float | None = None,
        split: bool = False,
        truth: str | Path | TruthTo | None = None,
        as_due: bool = False,
        progress: Callable[[float], None] = lambda _: None,
        stop: Event | None = None,
    ) -> Recording:
        """Write data and position packets into a pcap file, in the frames of a real sensor; or all that a robot has into a bag.

        Parameters
        ----------
        path : .pcap, .cap, .dump, .dmp or without an ending; overwritten if it exists; `-` is standard output; a bag with
            .mcap, .bag, or as a new folder with a slash at its end
        start_s : since the first pulse
        duration_s : until the end of the scene if left out
        split : write the packets of each unit into a file of its own, `NAME_1.pcap` and so on
        truth : folder for the ground truth of the run: trajectory, GNSS, rig, scenario
        as_due : stamp packets when they are due, whatever `[capture]` says
        progress : called with the simulated seconds so far, packet by packet
        stop : ends the recording from another thread; the file is valid

        Raises
        ------
        OutputError
            where file or folder cannot be written, or are an input of the scene, or the name is that of another format
        ScenarioError
            where the sensor has no packets
        TrajectoryError
            where the walk is over before the span
        RunError
            where the disk is full; the packets before are kept, of a bag nothing
        MissingExtraError
            where rosbags is not there for a bag
        """
        links, span_s = [unit.link for unit in self.parts.units], self.scenario.span_s(start_s, duration_s)
        paths = paths_of_units(Path(path), len(links)) if split else [Path(path)]
        for one in paths:
            spare(self._files, one)
        if is_bag(path):
            from vlp16emu.bag import bag_of_run  # here: few runs need it

            if split:
                raise OutputError(str(path), "found a bag to be split", "one bag for all sensors, or .pcap")
            check_bag(Path(path))
            files: FileSinks = bag_of_run(
                Path(path), self, truth.rate_hz if isinstance(truth, TruthTo) else 200
            )
        else:
            check_ending(Path(path))
            files = pcap_files(paths, links)
        stop, packets = stop or Event(), self.packets(*span_s)  # checks the span before a file is touched
        clock = CaptureClock(preset="ideal") if as_due else self.scenario.capture
        with self.windows.stopped_by(stop):
            recording = record_packets(
                self,
                self._with_truth(packets, span_s, truth),
                files,
                span_s,
                name=", ".join(map(str, paths)),
                scene=self.name,
                host=HostClock(clock, self.scenario.seed, self.scenario.start_ns),
                progress=progress,
                stop=stop,
            )
        return replace(recording, audit=self.audit.finding if self.audit else None)

    def _number(self, unit: int) -> int:
        """Place in the rig of a unit, from 0."""
        if not 1 <= unit <= (units := len(self.parts.units)):
            raise InputError("unit", f"found {unit}", f"1 to {units}, as the scene has {units} units")
        return unit - 1

    @contextmanager
    def _with_truth(
        self, packets: Iterator[Packet], span_s: tuple[float, float], to: str | Path | TruthTo | None
    ) -> Iterator[Iterator[Packet]]:
        with nullcontext() if to is None else self._truth(to, span_s) as truth:
            yield packets if truth is None else truth.beside(packets)

    @contextmanager
    def _with_truth_so_far(
        self,
        progress: Callable[[float], None],
        span_s: tuple[float, float],
        to: str | Path | TruthTo | None,
    ) -> Iterator[Callable[[float], None]]:
        """Progress of a run without packets, whose truth is written as it is called, where a folder is given."""

        def so_far(done_s: float) -> None:
            if truth is not None:
                truth.up_to(span_s[0] + done_s)
            progress(done_s)

        with nullcontext() if to is None else self._truth(to, span_s) as truth:
            yield so_far

    def _truth(self, to: str | Path | TruthTo, span_s: tuple[float, float]) -> "Truth":
        """Begin a folder of truth, beside the files that the run reads."""
        from vlp16emu.truth import Truth  # here: few runs need it

        place = to if isinstance(to, TruthTo) else TruthTo(Path(to))
        spare(self._files, place.scenario)
        self.with_slots = place.per_return
        return Truth(place, self, span_s)
