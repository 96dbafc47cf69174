"""The byte tables, and a slow decoder that knows nothing but them."""

import struct
import tomllib
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
PROTOCOL = REPOSITORY / "protocol"
STRUCT_CODES = {"u1": "<B", "u2": "<H", "u4": "<I", "i2": "<h"}


def load(name):
    return tomllib.loads((PROTOCOL / name).read_text(encoding="utf-8"))


MODELS = {
    path.stem: load(path.relative_to(PROTOCOL)) for path in sorted((PROTOCOL / "models").glob("*.toml"))
}


class Oracle:
    """Decodes a data payload with the standard library, from data_packet.toml and models/ alone."""

    def __init__(self):
        self.data, self.timing = load("data_packet.toml"), load("timing.toml")
        self.models = MODELS

    def row(self, table, name):
        """One row of data_packet.toml."""
        return next(row for row in self.data[table] if row["name"] == name)

    def field(self, table, name, payload, base=0):
        """Code of a field whose table starts at `base`."""
        row = self.row(table, name)
        return struct.unpack_from(STRUCT_CODES[row["type"]], payload, base + row["offset"])[0]

    def array(self, table, name, base=0):
        """Offsets of the elements of a repeated field."""
        row = self.row(table, name)
        return [base + row["offset"] + i * row["size_bytes"] for i in range(row["count"])]

    def meaning(self, table, name, code):
        """First name of a code; a VLP-16 and a Puck LITE share theirs."""
        return next(key for key, value in self.row(table, name)["values"].items() if value == code)

    def code(self, name, meaning):
        """Code of a factory byte."""
        return self.row("payload", name)["values"][meaning]

    def records(self, payload):
        """All records of the blocks that are used, as dictionaries, in the order of the payload."""
        mode = self.meaning("payload", "return_mode", self.field("payload", "return_mode", payload))
        name = self.meaning("payload", "factory", self.field("payload", "factory", payload))
        packet, firing = self.models[name]["packet"], self.models[name]["firing"]
        lasers = len(firing["slots"]) * firing["lasers_per_slot"]
        banks, copies = len(packet["flags"]), 2 if mode == "dual" else 1
        per_reading = 32 * banks // lasers
        start_ns = self.field("payload", "timestamp", payload) * 1000 - packet["stamp_after_first_ns"]
        hour_ns = self.timing["packet"]["timestamp"]["hour_us"] * 1000
        rows = []
        for b, block in enumerate(self.array("payload", "blocks")):
            reading, place = divmod(b, banks * copies)
            if reading >= 12 // (banks * copies):
                continue
            for r, record in enumerate(self.array("block", "records", block)):
                sequence, laser = divmod(32 * (place // copies) + r, lasers)
                slot = firing["slots"][laser // firing["lasers_per_slot"]]
                code = self.field("record", "distance", payload, record)
                sequences = reading * per_reading + sequence
                time_ns = start_ns + sequences * firing["sequence_ns"] + slot * firing["slot_ns"]
                rows.append(
                    {
                        "block": b,
                        "flag": self.field("block", "flag", payload, block),
                        "bank": place // copies,
                        "sequence": sequences,
                        "laser": laser,
                        "return": self.data["returns"][mode][b % len(self.data["returns"][mode])],
                        "azimuth_deg": self.field("block", "azimuth", payload, block)
                        * self.row("block", "azimuth")["scale"],
                        "time_ns": time_ns % hour_ns,
                        "distance_m": code * packet["distance_mm"] / 1000,
                        "distance_code": code,
                        "reflectivity": self.field("record", "reflectivity", payload, record),
                        "elevation_deg": self.models[name]["beams"]["elevation_deg"][laser],
                    }
                )
        return rows


@pytest.fixture(scope="session")
def models():
    """The tables of models by name."""
    return MODELS


@pytest.fixture(scope="session")
def protocol():
    return PROTOCOL


@pytest.fixture(scope="session")
def data_packet():
    return load("data_packet.toml")


@pytest.fixture(scope="session")
def position_packet():
    return load("position_packet.toml")


@pytest.fixture(scope="session")
def imu_frame():
    """Table of the inertial frame."""
    return load("imu_frame.toml")


@pytest.fixture(scope="session")
def timing():
    return load("timing.toml")


@pytest.fixture(scope="session")
def oracle():
    return Oracle()
