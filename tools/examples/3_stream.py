#!/usr/bin/env python3
"""3. Stream a scene over UDP to your own socket, which receives like a driver.

tools/examples/3_stream.py [SECONDS]
"""

import socket
import struct
import sys

import vlp16emu

seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 5.0
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as driver:
    driver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    driver.bind(("127.0.0.1", 0))  # a real sensor sends to port 2368
    driver.settimeout(30.0)
    with vlp16emu.stream("static_bench", data_port=driver.getsockname()[1]) as live:
        packets = 0
        while packets < int(seconds * 753):  # data packets per second in single return
            payload = driver.recv(2000)
            (stamp_us,) = struct.unpack_from("<I", payload, 1200)  # time of the first pulse past the hour
            packets += 1
        print(
            f"{packets} packets of {len(payload)} bytes, the last one at {stamp_us / 1e6:.3f} s past the hour"
        )
        print(
            f"truth of its first record: {live.truth(payload)[0]['range_m']:.3f} m; web interface at "
            f"{live.http}"
        )
