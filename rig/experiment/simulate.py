"""Run the model alone on a protocol's set-points; write an archive of the same layout as a run's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from protocols import arguments
from rig.config.arm_model import TipLoad, model_arm
from rig.execution.plan import RunPlan, observation_rows
from rig.experiment.prepare import PreparedRun
from rig.experiment.run import header
from rig.observation.live_model import LiveModel
from rig.observation.overlay import backbone
from rig.observation.sample_interpolator import SampleInterpolator
from runs.archive.writer import finalise
from runs.journal.journal import JournalWriter
from runs.records import MODEL_ALONE, DetectionStatus, RunFooter, Status, blank, sample_dtype


def simulate(prepared: PreparedRun) -> Path:
    """Simulate the tip for chambers that follow the set-points exactly; return the archive.

    Weights of the protocol's prompts load the model. The rows have no measured tip (`DetectionStatus.NO_FRAME`); the
    measured pressures are the set-points, and the archive is marked as simulated. Time steps are the camera's. The
    rig's `model` says whether statics or dynamics are solved. After a step without convergence the model restarts from
    the static solution.
    """
    folder, plan = arguments.folder("--out", prepared.options.out), prepared.plan
    config, trajectory = plan.config.free_running, plan.trajectory
    rate_hz = config.observation_hz
    dt_s = 1.0 / rate_hz
    steps = int(trajectory.duration_s * rate_hz) + 1
    pressures = trajectory.sample(np.arange(steps) * dt_s)
    samples = blank(steps, sample_dtype(config.actuators, len(config.valves)))
    samples["cycle"] = np.arange(steps)
    samples["t_ns"] = np.round(np.arange(steps) * dt_s * 1e9)
    samples["protocol_s"] = np.arange(steps) * dt_s
    samples["setpoint_pa"] = samples["measured_pa"] = pressures
    rows = blank(steps, observation_rows(config))
    rows["t_ns"], rows["frame"], rows["protocol_s"] = samples["t_ns"], samples["cycle"], samples["protocol_s"]
    rows["seen"] = rows["camera_seen"] = DetectionStatus.NO_FRAME
    if config.sections:
        rows["section_seen"] = DetectionStatus.NO_FRAME
    rows["pressure_pa"] = pressures
    rows["reference_m"] = trajectory.tip.sample(rows["protocol_s"])
    rows["predicted_m"] = trajectory.tip.predicted_m(rows["protocol_s"])
    places = np.array([trajectory.tip.motion_and_period(t_s) for t_s in rows["protocol_s"].tolist()])
    rows["tip_motion"], rows["tip_period"] = places.T
    _solve_rows(rows, plan)

    title = f"{prepared.protocol.title} (model alone, {config.model.mode})"
    about = replace(
        header(prepared, 0),
        title=title,
        executor=MODEL_ALONE,
        simulated=True,
        control_hz=rate_hz,
        auxiliary=(),
        valve_units=(),
        triggered=False,
    )
    folder.mkdir(parents=True, exist_ok=True)
    journal = JournalWriter(folder / f"{about.run_id}.mcap", about)
    journal.samples(samples)
    journal.observations(rows)
    unsolved = int(steps - rows["model_ok"].sum())
    message = f"{unsolved} of {steps} steps could not be solved" if unsolved else ""
    journal.close(RunFooter(int(samples["t_ns"][-1]), Status.FINISHED, message))
    return finalise(journal.path)


def _solve_rows(rows: NDArray[np.void], plan: RunPlan) -> None:
    """Set weight, tip, backbone and sections of the rows (n,) by the model at their pressures."""
    config = plan.config
    static = config.model.mode == "static"
    live = LiveModel(model_arm(config, plan.variant), 1 / config.observation_hz, static)
    pressures = SampleInterpolator(config.actuators)
    pressures.extend(rows["t_ns"], rows["pressure_pa"])
    sections_m = np.array([section.at_mm * 1e-3 for section in config.sections.values()])
    tip_load, tip_m = TipLoad(config), np.full(3, np.nan)
    for row in rows:
        row["weight_kg"] = weight_kg = plan.trajectory.weight_kg(float(row["protocol_s"]))
        shape = live.step(int(row["t_ns"]), pressures, tip_load.carrying(weight_kg))
        if shape is not None:
            tip_m = shape.tip_m
            if len(sections_m):
                row["section_model_m"] = shape.frames_at(sections_m)[0]
        row["model_m"], row["backbone_m"], row["model_ok"] = tip_m, backbone(shape), shape is not None
