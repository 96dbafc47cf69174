"""The command line, one verb per file. What is heavy is imported inside the verbs, so that `--help` is quick."""

from vlp16emu.cli.app import main

__all__ = ["main"]
