"""Free ports, for streams whose receivers accept any port: several tests or programs on one machine."""

import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from itertools import count, islice

from vlp16emu.errors import OutputError
from vlp16emu.hosts import LOOPBACK

_FREE = range(20_000, 32_768)
"""Range of the free ports: below the ephemeral ports, which begin at 32768 on Linux
(net.ipv4.ip_local_port_range, ip(7)) and at 49152 elsewhere (RFC 6335, section 6)."""
_offered = count(os.getpid() * 61)
"""Index in `_FREE` at which the next search begins: it differs between processes, so that searches are
short."""


@contextmanager
def free_ports(number: int) -> Iterator[list[int]]:
    """Find UDP ports without a bound socket on this machine, and reserve them.

    Receivers bind them later.

    A TCP socket of the same number is the reservation: a receiver can bind the UDP port, and no other search
    finds it.

    Raises OutputError if there are too few.
    """
    with ExitStack() as held:
        ports = list[int]()
        for port in islice((_FREE[place % len(_FREE)] for place in _offered), len(_FREE)):
            if len(ports) == number:
                break
            with ExitStack() as tried, suppress(OSError):
                tried.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM)).bind((LOOPBACK, port))
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                    probe.bind(("", port))
                held.push(tried.pop_all())
                ports.append(port)
        if len(ports) < number:
            raise OutputError("ports", f"{len(ports)} free ones", f"{number} from {_FREE[0]} to {_FREE[-1]}")
        yield ports
