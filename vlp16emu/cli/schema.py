"""`vlp16emu schema`: what a scene file may say."""

from vlp16emu.cli.output import print_json

__all__ = ["schema"]


def schema() -> None:
    """Print the JSON Schema of the scene file.

    Editors that know TOML complete keys and show errors with it.
    """
    from vlp16emu.scenario import schema as scene_schema

    print_json(scene_schema())
