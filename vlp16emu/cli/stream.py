"""`vlp16emu stream` and `vlp16emu replay`: packets over UDP, in real time."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vlp16emu.cli.arguments import AsJson, CaptureFile, RunOptions, SceneName
from vlp16emu.cli.printer import finish, print_line
from vlp16emu.cli.terminal import Progress, make_emulator, stop_on_ctrl_c
from vlp16emu.errors import InputError, RunError
from vlp16emu.hosts import LAST_PORT, url_of
from vlp16emu.libraries import check_extra
from vlp16emu.run.options import Http, Option, ReplayOptions, StreamOptions, TruthTo
from vlp16emu.run.part import StreamPart
from vlp16emu.units import S_NS

if TYPE_CHECKING:
    from vlp16emu.extras.replay import Replayed
    from vlp16emu.extras.viewer.live import LivePage
    from vlp16emu.packets import Link
    from vlp16emu.run.emulator import Emulator
    from vlp16emu.run.report import Streamed
    from vlp16emu.types import Packet

_LATE = 1  # exit code of a strict stream that was late

Strict = Annotated[bool, Option("Exit with 1 if packets were late by more than 50 ms, or were skipped.")]

KeepUp = Annotated[
    bool | None,
    Option(
        "Before the first packet, measure this machine for some seconds, and use the best beam and reach "
        "that leave a fifth of its time free; a line names them. On by default at a terminal, except for "
        "live poses or a prepared run.",
        name="--keep-up/--no-keep-up",
    ),
]


def stream(
    scene: SceneName,
    options: StreamOptions,
    emulator_options: RunOptions,
    *,
    prepare: Annotated[
        bool,
        Option(
            "Compute the whole run into a temporary file before the first packet is sent; then the "
            "engine cannot be too slow. It needs 3.4 GB for an hour of single return."
        ),
    ] = False,
    view: Annotated[
        bool,
        Option(
            "Show the last sweeps, the state of the stream and the settings of the sensor in the "
            "browser. A process of lower priority serves this page, and no packet waits for it. Needs "
            "the extra 'viewer'."
        ),
    ] = False,
    view_port: Annotated[
        int | None, Option("Port of this page instead of 8016, 0 for any free one.", "N", ge=0, le=LAST_PORT)
    ] = None,
    keep_up: KeepUp = None,
    strict: Strict = False,
    as_json: AsJson = False,
) -> None:
    """Stream a scene over UDP, each packet at its time.

    Nothing leaves this machine unless --to names another one. Packets are computed ahead; all deadlines count
    from the first packet. If the engine falls behind, a line says so at once, with settings that would keep
    up. Ctrl-C ends the stream.
    """
    title = f"{scene} to {options.receiver[0]}"
    emulator = make_emulator(scene, emulator_options)
    from vlp16emu.run.scene_stream import SceneStream  # here: numba loads after mistakes in the scene show

    is_prepared = prepare or options.prepare is not None
    is_live = emulator.scenario.motion.takes_poses
    if is_live and (options.poses is None or options.poses.where is None):
        raise InputError("--pose-in", 'found motion.kind = "live" without it', "udp://127.0.0.1:PORT")
    if view_port is not None and not view:
        raise InputError("--view-port", "found without --view", "both")
    is_fitted = _fits_to_machine(keep_up=keep_up, is_prepared=is_prepared, is_live=is_live)
    _, stop_s = emulator.scenario.span_s(0.0, options.duration_s)
    with ExitStack() as stack:
        page = stack.enter_context(_page(emulator, view_port, quiet=as_json)) if view else None
        stop = stack.enter_context(stop_on_ctrl_c())
        if is_prepared and options.prepare is None:
            options = replace(options, prepare=stack.enter_context(_temporary_packets()))
        if page is not None:
            options = _with_settings(options, is_prepared=is_prepared)
        stream = stack.enter_context(SceneStream(emulator, options, stop=stop))
        progress = stack.enter_context(Progress(stop_s))
        stream.add(Terminal(progress, emulator.scenario.start_ns))
        if is_fitted:
            stream.measure()
        if page is not None:
            page.follow(stream)
        _announce(f"streaming {title}", stream.links, quiet=as_json)
        stream.prepare(partial(progress.show, "preparing"))
        if stream.web and stream.web.places and not as_json:
            places = ", ".join(url_of(host, port) for host, port in stream.web.places)
            print_line(f"web interface at {places}")
        stream.run()
    _finish(stream.result, title, strict=strict, as_json=as_json)


def replay(
    file: CaptureFile, options: ReplayOptions, *, strict: Strict = False, as_json: AsJson = False
) -> None:
    """Send a capture over UDP again, ours or a real sensor's.

    Packets keep the intervals of their capture stamps, or of the sensor's stamps where those of the capture
    cannot be its pace, and go to the ports of the capture. Nothing leaves this machine unless --to names
    another one. Ctrl-C ends it.
    """
    from vlp16emu.extras.replay import ReplayStream

    with (
        stop_on_ctrl_c() as stop,
        ReplayStream(file, options, stop=stop) as stream,
        Progress(0.0, "sending") as progress,
    ):
        stream.add(Terminal(progress))
        units = ", ".join(map(str, stream.replay.units))
        _announce(f"replaying {file} to {stream.host}: sensors {units}", stream.links, quiet=as_json)
        for unit, fault in stream.replay.paced_by.items():
            sensor = stream.replay.units[unit]
            progress.say(f"{sensor}: {fault}: packets are paced by the sensor's own stamps")
        stream.run()
    _finish(stream.result, f"{file} to {stream.host}", strict=strict, as_json=as_json)


class Terminal(StreamPart):
    """The terminal of a stream: its news, and the simulated seconds since `start_ns`, if that is known."""

    def __init__(self, progress: Progress, start_ns: int | None = None) -> None:
        self._progress = progress
        self._start_ns = start_ns

    def sent(self, packet: "Packet") -> None:
        """Show the simulated seconds so far."""
        if self._start_ns is not None:
            self._progress.show("streaming", (packet.due_ns - self._start_ns) / S_NS)

    def news(self, line: str) -> None:
        """Print a line."""
        self._progress.say(line)


def _fits_to_machine(*, keep_up: bool | None, is_prepared: bool, is_live: bool) -> bool:
    """Return True if beam and reach are to be chosen so that this machine keeps up."""
    conflict = None
    if is_prepared:
        conflict = "--prepare"
    elif is_live:
        conflict = "--pose-in"
    if keep_up and conflict:
        raise InputError("--keep-up", f"found beside {conflict}", "only one of the two")
    if keep_up is not None or conflict:
        return bool(keep_up)
    return sys.stderr is not None and sys.stderr.isatty()


@contextmanager
def _page(emulator: "Emulator", port: int | None, *, quiet: bool) -> Iterator["LivePage"]:
    """Start the page of a stream, and print its address; on standard error if `quiet`."""
    check_extra("viewer", "the page in the browser", "viser", "websockets")
    from vlp16emu.extras.viewer.live import PAGE_PORT, live_page

    with live_page(emulator, PAGE_PORT if port is None else port) as page:
        print(f"page at {page.url}", file=sys.stderr if quiet else sys.stdout, flush=True)
        yield page


@contextmanager
def _temporary_packets() -> Iterator[Path]:
    """Yield the name of a file that is removed at the end; the error of a full disk does not name it."""
    from tempfile import TemporaryDirectory

    with TemporaryDirectory(prefix="vlp16emu-") as folder:
        try:
            yield Path(folder) / "prepared.pcap"
        except RunError as error:
            cause = error.__cause__
            if folder not in str(error) or not isinstance(cause, OSError):
                raise
            parent = Path(folder).parent
            advice = "nothing is kept; --prepare-to FILE.pcap takes another place"
            raise RunError(f"--prepare: {cause.strerror} in {parent}; {advice}") from error


def _with_settings(options: StreamOptions, *, is_prepared: bool) -> StreamOptions:
    """Return options with a web interface, by which the page sets the sensor, if packets may change."""
    truth = TruthTo.of(options.truth)
    is_fixed = is_prepared or (truth is not None and (truth.per_packet or truth.per_return))
    if options.http or is_fixed:
        return options
    return replace(options, http=Http("127.0.0.1:0"))


def _announce(title: str, links: "Sequence[Link]", *, quiet: bool) -> None:
    if not quiet:
        ports = "; ".join(f"{link.data_port} and {link.position_port}" for link in links)
        print_line(f"{title}, ports {ports}")


def _finish(report: "Streamed | Replayed", title: str, *, strict: bool, as_json: bool) -> None:
    """Print the report of a stream or a replay and exit with its code."""
    is_late = strict and report.sent.behind  # skipped packets count too
    try:
        finish(report, f"{'interrupted' if report.interrupted else 'done'}: {title}", as_json=as_json)
    finally:
        if is_late:
            raise typer.Exit(_LATE)
