"""`vlp16emu scenes` and `vlp16emu schema`: what can be recorded by name, and what a scene file may say."""

from vlp16emu.cli.arguments import AsJson
from vlp16emu.cli.printer import print_json, print_rows


def scenes(*, as_json: AsJson = False) -> None:
    """List the scenes that can be called by name.

    They come with the program; those in the folder that the variable VLP16EMU_SCENES names come first.
    """
    from vlp16emu.scenario import load, scene_files

    known = {name: (load(str(path)), path) for name, path in scene_files().items()}
    if not as_json:
        print_rows("scenes", {name: f"{s.duration_s:g} s  {s.title}" for name, (s, _) in known.items()})
        return
    rows = [
        {"name": name, "title": s.title, "duration_s": s.duration_s}
        | {"motion": s.motion.kind, "world": s.world.kind, "file": path}
        for name, (s, path) in known.items()
    ]
    print_json({"scenes": rows})


def schema() -> None:
    """Print the JSON Schema of the scene file.

    Editors that know TOML complete keys and show errors with it.
    """
    from vlp16emu.scenario import schema as scene_schema

    print_json(scene_schema())
