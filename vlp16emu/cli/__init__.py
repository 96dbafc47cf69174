"""The command line. Heavy modules are imported inside the verbs, so that `--help` is quick."""

from vlp16emu.cli.app import main

__all__ = ["main"]
