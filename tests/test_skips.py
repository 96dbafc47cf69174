"""Which skips continuous integration takes."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SKIPS = """
import pytest

def test_without_a_program():
    pytest.skip("no such program")

def test_without_captures():
    pytest.skip("no real captures beside the repository")

@pytest.mark.xfail(reason="known")
def test_known():
    assert False
"""


@pytest.mark.parametrize(
    ("value", "counts"), [("true", "1 failed, 1 skipped, 1 xfailed"), ("", "2 skipped, 1 xfailed")]
)
def test_a_skip_fails_with_ci_unless_it_is_on_the_list(tmp_path, value, counts):
    """With CI=true a test that lacks a program fails, as does a file; one whose captures are not there is skipped."""
    shutil.copy(Path(__file__).with_name("conftest.py"), tmp_path)
    (tmp_path / "test_some.py").write_text(SKIPS)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", tmp_path, tmp_path]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=tmp_path, env={**os.environ, "CI": value}
    )
    assert counts in done.stdout
