"""The file of a dataset: stands, seeds, paths and sensors, and the walk of each of their combinations."""

from dataclasses import dataclass
from itertools import pairwise, product
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, ValidationError, model_validator

from vlp16emu.errors import ScenarioError
from vlp16emu.explain import explain
from vlp16emu.inputs import read_text
from vlp16emu.random import Purpose, generator
from vlp16emu.scenario import Scenario, find, load
from vlp16emu.sensor.settings import require_packets
from vlp16emu.settings import ExpectationError, Fraction, Section, toml

_SPLITS = ("train", "val", "test")
_ROUNDING = 1e-9  # of the sum of three shares


def _each_once(values: list[Any]) -> list[Any]:
    """Return a list of variants or seeds; ExpectationError if a name or number is in it twice."""
    if len({getattr(value, "name", value) for value in values}) < len(values):
        raise ExpectationError("each name and each number once")
    return values


_OnceEach = Field(min_length=1), AfterValidator(_each_once)
_Seed = Annotated[int, Field(ge=0, lt=2**63)]


class _Variant(Section):
    """A name and settings of a scene."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,60}$")]  # part of the names of walks
    set: Annotated[list[str], Field(default_factory=list)]
    """Settings, each `key.path=value` as in `--set`; paths of files are relative to the current folder."""


class _Stand(_Variant):
    """A stand: a scene, in which paths and sensors may change settings."""

    scene: Annotated[str, Field(min_length=1)]
    """Name of a scene, or path of a scene file, which is relative to the folder of the dataset's file."""


class _Splits(Section):
    """Shares of the stands; all walks of a stand are in one split."""

    train: Fraction = 0.7
    val: Fraction = 0.15
    test: Fraction = 0.15

    @model_validator(mode="after")
    def _check_shares(self) -> Self:
        if abs(self.train + self.val + self.test - 1) > _ROUNDING:
            raise ExpectationError("train, val and test that sum to 1")
        return self


class DatasetSpec(Section):
    """The file of a dataset: each combination of stand, seed, path and sensor is a walk."""

    schema_version: Annotated[Literal[1], Field(alias="schema")]  # version of this format
    layout: Literal["semantickitti", "pcap+truth", "las-plots"]  # files that are written
    seed: _Seed = 1  # seed of the assignment of stands to splits
    seeds: Annotated[list[_Seed], *_OnceEach] = [1]  # noqa: RUF012  # pydantic copies it
    """Seeds of the scenes."""
    stands: Annotated[list[_Stand], *_OnceEach]  # scenes to walk in
    paths: Annotated[list[_Variant], *_OnceEach]  # paths through each stand
    sensors: Annotated[list[_Variant], *_OnceEach]  # sensors on each path
    splits: _Splits = _Splits()  # shares of the stands in train, val and test


@dataclass(frozen=True, slots=True)
class DatasetWalk:
    """One sensor on one path through one stand."""

    number: int  # from 0, in the order of stands, seeds, paths and sensors
    stand: str
    path: str
    sensor: str
    split: str
    layout: str
    scenario: Scenario

    @property
    def seed(self) -> int:
        """Seed of the scene."""
        return self.scenario.seed

    @property
    def name(self) -> str:
        """Unique name within the dataset."""
        return f"{self.stand}.{self.seed}.{self.path}.{self.sensor}"

    @property
    def folder(self) -> str:
        """Folder within the dataset."""
        if self.layout == "semantickitti":
            return f"sequences/{self.number:02d}"
        return f"walks/{self.number:04d}"


def load_spec(path: Path) -> DatasetSpec:
    """Read the file of a dataset; ScenarioError if it cannot be read or is not valid."""
    text = read_text(path, "a file of a dataset", ScenarioError)
    try:
        tree = toml(text)
    except (ValueError, RecursionError) as error:
        raise ScenarioError(str(path), f"no valid TOML: {error}", "a TOML file") from None
    try:
        return DatasetSpec.model_validate(tree)
    except ValidationError as error:
        key, found, expected = explain(error, DatasetSpec.model_json_schema())
        raise ScenarioError(f"{path}: {key}", found, expected) from None


def walks_of(spec: DatasetSpec, folder: Path) -> list[DatasetWalk]:
    """Return the walks of a dataset, with scene files found from `folder`.

    ScenarioError if a scene or a setting is wrong, or a sensor has no packets and the layout needs them.
    """
    split_of = _split_of(spec)
    walks = list[DatasetWalk]()
    for stand, seed, path, sensor in product(spec.stands, spec.seeds, spec.paths, spec.sensors):
        settings = [*stand.set, *path.set, *sensor.set]
        for setting in settings:
            if setting.partition("=")[0].strip() == "seed":
                raise ScenarioError("set", f"found {setting}", "no seed, as `seeds` has those of the scenes")
        settings.append(f"seed={seed}")
        scene = find(stand.scene)
        is_path = scene == Path(stand.scene)
        names = stand.name, path.name, sensor.name
        try:
            scenario = load(folder / scene if is_path else scene, settings)
            if spec.layout == "pcap+truth":
                require_packets(scenario.sensor)
        except ScenarioError as error:
            where = f"walk {stand.name}.{seed}.{path.name}.{sensor.name}: {error.where}"
            raise ScenarioError(where, error.found, error.expected) from None
        walks.append(DatasetWalk(len(walks), *names, split_of[stand.name], spec.layout, scenario))
    return walks


def _split_of(spec: DatasetSpec) -> dict[str, str]:
    """Return the split of each stand: the names are shuffled, and cut at the shares."""
    names = sorted(stand.name for stand in spec.stands)
    shuffled = [names[i] for i in generator(spec.seed, Purpose.DATASET_SPLIT).permutation(len(names))]
    ends = [0, *(round(end * len(names)) for end in (spec.splits.train, 1 - spec.splits.test, 1.0))]
    split_of = dict[str, str]()
    for split, (begin, end) in zip(_SPLITS, pairwise(ends), strict=True):
        split_of |= dict.fromkeys(shuffled[begin:end], split)
    return split_of
