"""All verbs together, and the one place where errors become lines and exit codes."""

import gc
import io
import logging
import os
import signal
import sys
from collections.abc import Callable, Sequence
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from vlp16emu.cli.accuracy import accuracy
from vlp16emu.cli.bag import bag
from vlp16emu.cli.cache import cache
from vlp16emu.cli.compare import compare, fit
from vlp16emu.cli.dataset import dataset
from vlp16emu.cli.decode import decode
from vlp16emu.cli.doctor import doctor
from vlp16emu.cli.forest import forest
from vlp16emu.cli.images import images
from vlp16emu.cli.picture import picture
from vlp16emu.cli.plan import plan
from vlp16emu.cli.points import points
from vlp16emu.cli.record import record
from vlp16emu.cli.replay import replay
from vlp16emu.cli.scenes import scenes, schema
from vlp16emu.cli.score import score
from vlp16emu.cli.stream import stream
from vlp16emu.cli.terminal import ENDINGS, INTERRUPTED
from vlp16emu.cli.truth import truth
from vlp16emu.cli.verify import verify
from vlp16emu.cli.view import view
from vlp16emu.doors import door, has_door
from vlp16emu.errors import Vlp16emuError

_EXAMPLES: dict[Callable[..., None], tuple[str, ...]] = {
    record: (
        "birch_walk walk.pcap --duration 10",
        "birch_walk dual.pcap --set sensor.return_mode=dual --set seed=7",
        "my_forest.toml walk.pcap --json > walk.json",
    ),
    stream: (
        "birch_walk",
        "static_bench --to 192.168.1.10 --duration 3600",
        "birch_walk --to 192.168.1.255 --as-sensor",
    ),
    replay: ("walk.pcap", "field_day.pcap --loop --now --to 192.168.1.10"),
    decode: ("walk.pcap", "walk.pcap --out walk.ply"),
    bag: ("walk.pcap walk.mcap --truth truth", "field_day.pcap field_day.bag"),
    points: (
        "birch_walk walk.ply --duration 5 --truth",
        "walk.pcap walk.laz --trajectory truth",
        "birch_walk walk.npz --set sensor.return_mode=dual",
        "static_bench bench.csv --set sensor.model=free --set sensor.beams=64",
    ),
    images: ("birch_walk views --duration 5", "birch_walk views --kind pinhole --size 1280x720 --fov 75 --every 0.1"),
    picture: (
        "birch_walk walk.png --duration 20",
        "reference_forest walk.gif --duration 10 --colour species",
        "walk.pcap walk.png --trajectory truth",
    ),
    view: ("birch_walk", "my_forest.toml --save my_path.toml", "field_day.pcap"),
    truth: ("birch_walk truth --duration 60", "birch_walk truth --truth-rate 1000 --set imu.preset=consumer"),
    dataset: ("bench_set.toml bench_set", "bench_set.toml bench_set --workers 0"),
    score: (
        'truth --trajectory estimate.tum --align se3 --out report --require "ate_m<0.3"',
        "truth --stems stems.csv --inventory trees.csv --truth-points labelled.npz",
    ),
    verify: ("walk.pcap", "walk.pcap --json"),
    compare: ("walk.pcap field_day.pcap", "walk.pcap field_day.pcap --picture units.png --json"),
    fit: ("field_day.pcap --out unit.toml",),
    forest: (
        "birch_walk",
        "old_growth --picture old_growth.png --inventory trees.csv",
        "my_forest.toml --radius 15 --ground ground.asc --glb twin.glb",
    ),
    accuracy: ("birch_walk", "reference_forest --out report --pulses 20000", "static_bench --json"),
    plan: ("birch_walk", "old_growth --set sensor.return_mode=dual", "reference_forest --ideal --json"),
    doctor: ("", "--json"),
    cache: ("", "--clear"),
    scenes: (),
    schema: ("> scene.schema.json",),
}
"""What follows the verb in the examples of its help."""


class _Verbs(TyperGroup):
    """Our verbs, and those that other packages add; these are looked for where a verb is not ours."""

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        command = super().get_command(ctx, cmd_name)
        if command is None and has_door(cmd_name, "verbs"):
            own = typer.Typer(add_completion=False, rich_markup_mode=None)
            own.command(cmd_name)(door(cmd_name, "verbs"))
            command = typer.main.get_command(own)
        return command


app = typer.Typer(
    cls=_Verbs,
    add_completion=False,
    rich_markup_mode=None,  # plain text reads well in every terminal, file and pipe
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
for verb, examples in _EXAMPLES.items():
    lines = "\n".join(f"  vlp16emu {verb.__name__} {words}".rstrip() for words in examples)
    app.command(epilog=f"Examples:\n\n\b\n{lines}" if examples else None)(verb)


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    *,
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    """Emulate a Velodyne VLP-16 that walks through forests of its own growing.

    Every packet is byte for byte what the sensor would have sent: into a pcap file with `record`, over
    UDP in real time with `stream`.
    """
    if version:
        from importlib.metadata import version as version_of

        print(f"vlp16emu {version_of('vlp16emu')}")
    elif context.invoked_subcommand is None:
        print(context.get_help())


def run(arguments: Sequence[str]) -> int:
    """Carry out one command line.

    Returns
    -------
    Exit code: 0 done, 1 failed while running or rules broken, 2 bad input, 130 interrupted
    """
    try:
        return app(arguments, prog_name="vlp16emu", standalone_mode=False) or 0
    except Vlp16emuError as error:
        _complain(str(error))
        return error.exit_code
    except typer.TyperException as error:  # the command line itself is wrong
        context = getattr(error, "ctx", None)
        message = error.format_message().rstrip(".")
        _complain(f"{message}; see `{context.command_path if context else 'vlp16emu'} --help`")
        return 2
    except MemoryError as error:
        _complain(f"out of memory: {error}" if str(error) else "out of memory")
        return 1
    except KeyboardInterrupt:
        return INTERRUPTED


def main() -> None:
    """Carry out the command line of this process and exit."""
    # What runs side by side is threads of ours: those of OpenBLAS, for products of a few rows, wait in a loop.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.set_threshold(500_000)  # libraries bring 300 000 objects, none of them garbage
    logging.basicConfig(format="warning: %(message)s")
    for number in ENDINGS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _interrupt)
    for output in (sys.stdout, sys.stderr):
        if isinstance(output, io.TextIOWrapper):  # names of files may hold what a terminal cannot show
            output.reconfigure(errors="backslashreplace")
    code = None
    try:
        code = run(sys.argv[1:])
        gc.freeze()  # Python need not look through all of it at the end
        print(end="", flush=True)
    except BrokenPipeError:  # whoever read our output has had enough
        _drop_output()
    except OSError as error:
        if error.filename is not None or error.errno is None:  # files are looked after where they are written
            raise
        _drop_output()
        if not code:  # else the reason has been printed
            _complain(f"standard output: {error.strerror}")
            code = 1
    if code == INTERRUPTED:
        os._exit(code)  # Python would wait for threads that grow and cast what nobody wants any more
    sys.exit(1 if code is None else code)


def _interrupt(_signal: int, _frame: object) -> None:
    """End the command; the next signal ends the process at once."""
    for number in ENDINGS:
        signal.signal(number, lambda *_: os._exit(INTERRUPTED))
    raise KeyboardInterrupt


def _drop_output() -> None:
    """Send what is left of our output nowhere: Python would try to write it at exit, and complain."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _complain(message: str) -> None:
    if sys.stderr is not None:  # else nobody listens
        print(f"error: {' '.join(message.splitlines())}", file=sys.stderr)
