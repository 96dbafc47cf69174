"""Command lines of all verbs, and their arguments and options that take a path."""

from pathlib import Path

from vlp16emu.cli.verb import options_of_function
from vlp16emu.doors import door

NO_PORTS = "--data-port 9 --position-port 10"
SMALL = "--set camera.width_px=32 --set camera.height_px=24"
SPEC = """
schema = 1
layout = "pcap+truth"
seeds = [1]
stands = [{ name = "hall", scene = "static_bench", set = ["duration_s=0.1"] }]
paths = [{ name = "middle" }]
sensors = [{ name = "puck" }]
splits = { train = 1.0, val = 0.0, test = 0.0 }
"""
GOOD = {
    "record": "static_bench x.pcap --duration 0.02",
    "stream": f"static_bench --duration 0.02 --no-keep-up {NO_PORTS}",
    "replay": f"{{inputs}}/bench.pcap --speed 1000 {NO_PORTS}",
    "decode": "{inputs}/bench.pcap",
    "verify": "{inputs}/bench.pcap",
    "scenes": "",
    "schema": "",
    "plan": "static_bench --set duration_s=0.02 --repeats 1",
    "doctor": "",
    "cache": "",
    "truth": "static_bench t --duration 0.02",
    "points": "static_bench x.npz --duration 0.02",
    "bag": "{inputs}/bench.pcap x.bag",
    "picture": "static_bench x.png --duration 0.2 --size 64x64 --view sweep",
    "images": f"static_bench images --duration 0.02 {SMALL}",
    "view": "static_bench --port 0",
    "dataset": "spec.toml out --workers 0",
    "score": "{inputs}/truth --trajectory {inputs}/truth/trajectory.tum",
    "compare": "{inputs}/bench.pcap {inputs}/bench.pcap",
    "fit": "{inputs}/bench.pcap",
    "forest": "static_bench",
    "accuracy": "static_bench --pulses 128",
    "plot": "{inputs}/forest.json x.svg",
}
"""Arguments of a short run of each verb."""
PLAIN = {
    "schema",
    "view",
    "fit",
    "plot",
}  # these print a schema, an address, tables of TOML, and a file's name
OF_MACHINE = {"doctor"}  # its exit code says whether the machine is fit


WITH_PATHS = {
    "SCENE",
    "SCENE|FILE.pcap",
    "OUT",
    "--gps-out",
    "--imu-out",
    "--gps-in",
    "--pose-in",
    "--scheduler",
    "--truth-folder",
}
"""Texts that may be the path of a file, a device or a folder."""
NO_PATHS = {
    "--to": "a host",
    "--http": "a host and a port",
    "--host": "a host",
    "--interface": "a network interface",
    "--for": "a SLAM program",
    "--set": "settings of the scene, whose files are read alone",
    "--unit": "a sensor of a capture",
    "--labels": "a scheme of labels",
    "--mount": "a pose",
    "--drift": "a drift",
    "--colour": "a layer of points",
    "--size": "a size",
    "--require": "a score and its limit",
}
"""Texts that are no path."""
HOSTS = {
    ("stream", "--to"): "{host}",
    ("replay", "--to"): "{host}",
    ("stream", "--http"): "{host}:0",
    ("stream", "--pose-in"): "udp://{host}:0",
    ("stream", "--imu-out"): "udp://{host}:9",
    ("stream", "--gps-out"): "socket://{host}:9",
    ("stream", "--gps-in"): "socket://{host}:9",
    ("view", "--host"): "{host}",
    ("dataset", "--scheduler"): "tcp://{host}:9",
}
"""Options that name a host, each with a value."""
FILES_OUT = {"OUT", "OUT.png", "--out", "--pcap", "--plot", "--save", "--prepare-to"}
FILES_OUT |= {("forest", name) for name in ("--inventory", "--stems", "--ground", "--glb")}
"""Files that a run writes: an earlier file of that name is replaced by a whole new one, or not at all."""
ENDINGS = {
    ("record", "OUT"): ".pcap",
    ("points", "OUT"): ".ply",
    ("bag", "OUT"): ".mcap",
    ("plot", "OUT"): ".svg",
    ("decode", "--out"): ".csv",
    ("score", "--out"): ".html",
    "--plot": ".svg",
}
"""Endings of outputs whose name does not show them."""
BESIDE = {
    "--pose-in": "--set motion={kind='live'}",
    "--flown": "--set motion={kind='live'} --pose-in udp://127.0.0.1:0",
    "--imu-out": "--set imu.preset=consumer",
    "--gps-out": "--set gps.connected=true",
    "--http-settings": "--http 127.0.0.1:0",
    "--save": "--set motion={kind='walk',path_m=[[-2.0,0.0],[2.0,0.0]]}",
}
"""Words without which an option is refused before its path is looked at."""
NEVER_ENDING = {"--flown", "--save"}
"""Options of runs that have no end of their own."""
REFUSED = {("bag", "OUT"), ("dataset", "OUT"), ("images", "OUT")}
"""Outputs that must be new."""
INSTEAD = {"--scheduler": ("--workers", "0")}
"""Words beside which an option is refused."""
MINE = b"mine, and of no run\n"


def texts_of(verb):
    """Arguments and options of a verb that take a text other than a number or one of some words."""
    return [
        leaf
        for leaf in options_of_function(door(verb, "verbs"))
        if leaf.kind not in (bool, int, float) and not leaf.option.words
    ]


def is_path(leaf):
    """Whether an argument or option may be a path."""
    return issubclass(leaf.kind, Path) or leaf.name in WITH_PATHS


def names_host(leaf):
    """Whether an option is declared to name a host."""
    metavar = leaf.option.metavar or ""
    return "HOST" in metavar or metavar == "ADDRESS"


def paths_of(verb):
    """Names of arguments and options that take a path, each with its index among the arguments."""
    at = -1
    for leaf in options_of_function(door(verb, "verbs")):
        at += not leaf.name.startswith("-")
        if is_path(leaf):
            yield leaf.name, at


CASES = [(verb, name, at) for verb in sorted(GOOD) for name, at in paths_of(verb)]


def ending_of(verb, name):
    """Ending of the file that an argument or option names; empty for a folder."""
    leaf = next(leaf for leaf in texts_of(verb) if leaf.name == name)
    shown = (name, (leaf.option.metavar or "").partition("|")[0])
    shown_endings = (Path(text).suffix for text in shown)
    return ENDINGS.get((verb, name)) or ENDINGS.get(name) or next(filter(None, shown_endings), "")


def with_path(words, name, at, path):
    """Words of a command with a value of its option, or of its argument of this index."""
    if name.startswith("-"):
        words = [word for word in words if word not in INSTEAD.get(name, ())]
        return [*words, *BESIDE.get(name, "").split(), name, str(path)]
    places = [
        i for i, word in enumerate(words) if not word.startswith("--") and not words[i - 1].startswith("--")
    ]
    place = places[at + 1]  # after the verb
    return [*words[:place], str(path), *words[place + 1 :]]


INPUT_AS_OUTPUT = [case for case in CASES if case[1] in FILES_OUT or case[:2] in FILES_OUT]

WAITING_OUT = [
    *INPUT_AS_OUTPUT,
    ("stream", "--flown", None),
    ("stream", "--truth", None),
    ("truth", "DIR", 1),
]
"""Outputs, also folders, which a pipe is not."""
