"""Traffic of a sensor that does everything right, made here field by field, to be damaged by the tests."""

import functools
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from vlp16emu.extras.verify.run import verify
from vlp16emu.packets.frames import FACTORY_LINK, data_header, position_frame
from vlp16emu.packets.layout import DATA_PAYLOAD

START_US = 1_795_255_199_000_000  # one second before a full hour of UTC
DATA_PERIOD_NS = {False: 1_327_104, True: 663_552}
POSITION_PERIOD_US = 6_860
HEADER = data_header(FACTORY_LINK)


@dataclass
class Traffic:
    """Stamps in us and frames, in order; damaged in place. Frame i is number i + 1 of the capture."""

    stamps_us: list[int]
    frames: list[bytearray]
    folder: Path

    def data(self, k=slice(None)):
        """Index of the k-th data frame, or of all."""
        return [i for i, frame in enumerate(self.frames) if len(frame) == 1248][k]

    def position(self, k=slice(None)):
        """Index of the k-th position frame, or of all."""
        return [i for i, frame in enumerate(self.frames) if len(frame) == 554][k]

    def payload(self, i):
        """Payload of data frame i as fields that can be written."""
        return np.frombuffer(memoryview(self.frames[i])[42:], DATA_PAYLOAD)

    def write_position(self, i, offset, content):
        """Overwrite bytes of a position payload and bring its checksum up to date."""
        payload = bytearray(self.frames[i][42:])
        payload[offset : offset + len(content)] = content
        self.frames[i][:] = position_frame(
            FACTORY_LINK, bytes(payload), int.from_bytes(self.frames[i][18:20])
        )

    @staticmethod
    def sentence(second):
        """Give the sentence of a second past START_US, with its checksum."""
        past_day = START_US // 1_000_000 % 86_400 + second
        time = f"{past_day // 3600:02d}{past_day // 60 % 60:02d}{past_day % 60:02d}"
        body = f"GPRMC,{time}.00,A,6214.4000000,N,02545.0000000,E,1.100,90.0,211126,0.0,E,A"
        checksum = 0
        for character in body.encode():
            checksum ^= character
        return f"${body}*{checksum:02X}\r\n".encode()

    def drop(self, indices):
        for i in sorted(indices, reverse=True):
            del self.frames[i], self.stamps_us[i]

    def save(self, path):
        out = [bytes.fromhex("d4c3b2a1020004000000000000000000ffff000001000000")]
        for stamp_us, frame in zip(self.stamps_us, self.frames, strict=True):
            seconds, rest_us = divmod(stamp_us, 1_000_000)
            out.append(struct.pack("<IIII", seconds, rest_us, len(frame), len(frame)) + frame)
        path.write_bytes(b"".join(out))
        return path

    def verified(self, **how):
        return verify(self.save(self.folder / "made.pcap"), **how)


def data_frames(seconds, rpm, *, dual):
    """Give stamps and frames of data packets, with noise on the azimuth as on real units."""
    random = np.random.default_rng(3)
    period_ns = DATA_PERIOD_NS[dual]
    count = int(seconds * 1e9 // period_ns)
    payload = np.zeros(count, DATA_PAYLOAD)
    blocks = 6 if dual else 12
    turned_cdeg = rpm * 600 * 110.592e-6 * np.arange(count * blocks) + 30_000
    read_cdeg = np.floor(turned_cdeg + random.normal(0, 0.5, len(turned_cdeg))).astype(int) % 36_000
    payload["blocks"]["flag"] = 0xEEFF
    payload["blocks"]["azimuth_cdeg"] = np.repeat(read_cdeg.reshape(count, blocks), 2 if dual else 1, axis=1)
    distance_lsb = random.integers(250, 50_000, (count, 12, 2, 16))
    distance_lsb[random.random(distance_lsb.shape) < 0.3] = 0
    reflectivity = random.integers(0, 256, distance_lsb.shape)
    if dual:
        reflectivity[:, 1::2] = reflectivity[:, ::2]
        distance_lsb[:, 1::2] = distance_lsb[:, ::2]
        distance_lsb[:, 1::2, 0, 3] //= 2
        distance_lsb[distance_lsb < 250] = 0
    payload["blocks"]["records"]["distance_lsb"] = distance_lsb.reshape(count, 12, 32)
    payload["blocks"]["records"]["reflectivity"] = reflectivity.reshape(count, 12, 32)
    since_us = np.arange(count) * period_ns // 1000
    payload["timestamp_us"] = (START_US + since_us) % 3_600_000_000
    payload["return_mode"], payload["factory"] = 0x39 if dual else 0x37, 0x22
    stamps_us = START_US + since_us + period_ns // 1000
    return [(int(t), HEADER + p.tobytes()) for t, p in zip(stamps_us, payload, strict=True)]


def position_frames(seconds):
    """Give stamps and frames of position packets, locked; a sentence comes 0.4 s after its second."""
    frames = []
    for number, since_us in enumerate(range(2_000, int(seconds * 1e6), POSITION_PERIOD_US)):
        payload = bytearray(512)
        payload[198:203] = struct.pack("<IB", (START_US + since_us) % 3_600_000_000, 2)
        text = Traffic.sentence((since_us - 400_000) // 1_000_000)
        payload[206 : 206 + len(text)] = text
        frames.append(
            (START_US + since_us + 350, position_frame(FACTORY_LINK, bytes(payload), 65_500 + number))
        )
    return frames


@functools.cache
def clean(seconds, rpm, *, dual):
    """Merge both streams; kept, because making frames is slower than checking them."""
    return sorted(data_frames(seconds, rpm, dual=dual) + position_frames(seconds), key=lambda pair: pair[0])


@pytest.fixture
def traffic(tmp_path):
    def make(seconds=2.2, rpm=600, *, dual=False):
        pairs = clean(seconds, rpm, dual=dual)
        return Traffic(
            [stamp_us for stamp_us, _ in pairs], [bytearray(frame) for _, frame in pairs], tmp_path
        )

    return make
