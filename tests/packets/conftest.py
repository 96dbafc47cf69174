"""Real captures, where they are at hand."""

import dpkt
import numpy as np
import pytest
from kit import real_capture


def _payloads(length, name="mrpt_vlp16_gps.pcap"):
    with real_capture(name).open("rb") as file:
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


@pytest.fixture
def real_hdl_32e():
    """500 data packets of a real HDL-32E: strongest return, 542 rpm."""
    payloads = _payloads(1206, "mrpt_hdl32e.pcap")
    return np.frombuffer(b"".join(payload for _, payload in payloads), np.uint8).reshape(-1, 1206)


@pytest.fixture
def real_vlp_32c():
    """379 data packets of a real VLP-32C: strongest return, 600 rpm, parts of five scans."""
    return np.fromfile(real_capture("nebula_vlp32c.bin"), np.uint8).reshape(-1, 1206)


@pytest.fixture
def real_vls_128():
    """2193 data packets of a real VLS-128: strongest return, 600 rpm."""
    return np.fromfile(real_capture("nebula_vls128.bin"), np.uint8).reshape(-1, 1206)
