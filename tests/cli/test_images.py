"""Images from the command line."""

import json

import numpy as np
import pytest

pytest.importorskip("OpenEXR", reason="extra images")


def test_the_command_writes_them(cli, tmp_path):
    """The verb takes size, field of view and span, and reports what it wrote; a size that is none is refused."""
    options = ("--kind", "pinhole", "--size", "64x48", "--fov", 60, "--every", 0.2, "--duration", 0.3)
    said = cli("images", "static_bench", tmp_path / "views", "--json", *options).tree
    camera = json.loads((tmp_path / "views" / "cameras.json").read_text())
    assert (said["images"], said["width"], said["height"], said["kind"]) == (2, 64, 48, "pinhole")
    assert camera["fx"] == pytest.approx(32 / np.tan(np.radians(30)))
    assert said["bytes"] == sum(path.stat().st_size for path in (tmp_path / "views").glob("*/*"))
    refused = cli("images", "static_bench", tmp_path / "more", "--size", "64")
    assert (refused.code, "--size: found 64; expected width and height" in refused.err) == (2, True)
