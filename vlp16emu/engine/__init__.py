"""Set-up and run of a scenario: units, blocks, windows, timeline, merge."""

from vlp16emu.engine.build import Parts, Unit, assemble, beam_of, in_one_world, mounts_of
from vlp16emu.engine.engine import Engine, Job, scan
from vlp16emu.engine.gps_input import GpsInput
from vlp16emu.engine.state import SensorState
from vlp16emu.engine.timeline import Stretch, Timeline
from vlp16emu.engine.windows import Batching, window_of, workers
