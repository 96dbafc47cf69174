"""Options of `vlp16emu stream` for the web interface of the sensor."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

from vlp16emu.cli.arguments import option

if TYPE_CHECKING:
    from vlp16emu.run.options import Http


def _http(text: str) -> tuple[str, int]:
    from vlp16emu.extras.bench.web import parse_http

    return parse_http(text)


HttpAt = Annotated[
    object | None,  # click would take two values for a tuple
    option(
        "--http",
        "Serve the sensor's web interface, which the stream follows; of a rig on this port and those behind it. "
        "PORT alone is on 127.0.0.1.",
        "HOST:PORT",
        _http,
    ),
]
HttpSettings = Annotated[
    Path | None,
    option("--http-settings", "Keep the settings that are saved in the web interface, from run to run.", "FILE"),
]


def served(at: object | None, saved: Path | None, *, quiet: bool) -> "Http | None":
    """Serve web interfaces, and print where they are."""
    from vlp16emu.run.options import Http

    if at is None:
        return None

    def serving(places: Sequence[tuple[str, int]]) -> None:
        if not quiet:
            print("web interface at " + ", ".join(f"http://{host}:{port}/" for host, port in places), flush=True)

    host, port = cast("tuple[str, int]", at)
    return Http(host, port, saved, serving)
