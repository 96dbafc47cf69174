"""Starting: time to the first packet, with and without a cache, and of `--help`."""

import os
import statistics
import tempfile
from pathlib import Path

from rich.box import MARKDOWN
from rich.table import Table
from toolbox import VLP16EMU, set_words, took

RUNS = {
    # name: scene, its settings
    "hall": ("static_bench", []),
    "forest": ("reference_forest", []),
    "forest with its field day": ("birch_walk", ["conditions=field"]),
    "forest in the wind": ("windy_spruce", []),
}
FIRST_S = 0.002  # a recording that ends with its first packets
TURNS = 5


def starting_table(scenes: int, turns: int = TURNS) -> Table:
    """Start the program in new processes: with an empty cache, in the order of the rows, and then with it.

    Parameters
    ----------
    scenes : number of the scenes, from the first on
    turns : runs with a full cache, whose medians are printed
    """
    title = f"to the first packet, s; load {os.getloadavg()[0]:.1f}"
    table = Table("what", "empty cache", "run time", "CPU time", title=title, box=MARKDOWN)
    with tempfile.TemporaryDirectory() as folder:
        commands = {"`--help`": ["--help"]}
        for name, (scene, settings) in list(RUNS.items())[:scenes]:
            words = ["record", scene, str(Path(folder) / "first.pcap"), "--duration", str(FIRST_S)]
            commands[name] = [*words, *set_words(settings), "--no-audit", "--json"]
        cache = {"VLP16EMU_CACHE_DIR": str(Path(folder) / "cache")}
        for name, words in commands.items():
            cold_s = took([*VLP16EMU, *words], **cache).wall_s
            runs = [took([*VLP16EMU, *words], **cache) for _ in range(turns)]
            wall_s, cpu_s = (
                statistics.median(column) for column in zip(*(run[:2] for run in runs), strict=True)
            )
            table.add_row(name, f"{cold_s:.2f}", f"{wall_s:.2f}", f"{cpu_s:.2f}")
    return table
