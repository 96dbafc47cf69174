"""pytest plugin: the fixture `vlp16`, a sensor that sends packets to free ports while a test runs.

Nothing of the emulator is loaded, and numba is left alone, in a session whose tests do not ask for the
fixture.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from vlp16emu.extras.handle import Live
    from vlp16emu.run.emulator import Emulator

_LOOK_AHEAD = 128
"""Packets that are computed before the first one is sent, 0.17 s: a hall is computed several times faster
than sent."""
_LONGEST_S = 7 * 86_400.0  # longest run of a scene
_LAST: "pytest.StashKey[Emulator]" = pytest.StashKey()  # emulator of the previous test, whose world is reused


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that names the scene."""
    meaning = "Scene of the fixture vlp16, where no marker names one (vlp16emu)."
    parser.getgroup("vlp16emu").addoption("--vlp16-scene", metavar="SCENE", help=meaning)
    parser.addini("vlp16_scene", meaning, default="static_bench")


def pytest_configure(config: pytest.Config) -> None:
    """Register the marker."""
    meaning = "scene of the fixture vlp16, values by key, and options of vlp16emu.stream."
    line = f"vlp16(scene, settings, **options): {meaning}"
    config.addinivalue_line("markers", line)


@pytest.fixture
def vlp16(request: pytest.FixtureRequest) -> "Iterator[Live]":
    """Stream a scene while a test runs: `vlp16emu.Live`, whose first packet is sent.

    The scene is given by the marker, by `--vlp16-scene`, or by `vlp16_scene` of the ini file. The default,
    static_bench, is a hall with posts, boxes and balls, and a sensor without errors. The stream ends with the
    test, or with the walk.
    """
    from vlp16emu.extras.handle import Live
    from vlp16emu.run.emulator import Emulator

    marker = request.node.get_closest_marker("vlp16")
    config = request.config
    scene, settings, options = _arguments(*marker.args, **marker.kwargs) if marker else _arguments()
    scene = scene or config.getoption("--vlp16-scene") or config.getini("vlp16_scene")
    emulator = config.stash[_LAST] = Emulator(scene, settings, like=config.stash.get(_LAST, None))
    end_s = min(emulator.parts.motion.run_time_s, _LONGEST_S)
    with Live(emulator, **{"look_ahead": _LOOK_AHEAD, "duration_s": end_s} | options) as live:
        yield live


def _arguments(
    scene: Any = None, settings: Mapping[str, object] | Sequence[str] = (), **options: Any
) -> tuple[Any, Mapping[str, object] | Sequence[str], dict[str, Any]]:
    """Return scene, settings and options of a marker."""
    return scene, settings, options
