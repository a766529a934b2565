"""A synthetic run of any length, for the tests of journals, archives and reports."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from runs.journal.journal import JournalWriter
from runs.records import (
    BACKBONE_POINTS,
    DetectionStatus,
    Event,
    ImageAnnotations,
    Level,
    Picture,
    PlayedSegment,
    Quantity,
    RunFooter,
    RunHeader,
    Status,
    adaptation_dtype,
    observation_dtype,
    sample_dtype,
)

START_NS = 5_000_000_000
ACTUATORS = 3
VALVES = 2
ARMED = Event(START_NS, Level.INFO, "control", "armed")


def intervals(duration_s: float) -> tuple[PlayedSegment, ...]:
    """Dwells of 1 s, 0.05 bar apart, of actuator 1."""
    return tuple(
        PlayedSegment(float(i), min(i + 1.0, duration_s), "step", f"step {i + 1}", ((i + 1) * 5000.0, 0.0, 0.0))
        for i in range(int(np.ceil(duration_s)))
    )


def header(run_id: str = "20260102T030405-test", duration_s: float = 3.0, simulated: bool = True) -> RunHeader:
    """A header with every field filled."""
    return RunHeader(
        run_id=run_id,
        title="Staircase of actuator 1",
        started_utc_ns=1_767_323_045_123_456_789,
        started_t_ns=START_NS,
        protocol_name="stairs",
        protocol_yaml="name: stairs\n# µ and ° survive\n",
        rig_name="mock",
        rig_yaml="name: mock\n",
        actuators=ACTUATORS,
        valves=VALVES,
        executor="virtual time",
        simulated=simulated,
        seed=7,
        model_variant="inhomogeneous+rpe",
        operator="A. Tester",
        notes="made up",
        command="rig run stairs --fast",
        host="bench",
        versions={"softrig": "0.1.0", "numpy": str(np.__version__)},
        git_commit="0123abc",
        git_diff="--- a\n+++ b\n",
        intervals=intervals(duration_s),
        quantities=(
            Quantity("calibration", "front.lens.fx", (900.0,), "px", "rig.yaml", 1.5),
            Quantity("model", "youngs_modulus", (289142.05,), "Pa", "eq 33"),
        ),
    )


def samples(duration_s: float, seed: int = 0) -> NDArray[np.void]:
    """200 Hz of a first-order answer to the staircase."""
    rng = np.random.default_rng(seed)
    n = int(duration_s * 200)
    rows = np.zeros(n, sample_dtype(ACTUATORS, VALVES))
    t = np.arange(n) / 200
    rows["t_ns"] = START_NS + np.arange(n) * 5_000_000
    rows["cycle"] = np.arange(n)
    rows["protocol_s"] = t
    step = np.floor(t)
    rows["setpoint_pa"][:, 0] = (step + 1) * 5000
    rows["measured_pa"][:, 0] = (step + 1) * 5000 - 5000 * np.exp(-(t - step) / 0.08)
    rows["measured_pa"] += rng.normal(0, 50, (n, ACTUATORS))
    rows["valve_v"] = 5 + rng.normal(0, 0.1, (n, VALVES))
    rows["scans"] = 5
    rows["lateness_ns"] = rng.exponential(2000, n).astype(np.int64)
    if n > 100:
        rows["missed"][100] = 2
    return rows


def observations(duration_s: float, seed: int = 0, simulated: bool = True) -> NDArray[np.void]:
    """30 Hz: the true tip in the x-z plane, measured with a known covariance, a model that is 1 mm off in x."""
    rng = np.random.default_rng(seed)
    n = int(duration_s * 30)
    rows = np.zeros(n, observation_dtype(ACTUATORS))
    t = np.arange(1, n + 1) / 30
    rows["t_ns"] = START_NS + (t * 1e9).astype(np.int64)
    rows["frame"] = np.arange(1, n + 1)
    rows["protocol_s"] = t
    rows["pressure_pa"][:, 0] = (np.floor(t) + 1) * 5000
    truth = np.zeros((n, 3))
    truth[:, 0] = -rows["pressure_pa"][:, 0] * 1e-6
    truth[:, 2] = 0.18 - 0.02 * (truth[:, 0] / 0.03) ** 2
    sigma = np.array([0.2e-3, 0.6e-3, 0.2e-3])
    rows["truth_m"] = truth if simulated else np.nan
    rows["covariance_m2"] = np.diag(sigma**2)
    rows["measured_m"] = truth + rng.normal(0, 1, (n, 3)) * sigma
    rows["orientation_rad"][:, 1] = -rows["pressure_pa"][:, 0] * 1e-5
    rows["orientation_covariance_rad2"] = np.eye(3) * np.deg2rad(0.1) ** 2
    rows["model_m"] = truth + np.array([1e-3, 0, 0])
    rows["backbone_m"] = rows["model_m"][:, None] * np.linspace(0, 1, BACKBONE_POINTS)[:, None]
    rows["model_ok"] = 1
    rows["reprojection_px"] = 0.05
    rows["age_ns"] = 8_000_000
    for index in (10, 11):
        if n > index:
            rows["seen"][index] = DetectionStatus.NO_BOARD
            rows["measured_m"][index] = np.nan
            rows["covariance_m2"][index] = rows["orientation_covariance_rad2"][index] = np.nan
            rows["orientation_rad"][index] = rows["cross_covariance_m_rad"][index] = np.nan
    if n > 20:
        rows["dropped"][20] = 3
    return rows


def picture(index: int) -> Picture:
    """A picture whose bytes depend on its number."""
    image = np.full((480, 640), 40 + index % 200, np.uint8)
    image[100:200, 100:200] = np.random.default_rng(index).integers(0, 256, (100, 100), dtype=np.uint8)
    data = cv2.imencode(".jpg", image)[1].tobytes()
    return Picture(START_NS + index * 100_000_000, index * 3, "front", "jpeg", data, marks(index))


def marks(index: int) -> ImageAnnotations:
    """Annotations that depend on the picture's number; the picture with number 3 shows no board."""
    corners = np.array([(u, v) for v in range(4) for u in range(5)]) * 8.0 + 300 + index
    if index == 3:
        return ImageAnnotations.of(
            [], [np.nan, np.nan], (340.0, 420.0), np.linspace((320, 40), (340, 420), BACKBONE_POINTS)
        )
    tip = (330.0 + index, 420.0)
    return ImageAnnotations.of(corners, tip, (335.0, 421.0), np.linspace((320, 40), (335, 421), BACKBONE_POINTS))


def write_journal(
    path: Path, duration_s: float = 3.0, footer: bool = True, pictures: int = 5, simulated: bool = True
) -> JournalWriter:
    """Write a whole run; without a footer the writer is left open, as a process that dies leaves it."""
    writer = JournalWriter(path, header(path.stem, duration_s, simulated))
    writer.event(ARMED)
    s, o = samples(duration_s), observations(duration_s, simulated=simulated)
    for low in range(0, len(s), 20):
        writer.samples(s[low : low + 20])
    for low in range(0, len(o), 3):
        writer.observations(o[low : low + 3])
    for index in range(pictures):
        writer.picture(picture(index))
    if footer:
        end_ns = START_NS + int(duration_s * 1e9)
        writer.close(RunFooter(end_ns, Status.FINISHED, "", {"ring_overflows": 0, "missed_deadlines": 2}))
    return writer


def write_cut_off_while_adapting(path: Path) -> Path:
    """Write a run that is cut off between its last frames and their estimates."""
    adapted = (Quantity("adaptation", "shear_ratio", (0.4,), "", "", 0.1),)
    writer = JournalWriter(path.with_suffix(".written"), replace(header(path.stem), adapted=adapted))
    seen = observations(3.0)
    writer.samples(samples(3.0))
    writer.observations(seen)
    rows = np.zeros(len(seen) - 2, adaptation_dtype(1))
    for field in ("t_ns", "frame"):
        rows[field] = seen[field][:-2]
    rows["used"], rows["value"], rows["covariance"] = 1, 0.4, 0.01
    rows["start_model_m"] = seen["model_m"][:-2]
    writer.adaptations(rows)
    # A copy has no living writer.
    return shutil.copy(writer.path, path)
