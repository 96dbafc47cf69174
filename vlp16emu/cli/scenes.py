"""`vlp16emu scenes` and `vlp16emu schema`: what can be recorded by name, and what a scene file may say."""

from vlp16emu.cli.arguments import AsJson
from vlp16emu.cli.terminal import print_json, print_rows


def scenes(*, as_json: AsJson = False) -> None:
    """List the scenes that can be called by name.

    They come with the program; those in the folder that the variable VLP16EMU_SCENES names come first.
    """
    from vlp16emu.scenario import load, scene_files

    known = {name: (load(str(path)), path) for name, path in scene_files().items()}
    if as_json:
        rows = [
            {
                "name": name,
                "title": scenario.title,
                "duration_s": scenario.duration_s,
                "motion": scenario.motion.kind,
                "world": scenario.world.kind,
                "file": str(path),
            }
            for name, (scenario, path) in known.items()
        ]
        print_json({"scenes": rows})
        return
    print_rows("scenes", {name: f"{s.duration_s:g} s  {s.title}" for name, (s, _) in known.items()})


def schema() -> None:
    """Print the JSON Schema of the scene file.

    Editors that know TOML complete keys and show errors with it.
    """
    from vlp16emu.scenario import schema as scene_schema

    print_json(scene_schema())
