"""A real arm, measured by others: identified on the first 36 s, predicted beyond, where its pressures are higher."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from beside import shared_data
from numpy.typing import NDArray
from scipy.io import loadmat

import model
from calibration.identify import Fit, Poses, Setup, identify
from calibration.identify.predict import Predictor

Array = NDArray[np.float64]

TRAIN_UNTIL_S = 36.0
FREE = (
    "law", "base_x_m", "base_y_m", "base_z_m", "base_rx_rad", "base_ry_rad", "tool", "actuator_angles",
    "sensor_2_gain", "sensor_3_gain",
)  # fmt: skip


@dataclass(frozen=True)
class Recording:
    time_s: Array
    pressure_pa: Array
    tip_m: Array

    def poses(self, chosen: NDArray[np.int64]) -> Poses:
        n = len(chosen)
        return Poses(
            run_id="NoLoad",
            source="",
            period_s=0.0,
            pressure_pa=self.pressure_pa[chosen],
            pressure_std_pa=np.zeros((n, 3)),
            weight_kg=np.zeros(n),
            wrench=np.zeros((n, 6)),
            tip_m=self.tip_m[chosen],
            # An electromagnetic tracker: 0.3 mm; what the model lacks beyond that is found.
            covariance_m2=np.tile(np.eye(3) * 3e-4**2, (n, 1, 1)),
            frames=np.ones(n, np.int64),
            time_s=self.time_s[chosen],
        )


@pytest.fixture(scope="module")
def recording() -> Recording:
    data = loadmat(shared_data("stiff_flop", "NoLoad.mat"))["NoLoad"]
    pressure = (data[:, 1:4] - data[:20, 1:4].mean(axis=0)) * 1e5
    return Recording(data[:, 0], pressure, (data[:, 11:14] - data[:20, 4:7].mean(axis=0)) * 1e-3)


def start(gravity_m_s2: float) -> Setup:
    """What the authors' scripts say: 45 mm long, sensor 15 mm off the axis, E about 120 kPa; chambers by eye."""
    geometry = model.Geometry.on_circle(0.045, 0.004, 0.006, 0.0085, (90.0, -30.0, 210.0))
    modulus = 120e3
    material = model.Material(modulus, 1 / (modulus * geometry.wall_area_m2), 0.001, 0.0, 0.4)
    arm = model.Arm(geometry, material, cap_mass_kg=0.01, gravity_m_s2=(0.0, 0.0, gravity_m_s2))
    return Setup(arm, base_translation_m=(-0.014, 0.001, 0.0), tool_offset_m=(0.015, 0.0, 0.02))


@pytest.fixture(scope="module")
def fit(recording: Recording) -> Fit:
    # Which way is down is not said: the training part decides.
    train = np.flatnonzero(recording.time_s < TRAIN_UNTIL_S)[::12]
    tries = [identify([recording.poses(train)], start(g), FREE) for g in (9.81, -9.81)]
    return max(tries, key=lambda one: one.log_likelihood)


def test_the_unseen_part_is_predicted_better_than_by_others(recording: Recording, fit: Fit) -> None:
    unseen = recording.poses(np.flatnonzero(recording.time_s >= TRAIN_UNTIL_S))
    error_mm = 1e3 * np.linalg.norm(unseen.tip_m - Predictor(unseen)(fit.setup), axis=1)
    assert len(error_mm) > 300
    assert np.sqrt((error_mm**2).mean()) < 4.5
    assert error_mm.mean() < 2.6


def test_the_fit_says_how_far_the_model_is_from_the_arm(recording: Recording, fit: Fit) -> None:
    assert fit.rms_m < 1.5e-3
    assert 2e-4 < fit.discrepancy_m < fit.rms_m
    assert any(not estimate.identified for estimate in fit.estimates)
