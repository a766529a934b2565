"""The process of the tip controller: a plan from every frame that the observer has measured.

It has no device and can write to its own pages of the shared memory only (see `SharedState`). The control process
checks each plan and keeps within the limits of the rig; without plans it follows the protocol and the last correction.
"""

from __future__ import annotations

import signal
import time

import numpy as np

from rig.control.plan_follower import record_of
from rig.realtime.child_process import ChildJob, exit_process, receive_job, supervisor_monitor
from rig.realtime.shared_state import TIP_CONTROLLER, SharedState, Stage, Stop
from rig.tip_control.monitor import failure_message
from rig.tip_control.session import HISTORY_S, TipControlSession

POLL_S = 0.001


def main() -> int:
    """Send plans until a stop is requested."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    job, memory = receive_job(tip_controller=True)
    try:
        _send_plans(job, memory)
    except Exception as error:
        memory.publish_stage(TIP_CONTROLLER, Stage.FAILED, failure_message(error))
        raise
    memory.publish_stage(TIP_CONTROLLER, Stage.DONE)
    return 0


def _send_plans(job: ChildJob, memory: SharedState) -> None:
    session = TipControlSession(job.plan)
    session.warm_up()
    supervisor = supervisor_monitor(job)
    cycles = round(HISTORY_S * job.plan.config.control.rate_hz)
    memory.publish_stage(TIP_CONTROLLER, Stage.READY)
    while memory.stop_request == Stop.NONE and not supervisor.exited:
        memory.heartbeat(TIP_CONTROLLER, time.monotonic_ns())
        # Of several frames that wait, only the newest is of use: a plan from an old one would be replaced at once.
        frames, samples = memory.observations.read()[-1:], memory.samples.last(cycles)
        if not len(frames) or not len(samples):
            time.sleep(POLL_S)
            continue
        begun_ns, frame = time.monotonic_ns(), frames[0]
        since_ns = samples["t_ns"] - frame["t_ns"]
        frame_protocol_s = float(np.interp(0.0, since_ns, samples["protocol_s"]))
        if (found := session.step(frame, frame_protocol_s, samples)) is not None:
            plan, row = found
            row["solve_ns"] = time.monotonic_ns() - begun_ns
            memory.new_plans.push(record_of(plan, row))


if __name__ == "__main__":
    exit_process(main())
