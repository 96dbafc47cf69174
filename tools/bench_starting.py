"""Starting: time to the first packet, with and without a cache, and of `--help`."""

import os
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

from rich.box import MARKDOWN
from rich.table import Table
from toolbox import VLP16EMU, set_words

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
    turns : of which medians are printed
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
            cold_s, _ = _took(words, cache)
            runs = [_took(words, cache) for _ in range(turns)]
            wall_s, cpu_s = (statistics.median(column) for column in zip(*runs, strict=True))
            table.add_row(name, f"{cold_s:.2f}", f"{wall_s:.2f}", f"{cpu_s:.2f}")
    return table


def _took(words: list[str], variables: dict[str, str]) -> tuple[float, float]:
    """Return run time and CPU time of the program, with its own variables of the environment, in s."""
    began_s = time.perf_counter()
    environment = os.environ | variables
    with subprocess.Popen([*VLP16EMU, *words], stdout=subprocess.DEVNULL, env=environment) as process:
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"vlp16emu {' '.join(words)}: exit code {process.returncode}")
    return time.perf_counter() - began_s, used.ru_utime + used.ru_stime
