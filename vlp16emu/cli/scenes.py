"""`vlp16emu scenes`: what can be recorded by name."""

from vlp16emu.cli.arguments import AsJson
from vlp16emu.cli.output import print_json, print_rows

__all__ = ["scenes"]


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
