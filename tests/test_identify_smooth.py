"""The pressures that a model is driven with: noise taken off, edges kept, and a density that noise does not spoil."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import model
from calibration.identify import Prior, Setup, identify
from calibration.identify.predict import FINE_SUBSTEPS, SUBSTEPS, Predictor
from calibration.identify.simulated import Errors, plan
from calibration.identify.smooth import between, noise_of, smoothed

TICK_HZ, CAMERA_HZ = 200, 30
NOISE_PA = 45.0


def sine(time_s: np.ndarray) -> np.ndarray:
    ramp = np.clip(time_s, 0.0, 1.0)
    first = 0.35e5 * ramp**2 * (3 - 2 * ramp) + 0.25e5 * np.sin(1.4 * np.clip(time_s - 1, 0.0, None))
    return np.stack([first, np.zeros_like(first), np.zeros_like(first)], axis=1)


def test_noise_of_a_smooth_course_is_found_and_taken_off() -> None:
    time_s = np.arange(0, 12, 1 / TICK_HZ)
    truth = sine(time_s)
    samples = truth + NOISE_PA * np.random.default_rng(5).standard_normal(truth.shape)
    assert noise_of(samples) == pytest.approx(np.full(3, NOISE_PA), rel=0.1)
    found, deviation = smoothed(samples)
    error = np.sqrt(((found - truth) ** 2).mean(axis=0))
    assert (error < 0.3 * NOISE_PA).all()
    # The stated deviation is of the size of the error.
    stated = np.sqrt((deviation**2).mean(axis=0))
    assert (error < 2 * stated).all()
    assert (error > 0.5 * stated).all()


def test_a_whole_motion_keeps_its_height() -> None:
    ticks_s = np.arange(0, 40, 1 / TICK_HZ)
    truth = 2e4 * np.sin(2 * np.pi * np.outer(ticks_s, [0.6, 0.9]))
    samples = truth + 2 * NOISE_PA * np.random.default_rng(3).standard_normal(truth.shape)
    found, _ = smoothed(samples)
    inside = slice(300, -300)
    height = (found * truth)[inside].sum(axis=0) / (truth**2)[inside].sum(axis=0)
    # Crests cut by one deviation of each value are a thousandth, which the mean over the motion shows tenfold.
    assert height == pytest.approx(np.ones(2), abs=3e-4)


def test_between_frames_a_course_keeps_its_crests() -> None:
    def truth(time_s: np.ndarray) -> np.ndarray:
        return np.sin(2 * np.pi * time_s)[..., None]

    frames_s, parts = np.arange(60) / CAMERA_HZ, 8
    found = between(truth(frames_s), parts)
    assert found[:, -1] == pytest.approx(truth(frames_s[1:]))
    true = truth(frames_s[:-1, None] + np.arange(1, parts + 1) / parts / CAMERA_HZ)
    # Straight lines lose 0.36 %.
    assert np.abs(found - true)[2:-2].max() < 5e-4
    assert between(truth(frames_s[:1]), parts).shape == (0, parts, 1)


def test_an_edge_stays_where_it_is() -> None:
    samples = np.where(np.arange(600) < 300, 0.2e5, 0.5e5)[:, None]
    samples = samples + NOISE_PA * np.random.default_rng(6).standard_normal(samples.shape)
    found, _ = smoothed(samples)
    assert np.abs(found[:290] - 0.2e5).max() < 4 * NOISE_PA
    assert np.abs(found[310:] - 0.5e5).max() < 4 * NOISE_PA
    assert found[299, 0] < 0.25e5
    assert found[300, 0] > 0.45e5


def test_the_density_found_on_slow_sines_is_not_that_of_the_noise() -> None:
    arm = model.Arm.paper()
    truth = Setup(replace(arm, material=replace(arm.material, damping_s=0.01, density_kg_m3=1100.0)))
    ticks_s, frames_s = np.arange(0, 9, 1 / TICK_HZ), np.arange(0, 9, 1 / CAMERA_HZ)
    planned = plan("sine", sine(frames_s), period_s=1 / CAMERA_HZ, errors=Errors((3e-5, 3e-5, 3e-5), 0.0, 0.0))
    rng = np.random.default_rng(1)
    tip = Predictor(planned)(truth) + 3e-5 * rng.standard_normal((len(planned), 3))
    samples = sine(ticks_s) + 3 * NOISE_PA * rng.standard_normal((len(ticks_s), 3))
    course, deviation = smoothed(samples)

    def at_frames(values: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(frames_s, ticks_s, column) for column in values.T], axis=1)

    data = replace(planned, tip_m=tip, pressure_pa=at_frames(course), pressure_std_pa=at_frames(deviation))
    free, priors = ["law", "density_kg_m3", "damping_s", "sensor_offsets"], {"sensor_offsets": Prior(0.0, 200.0)}
    density = identify([data], truth, free, priors)["density_kg_m3"]
    assert density.value is not None
    assert density.std is not None
    assert abs(density.value - 1100.0) < 4 * density.std
    # The samples as they are drive the density far from the truth, and the bars do not show it.
    noise = np.full(course.shape, 3 * NOISE_PA)[: len(frames_s)]
    raw = replace(data, pressure_pa=at_frames(samples), pressure_std_pa=noise)
    spoiled = identify([raw], truth, free, priors)["density_kg_m3"]
    assert spoiled.std is not None
    assert abs(spoiled.used - 1100.0) > 4 * spoiled.std


def test_fine_steps_do_not_slow_the_arms_own_oscillation() -> None:
    pressure = np.zeros((40, 3))
    pressure[3:, 0] = 0.2e5
    step = plan("step", pressure, period_s=1 / CAMERA_HZ)
    truth = Predictor(step, 40)(Setup(model.Arm.paper()))
    coarse, fine = (
        np.linalg.norm(Predictor(step, steps)(Setup(model.Arm.paper())) - truth, axis=1).max()
        for steps in (SUBSTEPS, FINE_SUBSTEPS)
    )
    assert fine < 0.35 * coarse
