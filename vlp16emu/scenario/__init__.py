"""The scene file as a frozen, strict tree of sections."""

from vlp16emu.scenario.load import find, load, named_files, rewrite, scene_files
from vlp16emu.scenario.model import Scenario, schema

__all__ = ["Scenario", "find", "load", "named_files", "rewrite", "scene_files", "schema"]
