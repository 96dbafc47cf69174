"""Tests grow their worlds themselves, unless they are about what is kept."""

import gc
import os
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path

import pytest
from kit import DEFAULT_UNIT

from vlp16emu.output import is_ending

os.environ["VLP16EMU_CACHE_DIR"] = "off"
os.environ.pop("VLP16EMU_CACHE_MB", None)
# Two workers have a core each: threads of linear algebra would spin beside them for nothing.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
# Hypothesis keeps paths of the machine beside the examples that it found: not in the checkout.
os.environ.setdefault(
    "HYPOTHESIS_STORAGE_DIRECTORY", str(Path(tempfile.gettempdir()) / "vlp16emu-hypothesis")
)

ALLOWED_SKIPS = {
    "captures of others lie beside the repository and not in it": (
        "beside the repository",
        "not at hand",
        "captures of real sensors",
    ),
    "a container may have no right to make networks": (
        "a private network needs root",
        "allows no private network",
    ),
    "the package is 400 MB for one test": ("no PCL tools",),
}
"""Parts of the reasons for which a test may be skipped with CI=true, and why."""

WOODS = "VLP16EMU_TEST_WOODS"  # variable that names the folder of `kept_woods` to workers


def pytest_configure(config):
    """Make an empty folder for what grows in this session, which goes with it."""
    if WOODS not in os.environ:
        folder = tempfile.TemporaryDirectory(prefix="vlp16emu-woods-")
        os.environ[WOODS] = folder.name
        config.add_cleanup(lambda: os.environ.pop(WOODS))
        config.add_cleanup(folder.cleanup)


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Collect without looking for garbage: the tests stay to the end, and are never looked through again."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def _without_skip(report):
    """Turn a skip into a failure where CI is true, unless its reason is on the list."""
    if not report.skipped or hasattr(report, "wasxfail") or os.environ.get("CI") != "true":
        return report
    reason = str(report.longrepr[-1] if isinstance(report.longrepr, tuple) else report.longrepr)
    if not any(part in reason for parts in ALLOWED_SKIPS.values() for part in parts):
        report.outcome, report.longrepr = (
            "failed",
            f"skipped with CI=true, and not on the list of tests/conftest.py: {reason}",
        )
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport():
    """Let no test be skipped in silence where all that it needs is installed."""
    return _without_skip((yield))


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report():
    """Let no file be skipped either."""
    return _without_skip((yield))


@pytest.fixture(autouse=True)
def no_signal_left():
    """Let no test begin with the end of a run that a signal reached in a test before."""
    is_ending.clear()


@pytest.fixture(scope="session")
def tool_named():
    """Load a script of `tools/` as a module, by its name."""

    def load(name):
        loader = SourceFileLoader(name, str(Path(__file__).resolve().parents[1] / "tools" / name))
        module = sys.modules[name] = module_from_spec(
            spec_from_loader(name, loader)
        )  # dataclasses look there
        loader.exec_module(module)
        return module

    return load


@pytest.fixture(scope="module")
def kept_woods():
    """Keep on disk what grows from test to test, where they are about what is seen of it and not about how
    it grows."""
    from vlp16emu.store import user_store

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("VLP16EMU_CACHE_DIR", os.environ[WOODS])
        user_store.cache_clear()
        yield
        user_store().flush()
    user_store.cache_clear()


@pytest.fixture(scope="session", params=["static_bench", DEFAULT_UNIT], ids=["ideal unit", "default unit"])
def each_unit(request):
    """Scene of a hall with a sensor without errors, GPS and beam width, then with the unit of scenes by
    default."""
    return request.param


@pytest.fixture(scope="session")
def default_unit():
    """Scene of a hall with the unit that scenes have by default: rotor and noise of a real one, GPS, beams
    with a width."""
    return DEFAULT_UNIT


@pytest.fixture
def refused(capsys):
    """Run a command line that is bad input, and return the one line that says so."""
    from vlp16emu.cli.app import run

    def line_of(words):
        capsys.readouterr()
        assert run([str(word) for word in words]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        return error

    return line_of


@pytest.fixture(scope="session")
def workers():
    """Threads that build shapes."""
    with ThreadPoolExecutor(2) as pool:
        yield pool


def pytest_sessionstart():
    """Compile one small kernel, so that no program that a test calls says that it is the first to compile."""
    from vlp16emu.trig import in_quarter

    in_quarter(1.0, 0.5)
