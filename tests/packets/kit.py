"""Returns made by hand."""

import numpy as np

from vlp16emu.types import Firings, Returns


def make_returns(
    sequences, *, clock_ns=0, t_ns=0, reading_deg=None, distance_m=None, reflectivity=None, lasers=16
):
    """Firing sequences of what the packer looks at; the rest is zero."""
    steps_ns, none = np.arange(sequences) * 55_296, np.zeros((sequences, lasers, 3))
    firings = Firings(
        index=0,
        t_ns=t_ns + steps_ns[:, None] + np.arange(lasers) * 2_304,
        clock_ns=(clock_ns + steps_ns) % (3_600 * 10**9),
        azimuth_deg=none[..., 0],
        reading_deg=np.zeros(sequences) if reading_deg is None else reading_deg,
        origin_m=none,
        direction=none,
        beam_axis=None,
    )
    return Returns(
        firings,
        none.astype(np.float32) if distance_m is None else distance_m,
        none.astype(np.uint8) if reflectivity is None else reflectivity,
    )


def random_returns(sequences, seed, lasers=16):
    """Firing sequences with one, two, three or no returns per pulse, and a rotor that turns."""
    random = np.random.default_rng(seed)
    shape = (sequences, lasers)
    distance_m = random.uniform(0.0, 140.0, (*shape, 3)).astype(np.float32)
    kind = random.integers(0, 4, shape)
    # The strongest is the last in kinds 1 and 3; there is no second strongest in kind 1; kind 0 is a miss.
    distance_m[..., 1] = np.where((kind == 1) | (kind == 3), distance_m[..., 0], distance_m[..., 1])
    distance_m[..., 2][kind == 1] = 0
    distance_m[kind == 0] = 0
    reflectivity = random.integers(0, 256, (*shape, 3), dtype=np.uint8)
    same = distance_m[..., 0] == distance_m[..., 1]
    reflectivity[..., 1][same] = reflectivity[..., 0][same]
    reflectivity[..., 2][kind <= 1] = 0
    turned_deg = np.arange(sequences) * 0.1990656 + random.normal(0, 0.005, sequences)
    return make_returns(
        sequences,
        clock_ns=int(random.integers(0, 3_600 * 10**9)),
        reading_deg=(random.uniform(0, 360) + turned_deg) % 360,
        distance_m=distance_m,
        reflectivity=reflectivity,
        lasers=lasers,
    )
