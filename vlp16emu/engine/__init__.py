"""Set-up and run of a scenario: units, blocks, windows, timeline, merge."""

from vlp16emu.engine.build import (
    GpsInput,
    Parts,
    Unit,
    assemble,
    beam_of,
    clock_at,
    in_one_world,
    in_phase_deg,
    mounts_of,
)
from vlp16emu.engine.engine import Engine, Job, scan
from vlp16emu.engine.timeline import Stretch, Timeline
from vlp16emu.engine.windows import Batching, window_of, workers
