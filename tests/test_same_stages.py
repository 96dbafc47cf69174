"""`tools/same_bytes`: what it compares, and what it says of a difference."""

import subprocess

import numpy as np
import pytest


@pytest.fixture(scope="module")
def same_bytes(tool_named):
    return tool_named("same_bytes")


@pytest.fixture(scope="module")
def hall(same_bytes):
    """Arrays of the hall."""
    return dict(same_bytes.made(["hall"], 1, 1))["hall"]


def nudged(arrays, name):
    """Arrays of which one has its third number in the next greater one's place."""
    array = arrays[name].copy()
    number = array.reshape(-1)[2:3]
    number[:] = np.nextafter(number, np.inf) if array.dtype.kind == "f" else number + 1
    return arrays | {name: array}


@pytest.fixture
def check(same_bytes, hall, monkeypatch, capsys):
    """Let the tool run with workers of our own, which give arrays for the environment that they are called
    with."""

    def call(work, *arguments):
        def _run(self, environment, folder):
            folder.mkdir(exist_ok=True)
            np.savez(folder / "hall.npz", **(hall if environment is same_bytes.USUAL else work(environment)))
            np.savez(
                folder / "probes.npz", **dict.fromkeys(("libm", "numpy", "blas", "triangles"), np.zeros(3))
            )
            return ""

        monkeypatch.setattr(same_bytes.Check, "_run", _run)
        monkeypatch.setattr("sys.argv", ["same_bytes", "--scenes", "hall", *arguments])
        return same_bytes.main(), capsys.readouterr().out

    return call


@pytest.mark.parametrize(
    "name", ["world/shape.vertices_m", "firings/direction", "returns/distance_m", "packets/payload"]
)
def test_a_planted_difference_is_found_at_its_stage(check, hall, name):
    """One number that is one step greater gives exit code 1, and the stage, the count, the size and the
    place."""
    code, out = check(lambda _: nudged(hall, name), "--only", "one thread")
    stage, one = name.partition("/")[0], hall[name]
    bytes_too = "" if stage == "packets" else " (same bytes)"
    assert code == 1
    assert f"| one thread | - | **{stage}**{bytes_too} |\n" in out
    place, apart = (
        [int(i) for i in np.unravel_index(2, one.shape)],
        ", 1" if stage == "packets" else ", 1 ulp, ",
    )
    assert f"- one thread, hall: {name} at {place}: 1 of {one.size}{apart}" in out
    assert out.endswith("different: one thread\n")


def test_a_difference_among_environments_that_share_a_process_is_traced_to_one(check, hall):
    """Where a process differs, each of its environments runs alone, and the one that differs is named."""
    code, out = check(
        lambda environment: nudged(hall, "hits/range_m") if "pieces" in environment.name else hall
    )
    assert code == 1
    assert "| OpenBLAS Prescott | none here | same |" in out
    assert out.endswith("; in three pieces, in three pieces\n")


def test_a_worker_that_fails_is_shown(check):
    """A worker that ends with an error gives exit code 1, and its last line."""

    def fail(_):
        raise subprocess.CalledProcessError(1, "worker", stderr="Traceback\nIllegal instruction")

    code, out = check(fail, "--only", "one thread")
    assert code == 1
    assert "**failed**: Illegal instruction" in out
