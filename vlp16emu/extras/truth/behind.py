"""What is behind each record of a data packet: the truth, slot by slot."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import matvec
from vlp16emu.engine import Unit
from vlp16emu.extras.truth.slots import NO_ECHO, SLOT
from vlp16emu.packets.data import distance_lsb, odd_column
from vlp16emu.packets.layout import RECORDS_PER_PACKET
from vlp16emu.types import SURFACE, ReturnMode, Returns

_ONLY_COLUMN = {ReturnMode.STRONGEST: 0, ReturnMode.LAST: 1}
_LABELS = ("semantic", "part", "instance", "species")


def slots_of(unit: Unit, returns: Returns, mode: ReturnMode) -> NDArray[np.void]:
    """Return `SLOT` (n, 384) of whole packets, in the order of their records: block by block, and by channel.

    Parameters
    ----------
    returns : with truth, as `pack_data` takes them
    mode : which returns are sent
    """
    shape = returns.distance_m.shape[:2]
    if mode is ReturnMode.DUAL:
        last, odd = np.ones(shape, np.int64), odd_column(returns)
        pairs = [_rows(unit, returns, column) for column in (last, odd)]
        of_last = returns.distance_m[..., 1] == returns.distance_m[..., 0]
        pairs[1]["repeat"] = (odd == 0) & of_last & (pairs[1]["echo"] != NO_ECHO)
        rows = np.stack([pair.reshape(-1, 32) for pair in pairs], axis=1)  # two blocks to two firing sequences
    else:
        rows = _rows(unit, returns, np.full(shape, _ONLY_COLUMN[mode]))
    return rows.reshape(-1, RECORDS_PER_PACKET)


def _rows(unit: Unit, returns: Returns, column: NDArray[np.int64]) -> NDArray[np.void]:
    """Return `SLOT` (k, 16) of one return of each pulse, by its place (k, 16) on the last axis."""

    def taken(values: NDArray[Any] | None) -> NDArray[Any]:
        assert values is not None
        return np.take_along_axis(values, column[..., None], axis=-1)[..., 0]

    firings, rows = returns.firings, np.zeros(column.shape, SLOT)
    is_sent = distance_lsb(taken(returns.distance_m)) > 0
    rows["t_ns"] = firings.t_ns
    rows["echo"] = np.where(is_sent, column, NO_ECHO)
    range_m = np.where(is_sent, taken(returns.range_m), 0.0)
    rows["range_m"], rows["share"] = range_m, np.where(is_sent, taken(returns.share), 0.0)
    poses = unit.motion.poses_at(firings.t_ns.reshape(-1))
    world_m = firings.origin_m + firings.direction * range_m[..., None]
    away_m = world_m.reshape(-1, 3) - poses.world_p_body_m
    rows["world_m"] = world_m
    rows["sensor_m"] = matvec(poses.world_R_body.swapaxes(-1, -2), away_m).reshape(world_m.shape)
    assert returns.surfaces is not None
    surfaces = np.append(returns.surfaces, np.zeros(1, SURFACE))  # the last row is that of no surface
    met = surfaces[np.minimum(np.where(is_sent, taken(returns.surface), len(returns.surfaces)), len(returns.surfaces))]
    for name in _LABELS:
        rows[name] = met[name]
    return rows
