"""A scene that is read and set up, with its name and its files."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from vlp16emu.doors import door, has_door
from vlp16emu.engine import Engine
from vlp16emu.errors import InputError
from vlp16emu.output import spare
from vlp16emu.run.options import TruthPlace, TruthTo
from vlp16emu.scenario import Scenario, find, load
from vlp16emu.scenario.find import named_files

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
    audit: Any = None
    """Tap that casts a sample of the pulses again, to estimate their error."""

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
        # Poses of a live run are not known again when its pulses are cast a second time.
        wanted = audit and has_door("audit") and not scenario.motion.takes_poses
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
    def finding(self) -> Any:
        """Error found so far; None without an audit."""
        return self.audit.finding if self.audit else None

    def number(self, unit: int) -> int:
        """Return the index in the rig, from 0, of unit 1, 2 ....

        Raises
        ------
        InputError : If there is no such unit
        """
        if not 1 <= unit <= (units := len(self.engine.parts.units)):
            raise InputError("unit", f"found {unit}", f"1 to {units}, as the scene has {units} units")
        return unit - 1

    def changed(self, settings: Mapping[str, object] | Sequence[str]) -> Self:
        """Return a run with some settings changed, which shares the world if that stays the same."""
        scenario, engine = load(self.scenario, settings), self.engine
        if scenario == self.scenario:
            return self
        made = type(self).of(scenario, threads=engine.threads, audit=self.audit is not None, like=engine)
        return replace(made, engine=replace(made.engine, truth_of=engine.truth_of), name=self.name, files=self.files)

    def with_truth_in(self, to: TruthTo | None) -> Self:
        """Return a run whose packets carry the ground truth of their records, if `to` asks for it."""
        if to is None or not to.per_return:
            return self
        return replace(self, engine=replace(self.engine, truth_of=door("truth_of_records")))

    @contextmanager
    def truth(self, to: TruthPlace | None, span_s: tuple[float, float], *, of: Any) -> Iterator[Any]:
        """Open the folder for the ground truth of a span, an `extras.truth.truth.Truth`; None if none is wanted.

        Parameters
        ----------
        of : this run, or the feed whose engine makes the packets, with the events so far
        """
        if (place := TruthTo.of(to)) is None:
            yield None
            return
        spare(self.files, place.scenario)
        with door("truth")(place, of, span_s) as truth:
            yield truth
