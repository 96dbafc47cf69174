"""Which caster is taken."""

import logging

import vlp16emu.raycast as room
from vlp16emu.raycast.embree import EmbreeCaster
from vlp16emu.raycast.embree_library import EmbreeMissingError, library_path
from vlp16emu.raycast.plain import PlainCaster


def test_the_library_of_the_wheel_is_taken(lab, workers):
    """Where embreex is installed its library is driven directly."""
    assert library_path().is_file()
    assert isinstance(room.caster(lab.soup, workers), EmbreeCaster)


def test_without_the_library_the_plain_class_steps_in(lab, workers, monkeypatch, caplog):
    """A library that cannot be loaded is said once, as a warning, and the plain class is used."""

    def missing():
        raise EmbreeMissingError("libembree4.so: no such file")

    monkeypatch.setattr(room, "library", missing)
    with caplog.at_level(logging.WARNING):
        assert isinstance(room.caster(lab.soup, workers), PlainCaster)
    assert "libembree4.so: no such file" in caplog.text
