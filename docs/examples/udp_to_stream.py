"""Passes set-points from UDP packets on to a run, for programs such as Simulink: python udp_to_stream.py SOCKET

SOCKET is the path that `rig run` prints. A packet to 127.0.0.1:17117 is little-endian doubles: the sequence number,
then the set-points [bar] of the step's actuators. Each is answered to its sender: 1 if followed, else 0; protocol
time [s]; tip x, y, z [mm], NaN if it is not measured; pressures [bar]. UDP does not say who sends: any program on
this computer can. Run it only while you stream.
"""

import json
import socket
import struct
import sys

run = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
run.connect(sys.argv[1])
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
    udp.bind(("127.0.0.1", 17117))
    while True:
        data, sender = udp.recvfrom(1024)
        sequence, *levels = struct.unpack(f"<{len(data) // 8}d", data[: len(data) // 8 * 8])
        packet = {"do": "stream", "via": "UDP", "sequence": int(sequence), "setpoint_bar": levels}
        run.send(json.dumps(packet).encode())
        if not (answer := json.loads(run.recv(4096) or "{}")):
            break  # the run has ended
        tip = answer["tip_mm"] or [float("nan")] * 3
        values = [answer["done"], answer["protocol_s"], *tip, *(answer["pressure_bar"] or [])]
        udp.sendto(struct.pack(f"<{len(values)}d", *values), sender)
