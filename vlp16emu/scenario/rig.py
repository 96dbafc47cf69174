"""The `[[rig]]` tables: further sensors on the same carrier."""

from ipaddress import IPv4Address
from typing import Any

from vlp16emu.motion import Mount
from vlp16emu.sensor.settings import Sensor
from vlp16emu.settings import Seed, merged

_OWN = frozenset({"name", "serial_number", "address", "data_port", "position_port", "seed"})
"""Keys that no two units have in common, so they are not taken from `[sensor]`."""


class RigUnit(Sensor):
    """A sensor beside that of `[sensor]`, whose keys hold here too unless others are given.

    Name, serial number, address and ports count on from those of `[sensor]`; a preset of its own takes the place of that one's.
    """

    mount: Mount = Mount()
    """Mount on the carrier of `[motion]`, whose own `mount` is that of `[sensor]`."""
    seed: Seed | None = None
    """Seed of its errors and all else that is random in it; from that of `[sensor]` if not set."""


def completed(table: Any, first: Sensor, place: int) -> Any:
    """Return the table of a unit with the keys that it takes from the first one.

    Parameters
    ----------
    table : as the user wrote it; what is no table is left to the check of its type
    first : `[sensor]`
    place : number of the table, from 1
    """
    if not isinstance(table, dict):
        return table
    not_taken = _OWN | (Sensor.either_or if Sensor.either_or & table.keys() else frozenset())
    if "preset" in table:  # in place of all that a preset of the first one gives
        not_taken |= {key for values in Sensor.presets.values() for key in values}
    given = first.model_dump(exclude_unset=True, exclude=set(not_taken))
    counted = {
        "name": f"unit_{place + 1}",
        "serial_number": str(int(first.serial_number) + place).zfill(len(first.serial_number)),
        "address": str(IPv4Address(first.address) + place),
        "data_port": first.data_port + place,
        "position_port": first.position_port + place,
    }
    return merged(counted | given, table)
