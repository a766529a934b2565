"""The true tip after the controller dies or stalls, in virtual time on mock-3 with a tracker.

    python -m benchmarks.tip_lost_controller [--losses 20] [--seed 0] [--paths ...] [--controllers horizon]

Each row is one run: a path, when the controller is lost and for how long (`dies`: for good). Printed are the largest
distance of the true tip from the reference from the loss on, the same of the undisturbed run over the same time, the
largest speed of the true tip beside that of the reference, how the run ended and when. First come the losses that
docs/explanation/tip-control.md states, then `--losses` others at moments drawn at random.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

import protocols
from benchmarks.support.random_tip_paths import stated_rig
from benchmarks.support.virtual_tip_run import SharedHorizon, perform
from protocols.tip_reference import TipMotion
from rig.config.schema import RigConfig
from rig.tip_control.baselines import InverseIntegral
from rig.tip_control.interface import (
    ControllerMeasurement,
    ReferenceTrajectory,
    SetPointPlan,
    TipController,
    TipControlSettings,
)
from rig.tip_planning.inverse import RigTipInverse
from runs.records import RunFooter

Step = dict[str, Any]

STALL_S = 0.6
LEAD_IN_S = 1.5
_CENTRE = {"centre_mm": [0, 0, 190]}
_SQUARE = [[15, 15, 190], [-15, 15, 190], [-15, -15, 190], [15, -15, 190]]
PATHS: dict[str, Step] = {
    "circle 0.5 Hz": {"circle": _CENTRE | {"radius_mm": 20, "period_s": 2, "periods": 3}},
    "circle 1 Hz": {"circle": _CENTRE | {"radius_mm": 20, "period_s": 1, "periods": 6}},
    "square": {"points": {"at_mm": [*_SQUARE, *_SQUARE, _SQUARE[0]], "move_s": 0.75, "dwell_s": 0, "ways": "linear"}},
    "eight 0.5 Hz": {"figure_eight": _CENTRE | {"width_mm": 30, "height_mm": 15, "period_s": 2, "periods": 3}},
    "star": {"star": _CENTRE | {"radius_mm": 18, "points": 5, "period_s": 5, "periods": 1.2}},
    "points": {"points": {"at_mm": [*_SQUARE, _SQUARE[0]], "move_s": 0.6, "dwell_s": 0.6, "ways": "smooth"}},
}
STATED = ("circle 0.5 Hz", "circle 1 Hz", "square")


class Lost:
    """A controller that is lost at a time of the protocol: it raises, or is silent for a while."""

    name: ClassVar[str] = "horizon"
    from_s: ClassVar[float] = math.inf
    silent_s: ClassVar[float] = math.inf

    def __init__(self, settings: TipControlSettings) -> None:
        self._controller = CONTROLLERS[self.name](settings)

    def start(self) -> Any:
        """The state before the first step."""
        return self._controller.start()

    def step(self, state: Any, reference: ReferenceTrajectory, measurement: ControllerMeasurement) -> SetPointPlan:
        """The plan; from `from_s` on none for `silent_s`: one of the far future is refused, and the state is kept."""
        start_s = measurement.start_s
        if self.from_s <= start_s < self.from_s + self.silent_s:
            if math.isinf(self.silent_s):
                raise RuntimeError("dies")
            times_s = start_s + np.array([100.0])
            return SetPointPlan(times_s, reference.feedforward_pa[:1], np.full((1, 3), np.nan), state)
        return self._controller.step(state, reference, measurement)


CONTROLLERS: dict[str, Callable[[TipControlSettings], TipController]] = {
    "horizon": SharedHorizon,
    "inverse-integral": InverseIntegral,
}


def lost(
    config: RigConfig, path: str, controller: str, from_s: float, silent_s: float, seed: int
) -> tuple[np.ndarray, TipMotion, RunFooter, float]:
    """Frames (n,) of a run whose controller is lost, the motion, how the run ended, and at which protocol time."""
    step = PATHS[path] | {"lead_in_s": LEAD_IN_S}
    trajectory = protocols.from_steps("lost", [{"tip": step}]).expand(3, RigTipInverse(config))
    Lost.name, Lost.from_s, Lost.silent_s = controller, from_s, silent_s
    record, footer = perform(config, trajectory, seed, f"{Lost.__module__}:{Lost.__name__}")
    (motion,) = trajectory.tip.motions
    return np.concatenate(record.frames), motion, footer, float(np.concatenate(record.cycles)["protocol_s"][-1])


def figures(frames: np.ndarray, motion: TipMotion, from_s: float, to_s: float) -> tuple[float, float, float]:
    """Largest error [mm] and speed [mm/s] of the true tip, and speed of the reference, between protocol times."""
    within = (frames["protocol_s"] >= from_s) & (frames["protocol_s"] < min(to_s, motion.stop_s))
    rows = frames[within & np.isfinite(frames["reference_m"]).all(axis=1)]
    errors = 1e3 * np.linalg.norm(rows["truth_m"] - rows["reference_m"], axis=1)
    times = rows["t_ns"] * 1e-9
    speeds = [
        1e3 * np.linalg.norm(np.diff(rows[name], axis=0), axis=1) / np.diff(times)
        for name in ("truth_m", "reference_m")
    ]
    return float(errors.max()), float(speeds[0].max()), float(speeds[1].max())


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--losses", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--paths", nargs="+", default=list(PATHS), choices=list(PATHS))
    parser.add_argument("--controllers", nargs="+", default=["horizon"], choices=list(CONTROLLERS))
    args = parser.parse_args()
    config = RigConfig.model_validate(stated_rig())
    rng = np.random.default_rng(args.seed)
    cases = [(path, 3.3, silent_s) for path in STATED if path in args.paths for silent_s in (math.inf, STALL_S)]
    for number in range(args.losses):
        silent_s = math.inf if number % 2 else float(rng.uniform(0.3, 1.2))
        cases.append((str(rng.choice(args.paths)), float(rng.uniform(LEAD_IN_S + 0.5, 6.0)), silent_s))
    print("controller        path            lost     for     error [mm]  undisturbed  speed [mm/s]  path  ended")
    for controller in args.controllers:
        for path, from_s, silent_s in cases:
            frames, motion, footer, ended_s = lost(config, path, controller, from_s, silent_s, args.seed)
            whole, *_ = lost(config, path, controller, math.inf, 0.0, args.seed)
            to_s = ended_s - 0.05 if footer.status != "finished" else math.inf
            error, speed, path_speed = figures(frames, motion, from_s, to_s)
            usual, *_ = figures(whole, motion, from_s, to_s)
            silent = "dies" if math.isinf(silent_s) else f"{silent_s:.2f} s"
            print(
                f"{controller:17} {path:14} {from_s:5.2f} s  {silent:>7} {error:9.2f} {usual:12.2f} {speed:12.0f} "
                f"{path_speed:7.0f}  {footer.status} at {ended_s:.2f} s",
                flush=True,
            )


if __name__ == "__main__":
    main()
