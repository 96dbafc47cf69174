"""Reading of VLP-16 captures: datagrams, the sensors that sent them, clocks, and tables of data packets."""

from vlp16emu.captures.arrivals import arrivals_of
from vlp16emu.captures.capture import Capture
from vlp16emu.captures.clock import UnitClock, packet_clock, unit_clocks
from vlp16emu.captures.datagrams import table_of
from vlp16emu.captures.reading import CaptureReader
from vlp16emu.captures.survey import Survey, chosen_unit, units_in
from vlp16emu.captures.units import by_unit
