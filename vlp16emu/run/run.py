"""A scene that is read and set up, with its name and its files."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import Any, Protocol, Self

from vlp16emu.doors import door, has_door
from vlp16emu.engine import Engine
from vlp16emu.errors import InputError
from vlp16emu.motion.settings import takes_poses
from vlp16emu.output import spare
from vlp16emu.run.options import TruthPlace, TruthTo
from vlp16emu.run.report import AuditFinding
from vlp16emu.scenario import Scenario, find, load
from vlp16emu.scenario.find import named_files
from vlp16emu.types import Packet


class HasEngine(Protocol):
    """Owner of the engine of a run, which may replace it while the run goes on."""

    @property
    def engine(self) -> Engine:
        """The engine as it is now."""


class Audit(Protocol):
    """Tap that casts a sample of the pulses again."""

    @property
    def finding(self) -> AuditFinding:
        """Error found so far."""


class Truth(Protocol):
    """The ground truth of a run, as it is written."""

    def beside(self, packets: Iterable[Packet]) -> Iterator[Packet]:
        """Pass packets on, and write the ground truth up to each of them."""

    def up_to(self, since_s: float) -> None:
        """Write the ground truth up to a time since the first pulse, for a run without packets."""


Scene = str | Path | Mapping[str, Any] | Scenario
"""Name of a scene, path of a .toml file, its tables as a dictionary, or a scenario."""


@dataclass(frozen=True, slots=True)
class Run:
    """An engine with the name and the input files of its run."""

    engine: Engine
    name: str
    """Name, path or title of the scene."""
    files: tuple[Path, ...]
    """Files that the run reads; no output replaces them."""
    audit: Audit | None = None
    """Casts a sample of the pulses again, to estimate their error."""

    @classmethod
    def of(
        cls,
        scene: Scene,
        settings: Mapping[str, object] | Sequence[str] = (),
        *,
        ideal: bool = False,
        threads: int = 0,
        audit: bool = False,
        like: Engine | None = None,
    ) -> Self:
        """Read a scene and set it up; parameters and errors as of `Emulator`."""
        scenario = load(scene, settings, ideal=ideal)
        wanted = audit and has_door("audit") and not takes_poses(scenario.motion)
        observer = door("audit").of(scenario) if wanted else None
        engine = Engine.of(scenario, threads=threads, taps=[observer] if observer else [], like=like)
        is_named = isinstance(scene, str | Path)
        own = [find(str(scene))] if is_named else []
        name = str(scene) if is_named else scenario.title
        return cls(engine, name, (*own, *named_files(scenario)), observer)

    @property
    def scenario(self) -> Scenario:
        """Everything that decides the bytes."""
        return self.engine.scenario

    @property
    def finding(self) -> AuditFinding | None:
        """Error found so far; None without an audit."""
        return self.audit.finding if self.audit else None

    def number(self, unit: int) -> int:
        """Return the index in the rig, from 0, of unit 1, 2 ....

        Raises
        ------
        InputError
            If there is no such unit
        """
        if not 1 <= unit <= (units := len(self.engine.parts.units)):
            raise InputError("unit", f"found {unit}", f"1 to {units}, as the scene has {units} units")
        return unit - 1

    def with_settings(self, settings: Mapping[str, object]) -> Self:
        """Return a run with some settings changed, if they are not as wanted."""
        if all(attrgetter(key)(self.scenario) == value for key, value in settings.items()):
            return self
        return self._changed(settings)

    def with_texts(self, settings: Sequence[str]) -> Self:
        """Return a run with some settings changed, each KEY=VALUE as on the command line."""
        return self._changed(settings)

    def _changed(self, settings: Mapping[str, object] | Sequence[str]) -> Self:
        engine, is_audited = self.engine, self.audit is not None
        changed = type(self).of(self.scenario, settings, threads=engine.threads, audit=is_audited, like=engine)
        engine = replace(changed.engine, truth_of=engine.truth_of)
        return replace(changed, engine=engine, name=self.name, files=self.files)

    def with_truth_in(self, to: TruthTo | None) -> Self:
        """Return a run whose packets carry the ground truth of their records, if `to` asks for it."""
        if to is None or not to.per_return:
            return self
        return replace(self, engine=replace(self.engine, truth_of=door("truth_of_records")))

    @contextmanager
    def truth(self, to: TruthPlace | None, span_s: tuple[float, float], *, of: HasEngine) -> Iterator[Truth | None]:
        """Open the folder for the ground truth of a span; None if none is wanted.

        Parameters
        ----------
        of : whose engine makes the packets, with the events so far
        """
        if (place := TruthTo.of(to)) is None:
            yield None
            return
        spare(self.files, place.scenario)
        with door("truth")(place, of, span_s) as truth:
            yield truth
