"""The model alone, driven by a protocol's set-points, into an archive of the same layout as a run's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from rig.arm import model_arm
from rig.executor.base import Plan
from rig.experiment import Request, header
from rig.sketch import backbone
from runs.archive import finalise
from runs.journal import JournalWriter
from runs.records import RunFooter, Seen, Status, observation_dtype, sample_dtype


def simulate(request: Request, plan: Plan, static: bool) -> Path:
    """Write what the model says the tip does when the chambers follow the set-points exactly.

    The rows carry no measured tip (`Seen.NO_FRAME`); the measured pressures are the set-points, and the archive says
    that it is a simulation. Time steps are the camera's.
    """
    config, trajectory = plan.config, plan.trajectory
    rate_hz = next(iter(config.cameras.values())).rate_hz
    dt_s = 1.0 / rate_hz
    steps = int(trajectory.duration_s * rate_hz) + 1
    pressures = trajectory.sample(np.arange(steps) * dt_s)
    arm = model_arm(config, plan.variant)
    dynamics = None if static else arm.dynamics(dt_s)

    samples = np.zeros(steps, sample_dtype(config.actuators, len(config.valves)))
    samples["tick"] = np.arange(steps)
    samples["t_ns"] = np.round(np.arange(steps) * dt_s * 1e9)
    samples["protocol_s"] = np.arange(steps) * dt_s
    samples["setpoint_pa"] = samples["measured_pa"] = pressures
    samples["valve_v"] = np.nan
    rows = np.zeros(steps, observation_dtype(config.actuators, len(config.cameras)))
    rows["t_ns"], rows["frame"], rows["protocol_s"] = samples["t_ns"], samples["tick"], samples["protocol_s"]
    rows["seen"] = rows["camera_seen"] = Seen.NO_FRAME
    rows["pressure_pa"] = pressures
    for field in ("measured_m", "covariance_m2", "truth_m", "reprojection_px", "camera_skew_s"):
        rows[field] = np.nan
    for i, pressure in enumerate(pressures):
        if dynamics is None:
            shape = arm.statics(pressure)
        else:
            shape = dynamics.start(pressure) if i == 0 else dynamics.step(pressure)
        rows["model_m"][i] = shape.tip_m
        rows["backbone_m"][i] = backbone(shape)
        rows["model_ok"][i] = shape.ok

    title = f"{request.protocol.title} (model alone, {'static' if static else 'dynamic'})"
    about = replace(header(request, plan, 0), title=title, executor="model alone", simulated=True, control_hz=rate_hz)
    request.folder.mkdir(parents=True, exist_ok=True)
    journal = JournalWriter(request.folder / f"{about.run_id}.mcap", about)
    journal.samples(samples)
    journal.observations(rows)
    unsolved = int(steps - rows["model_ok"].sum())
    message = f"{unsolved} of {steps} steps could not be solved" if unsolved else ""
    journal.close(RunFooter(int(samples["t_ns"][-1]), Status.FINISHED, message))
    return finalise(journal.path)
