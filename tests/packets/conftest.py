"""Real captures, where they are at hand."""

import dpkt
import numpy as np
import pytest
from kit import real_capture


def _payloads(length):
    with real_capture("mrpt_vlp16_gps.pcap").open("rb") as file:
        return [(stamp, frame[42:]) for stamp, frame in dpkt.pcap.Reader(file) if len(frame) == 42 + length]


@pytest.fixture
def real_single():
    """293 data packets of a real unit: strongest return, 600 rpm, locked to GPS."""
    return np.frombuffer(b"".join(payload for _, payload in _payloads(1206)), np.uint8).reshape(-1, 1206)


@pytest.fixture
def real_dual():
    """603 data packets of another real unit: dual return, 600 rpm, no GPS."""
    return np.fromfile(real_capture("nebula_vlp16_dual.bin"), np.uint8).reshape(-1, 1206)


@pytest.fixture
def real_position():
    """57 position packets of the first unit, each with its arrival in seconds."""
    return _payloads(512)
