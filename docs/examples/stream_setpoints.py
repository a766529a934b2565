"""Streams set-points to a run while its protocol is at a step `stream`: python stream_setpoints.py SOCKET

SOCKET is the path that `rig run` prints. Only the standard library is used: a ROS 2 node can do the same."""

import json
import math
import pathlib
import socket
import sys
import time

path = pathlib.Path(sys.argv[1])
while not path.is_socket():  # until the run is armed
    time.sleep(0.05)
run = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
run.connect(str(path))


def ask(**packet):
    run.send(json.dumps({"via": "stream_setpoints.py", **packet}).encode())
    return json.loads(run.recv(4096) or "{}")


while not ask(do="state").get("stream"):
    time.sleep(0.05)
begun, sequence, answer = time.monotonic(), 0, ask(do="state")
while step := answer.get("stream"):
    turn = math.tau * (time.monotonic() - begun) / 4
    levels = [0.1 - 0.1 * math.cos(turn)] * len(step["actuators"])
    answer, sequence = ask(do="stream", sequence=sequence, setpoint_bar=levels), sequence + 1
    print(answer["protocol_s"], answer["pressure_bar"], answer["tip_mm"], answer["message"])
    time.sleep(0.02)
