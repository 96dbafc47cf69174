"""What leaves beside the packets of the sensors, and by which way."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Literal

from vlp16emu.motion import Imu
from vlp16emu.sinks.imu import imu_outlet
from vlp16emu.sinks.serial_port import SerialPort, SerialSink
from vlp16emu.sinks.sink import Outlet
from vlp16emu.types import PacketKind

_GPS_BAUD = 9600
"""What the sensor takes (63-9243 Rev D, section 7.4)."""


@dataclass(frozen=True, slots=True)
class Outlets:
    """What a stream sends beside the packets of the sensors; nothing unless it is asked for."""

    gps_out: str | None = None
    """Serial port, or URL of pyserial, at which the receiver of the scene is played: sentences at 9600 baud, 8N1."""
    gps_pps: Literal["dtr", "rts", "off"] = "dtr"
    """Line of that port for its pulse; a null-modem cable leads DTR to DCD, where programs look for it."""
    imu_out: str | None = None
    """Where samples of the inertial unit go: udp://HOST:PORT, or serial: and a port."""

    @property
    def kinds(self) -> tuple[PacketKind, ...]:
        """Kinds of packets to make."""
        gps = (PacketKind.NMEA, PacketKind.PPS)[: 1 if self.gps_pps == "off" else 2]
        return (*(gps if self.gps_out else ()), *((PacketKind.IMU,) if self.imu_out else ()))

    def look_ahead(self, imu: Imu | None) -> int:
        """Packets that a stream computes further ahead, because of samples between those of the sensors."""
        return 2 * imu.rate_hz if self.imu_out and imu else 0

    @contextmanager
    def opened(self, imu: Imu | None) -> Iterator[dict[PacketKind, Outlet]]:
        """Open what there is, and give the way of each kind.

        Parameters
        ----------
        imu : the inertial unit of the scene, which is checked already

        Raises
        ------
        OutputError
            where a port cannot be opened, or the receiver of samples is unknown
        """
        ways = dict[PacketKind, Outlet]()
        with ExitStack() as stack:
            if self.gps_out:
                line = None if self.gps_pps == "off" else self.gps_pps
                port = SerialPort(self.gps_out, _GPS_BAUD, "--gps-out", line)
                ways[PacketKind.NMEA] = ways[PacketKind.PPS] = stack.enter_context(SerialSink(port))
            if self.imu_out and imu:
                ways[PacketKind.IMU] = stack.enter_context(imu_outlet(self.imu_out, imu.rate_hz))
            yield ways
