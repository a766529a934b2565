"""Sends poses to the UDP tracker of a rig: here a body on a circle of 20 mm, 100 times a second.

Replace `pose` by what your tracker gives: position [m] and orientation (quaternion w, x, y, z) of the body in the
tracker's frame. `python send_pose.py PORT` sends to this computer.
"""

import math
import socket
import struct
import sys
import time
import zlib

RATE_HZ = 100
SIGMA_M, SIGMA_RAD = 2e-4, 3e-3


def pose(t_s):
    angle = 2 * math.pi * 0.2 * t_s
    return (0.02 * math.cos(angle), 0.02 * math.sin(angle), 0.165), (1.0, 0.0, 0.0, 0.0)


variances = [SIGMA_M**2] * 3 + [SIGMA_RAD**2] * 3
covariance = [variances[i] if i == j else 0.0 for i in range(6) for j in range(i, 6)]
udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
begin_ns = time.perf_counter_ns()
for number in range(sys.maxsize):
    position, quaternion = pose(number / RATE_HZ)
    sent_ns = time.perf_counter_ns()  # the sender's own clock, at the time of the pose
    body = struct.pack("<4sHHQq", b"SRTP", 1, 1, number, sent_ns)
    body += struct.pack("<3d4d21df", *position, *quaternion, *covariance, 1.0)
    udp.sendto(body + struct.pack("<I", zlib.crc32(body)), ("127.0.0.1", int(sys.argv[1])))
    time.sleep(max(0, begin_ns + (number + 1) * 1_000_000_000 // RATE_HZ - time.perf_counter_ns()) * 1e-9)
