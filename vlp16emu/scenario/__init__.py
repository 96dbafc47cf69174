"""The scene file as a frozen, strict tree of sections."""

from vlp16emu.scenario.find import find, scene_files
from vlp16emu.scenario.load import load
from vlp16emu.scenario.model import Scenario
from vlp16emu.scenario.schema import schema

__all__ = ["Scenario", "find", "load", "scene_files", "schema"]
