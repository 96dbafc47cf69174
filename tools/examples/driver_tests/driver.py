"""A small driver that converts data packets of a VLP-16 to points.

Source: VLP-16 User's Manual, 63-9243 Rev D, section 9.
"""

import struct

import numpy as np

ELEVATION_DEG = np.array([-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15])
OFFSET_M = np.array([112, -7, 97, -22, 81, -37, 66, -51, 51, -66, 37, -81, 22, -97, 7, -112]) / 10_000
RING = np.argsort(np.argsort(ELEVATION_DEG))
RECORD = np.dtype([("range", "<u2"), ("reflectivity", "u1")])
BLOCK = np.dtype([("flag", "<u2"), ("azimuth", "<u2"), ("records", RECORD, (2, 16))])
FIRING_US, LASER_US, HOUR_S, DUAL = 55.296, 2.304, 3600, 0x39


class Driver:
    """Reader of packets in order of arrival."""

    def __init__(self):
        self.hours, self.stamp_us, self.lost = 0, None, 0

    def points(self, payload):
        """Return time since the first hour, position, ring and kind of all 384 records of a packet.

        Range 0 is no return.
        """
        blocks = np.frombuffer(payload, BLOCK, 12)
        stamp_us, mode = struct.unpack_from("<IB", payload, 1200)
        apart = 2 if mode == DUAL else 1  # pairs of blocks share their azimuth in dual return
        self.follow(stamp_us, 12 // apart * 2 * FIRING_US)
        turned = np.diff(blocks["azimuth"].astype(int), append=0)[apart - 1 :: apart] % 36_000
        turned = np.repeat(np.append(turned[:-1], turned[-2]), apart)
        since_us = np.arange(2)[:, None] * FIRING_US + np.arange(16) * LASER_US  # since the azimuth reading
        azimuth = blocks["azimuth"][:, None, None] + turned[:, None, None] * since_us / (2 * FIRING_US)
        begin_us = (np.arange(12) // apart * 2 * FIRING_US)[:, None, None]
        range_m = blocks["records"]["range"] * 0.002
        angle, up = np.radians(azimuth / 100), np.radians(ELEVATION_DEG)
        out = {
            "t_s": self.hours * HOUR_S + (stamp_us + begin_us + since_us) / 1e6,
            "x_m": range_m * np.cos(up) * np.cos(angle),
            "y_m": -range_m * np.cos(up) * np.sin(angle),
            "z_m": np.where(range_m > 0, range_m * np.sin(up) + OFFSET_M, 0.0),
            "range_m": range_m,
            "ring": np.broadcast_to(RING, range_m.shape),
            "is_last": np.broadcast_to(
                (np.arange(12) % 2 == 0)[:, None, None] & (mode == DUAL), range_m.shape
            ),
        }
        return {name: np.ravel(values) for name, values in out.items()}

    def follow(self, stamp_us, lasts_us):
        """Follow the time stamps, which restart each hour, and count the missing packets."""
        if self.stamp_us is not None:
            self.hours += stamp_us < self.stamp_us
            self.lost += round((stamp_us - self.stamp_us) % (HOUR_S * 1e6) / lasts_us) - 1
        self.stamp_us = stamp_us
