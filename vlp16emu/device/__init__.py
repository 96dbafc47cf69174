"""What is wired to the sensor, set on it or done to it, and its web interface."""

# No more is taken here: scenes are read without the compiler, and they hold events.
from vlp16emu.device.events import AnyEvent, Event, Setting

__all__ = ["AnyEvent", "Event", "Setting"]
