"""A run straight into a bag, with what is true of its motion."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np

from vlp16emu.engine import Engine
from vlp16emu.extras.bag.bag_file import BagFile, check_bag
from vlp16emu.extras.bag.messages import TrueMessages
from vlp16emu.extras.bag.sink import BagSink, TrueSamples, frames_of
from vlp16emu.extras.slam import Rig, write_beside
from vlp16emu.extras.truth.truth import Samples, attitude_of, rig_of, true_motion
from vlp16emu.motion.imu import Inertial
from vlp16emu.motion.pose import Kinematics
from vlp16emu.packets import Clock, PacketClock
from vlp16emu.run.options import BagOptions
from vlp16emu.types import PpsState
from vlp16emu.units import S_NS


@contextmanager
def bag_of_run(path: Path, engine: Engine, rate_hz: int, options: BagOptions | None = None) -> Iterator[list[BagSink]]:
    """Open a bag for the packets of a run and its truth, with poses at a rate; errors as of `BagFile` and `write_beside`."""
    check_bag(path)
    wanted, scenario, write = options or BagOptions(), engine.scenario, None
    if wanted.slam is not None:
        tree = scenario.model_dump(mode="json", by_alias=True, exclude_none=True)
        frame = frames_of(len(engine.parts.units))[0]
        write = write_beside(path, wanted.slam, Rig.of(rig_of(scenario, engine.parts), tree, frame))

    def clock_of(number: int, due_ns: int) -> PacketClock:
        is_locked = engine.parts.units[number].gps.pps_at(due_ns) is PpsState.LOCKED
        return PacketClock(Clock.SENSOR if is_locked else Clock.HOST)

    with BagSink(path, len(engine.parts.units), clock_of, partial(_truth, engine, rate_hz, wanted.tf)) as sink:
        yield [sink]
    if write:
        write()


def _truth(
    engine: Engine, rate_hz: int, tf: str, bag: BagFile, frames: Sequence[str], begin_ns: int
) -> list[tuple[TrueSamples, int]]:
    scenario, parts = engine.scenario, engine.parts
    imu = scenario.imu
    sections = imu.model_dump() if imu else None, scenario.gps.model_dump()
    to = TrueMessages(bag, rig_of(scenario, parts), frames, *sections, tf)
    to.fixed(begin_ns)
    at = scenario.start_ns, rate_hz
    poses = Samples(partial(_odometry, to), partial(true_motion, parts.units[0].motion, *at), *at, begin_ns)
    found: list[tuple[TrueSamples, int]] = [(poses, -(-S_NS // rate_hz))]
    if imu is not None and parts.imu is not None:
        readings = Samples(partial(_inertial, to), parts.imu.read, scenario.start_ns, imu.rate_hz, begin_ns)
        found.append((readings, 0))
    if (named_ns := parts.gps.second_ns(begin_ns)) is not None:
        fixes = partial(_fixes, to, engine)
        seconds = Samples(fixes, lambda first, count: range(first, first + count), 0, 1, max(named_ns, begin_ns))
        found.append((seconds, 0))
    return found


def _odometry(to: TrueMessages, true: Kinematics) -> None:
    from scipy.spatial.transform import Rotation

    quaternion = Rotation.from_matrix(true.world_R_body).as_quat(canonical=True)
    own_m_s = np.einsum("nji,nj->ni", true.world_R_body, true.world_v_body_m_s)
    numbers = np.column_stack([true.world_p_body_m, quaternion, own_m_s, true.body_w_rad_s]).tolist()
    for sample in zip(true.t_ns.tolist(), numbers, strict=True):
        to.odometry(*sample)


def _inertial(to: TrueMessages, read: Inertial) -> None:
    rates = np.column_stack([read.angular_rate_rad_s, read.specific_force_m_s2, *attitude_of(read)]).tolist()
    stamps_ns = read.t_ns if read.stamp_ns is None else read.stamp_ns
    for sample in zip(stamps_ns.tolist(), rates, strict=True):
        to.inertial(*sample)


def _fixes(to: TrueMessages, engine: Engine, seconds: range) -> None:
    for second in seconds:
        said = engine.receiver.fix(second * S_NS)
        to.fix(second * S_NS, (said.latitude_deg, said.longitude_deg, said.valid))
