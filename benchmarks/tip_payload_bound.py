"""How well a payload can be known: the information bound of the runs of `benchmarks.tip_payload`.

    python -m benchmarks.tip_payload_bound [--runs 40] [--payload 50] [--seed 2]

The best linear estimate of the payload from every frame before it and for 2 s after it, at rest under each frame's
pressures, for an estimator that knows the model without error, the distributions from which the arms are drawn, and the
noise of the camera. Printed is the standard deviation of its error for each pose, and with camera noise alone (the arm
known). What a controller finds cannot be better than that on average.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

import model
from benchmarks.tip_control import LIMIT_PA, drawn, published
from benchmarks.tip_payload import HUNG_S, Poses
from model import sensitivities
from model.arrays import Array
from model.inverse.static_map import StaticMap

MATERIAL = ("a1_per_n", "a2_per_n2", "rpe_per_bar", "shear_ratio", "density_kg_m3")
MATERIAL_STD, STRENGTH_STD, CAP_STD_KG = 0.04, 0.03, 0.002
"""As `benchmarks.tip_control.drawn` draws them."""
NOISE_M, FRAME_S, WEIGHED_S = 1e-4, 1 / 30, 2.0
STEP = 1e-3
PAYLOAD_STD_KG = 0.15


def tips(arm: model.Arm, pressure_pa: Array, payload_kg: Array) -> Array:
    """Tips (K, 3) [m] at rest."""
    return sensitivities.statics(arm, pressure_pa, weight_kg=payload_kg).tip_m


def slopes(arm: model.Arm, pressure_pa: Array, payload_kg: Array, hung: Array) -> Array:
    """Derivatives (K, 3, n) of the tips by each unknown in units of its standard deviation; the payload is the last."""
    columns = []
    for name in MATERIAL:
        pair = [
            replace(arm, material=replace(arm.material, **{name: getattr(arm.material, name) * (1 + sign * STEP)}))
            for sign in (1, -1)
        ]
        up, down = (tips(one, pressure_pa, payload_kg) for one in pair)
        columns.append(MATERIAL_STD * (up - down) / (2 * STEP))
    for actuator in range(3):
        change = 1 + STEP * np.eye(3)[actuator]
        up, down = (tips(arm, pressure_pa * factor, payload_kg) for factor in (change, 2 - change))
        columns.append(STRENGTH_STD * (up - down) / (2 * STEP))
    # The cap hangs on the tip as the payload does.
    up, down = (tips(arm, pressure_pa, payload_kg + sign * STEP) for sign in (1, -1))
    by_kg = (up - down) / (2 * STEP)
    return np.stack([*columns, CAP_STD_KG * by_kg, PAYLOAD_STD_KG * by_kg * hung[:, None]], axis=2)


def payload_std_kg(slope: Array) -> tuple[float, float]:
    """Standard deviation of the payload, with unknown and with known parameters of the arm."""
    rows = slope.reshape(-1, slope.shape[2]) / NOISE_M
    information = rows.T @ rows
    std = np.sqrt(np.linalg.inv(information + np.eye(len(information)))[-1, -1])
    return PAYLOAD_STD_KG * float(std), PAYLOAD_STD_KG / float(np.sqrt(information[-1, -1] + 1))


def main() -> None:
    """Print a row for each pose, then the summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--payload", type=float, default=50.0, help="g")
    parser.add_argument("--seed", type=int, default=2)
    args = parser.parse_args()
    arm, rng = published(), np.random.default_rng(args.seed)
    chart, poses = StaticMap.of(arm, (0, 1, 2), LIMIT_PA), Poses(arm)
    times = np.arange(0.0, HUNG_S + WEIGHED_S, FRAME_S)
    hung = (times >= HUNG_S).astype(float)
    found = []
    print(f"{args.runs} runs, seed {args.seed}, {args.payload:g} g\npose            std [g]   arm known [g]")
    for k in range(args.runs):
        drawn(rng)  # the poses are those of benchmarks.tip_payload
        name, task = poses.task(rng, held=k % 2 == 0)
        wanted = task.position_m(times)
        before = chart.inverse(wanted, np.full(3, 3e4))
        after = chart.inverse(wanted, np.full(3, 3e4), 1e-3 * args.payload)
        pressure = np.where(hung[:, None] > 0, after, before)
        unknown, known = payload_std_kg(slopes(arm, pressure, 1e-3 * args.payload * hung, hung))
        found.append(1e3 * unknown)
        print(f"{name:15} {1e3 * unknown:7.2f} {1e3 * known:12.2f}", flush=True)
    errors = np.abs(np.random.default_rng(0).standard_normal((10000, args.runs)) * found)
    within = np.mean(errors <= 3)
    print(f"median {np.median(errors):.1f} g, 95 % {np.percentile(errors, 95):.1f} g; {within:.0%} within 3 g")


if __name__ == "__main__":
    main()
