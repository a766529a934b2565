"""Error and stated interval of a tracker's time, for a sender whose clock drifts: `python benchmarks/tracker_clock.py`.

Every trial sends messages with random one-way delays over a known minimum, and compares the time that `SenderClock`
gives for the newest message with the true one. Times of look follow each other by a factor of 1.5. A second table has
clocks that drift by more than stated, or whose drift or time is changed; there every message from 2 s on is a look.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial

import numpy as np

from model.arrays import Array
from rig.hardware.trackers.sender_clock import SenderClock

MINIMUM_S, DRIFT, RATE_HZ, FIRST_LOOK_S, FACTOR = 2e-3, 100e-6, 100, 2.0, 1.5
JITTERS: dict[str, Callable[[np.random.Generator, float, int], Array]] = {
    "exponential": lambda random, mean, n: random.exponential(mean, n),
    "half normal": lambda random, mean, n: np.abs(random.normal(0, mean, n)),
    "uniform": lambda random, mean, n: random.uniform(0, 2 * mean, n),
    "gamma, shape 2": lambda random, mean, n: random.gamma(2, mean / 2, n),
}


CHANGE_S = 20.0
CLOCKS: dict[str, Callable[[Array], Array]] = {
    f"drift {ppm:+d} ppm, stated below 200": partial(np.multiply, ppm * 1e-6) for ppm in (0, 500, -500)
}
CLOCKS |= {
    f"{ppm:+d} ppm for 10 s": lambda t_s, ppm=ppm: ppm * 1e-6 * np.clip(t_s - CHANGE_S, 0, 10)  # type: ignore[misc]
    for ppm in (100, -100, 20, -20)
}
CLOCKS |= {
    f"set by {ms:+d} ms": lambda t_s, ms=ms: ms * 1e-3 * (t_s >= CHANGE_S)  # type: ignore[misc]
    for ms in (1, -1, 20, -20, 500, -500)
}
"""How far the sender's clock is ahead at times (n,) [s]."""


def changing(random: np.random.Generator, ahead_s: Array, mean_s: float) -> tuple[Array, Array, int, int]:
    """Errors [s] and standard uncertainties [s] of the poses from 2 s on, steps found, and messages left out."""
    clock, errors, stds, left_out = SenderClock(), [], [], 0
    phase_s = random.uniform(0, 1e6)
    for k, (ahead, delay_s) in enumerate(zip(ahead_s, random.exponential(mean_s, len(ahead_s)), strict=True)):
        t_s = k / RATE_HZ
        sent_ns = round((phase_s + t_s + ahead) * 1e9)
        used = clock.add(sent_ns, round((t_s + MINIMUM_S + delay_s) * 1e9)) and clock.ready
        if used and t_s >= FIRST_LOOK_S:
            errors.append(clock.ours_ns(sent_ns) * 1e-9 - t_s - MINIMUM_S)
            stds.append(clock.estimate(sent_ns).std_s)
        left_out += not used and t_s >= FIRST_LOOK_S
    return np.array(errors), np.array(stds), clock.steps, left_out


def print_changes(trials: int, seconds: float, seed: int) -> None:
    """Print the table of clocks that change."""
    print("clock | mean ms | rms us | max us | within 95 % interval | within it or 0.1 ms | steps | left out")
    t_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    for name, ahead in CLOCKS.items():
        for mean_s in (1e-3, 10e-3):
            random = np.random.default_rng(seed)
            found = [changing(random, ahead(t_s), mean_s) for _ in range(trials)]
            error, std = (np.concatenate([row[i] for row in found]) for i in (0, 1))
            rms_us, most_us = np.sqrt(np.mean(error**2)) * 1e6, np.abs(error).max() * 1e6
            inside = np.abs(error) <= 1.96 * std
            near = np.mean(inside | (np.abs(error) < 1e-4))
            steps, left_out = (np.mean([row[i] for row in found]) for i in (2, 3))
            print(
                f"{name} | {mean_s * 1e3:g} | {rms_us:.0f} | {most_us:.0f} | {np.mean(inside):.1%} | {near:.1%} | "
                f"{steps:.1f} | {left_out:.0f}"
            )


def trial(random: np.random.Generator, delays_s: Array) -> tuple[list[float], list[float], float]:
    """Errors [s] and standard uncertainties [s] at each look, and the error of the drift at the end."""
    clock, errors, stds, look_s = SenderClock(), [], [], FIRST_LOOK_S
    phase_s = random.uniform(0, 1e6)
    for k, delay_s in enumerate(delays_s):
        t_s = k / RATE_HZ
        sent_ns = round((phase_s + t_s * (1 + DRIFT)) * 1e9)
        used = clock.add(sent_ns, round((t_s + MINIMUM_S + delay_s) * 1e9))
        if t_s >= look_s and used and clock.ready:
            look_s *= FACTOR
            errors.append(clock.ours_ns(sent_ns) * 1e-9 - t_s - MINIMUM_S)
            stds.append(clock.estimate(sent_ns).std_s)
    return errors, stds, clock.estimate(sent_ns).drift + DRIFT


def main() -> None:
    """Print one row per distribution and mean jitter."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--trials", type=int, default=20)
    options.add_argument("--seconds", type=float, default=60.0)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--changes", action="store_true", help="only the second table")
    chosen = options.parse_args()
    if chosen.changes:
        print_changes(chosen.trials, chosen.seconds, chosen.seed)
        return
    print("jitter | mean ms | rms us after 2 s | at the end | drift rms ppm | within 95 % interval")
    for name, draw in JITTERS.items():
        for mean_s in (1e-3, 10e-3):
            random = np.random.default_rng(chosen.seed)
            rows = [trial(random, draw(random, mean_s, round(chosen.seconds * RATE_HZ))) for _ in range(chosen.trials)]
            least = min(len(errors) for errors, _, _ in rows)
            error = np.array([errors[:least] for errors, _, _ in rows])
            std = np.array([stds[:least] for _, stds, _ in rows])
            rms_us = np.sqrt(np.mean(error**2, axis=0)) * 1e6
            drift_ppm = np.sqrt(np.mean([drift**2 for _, _, drift in rows])) * 1e6
            inside = np.mean(np.abs(error) <= 1.96 * std)
            print(f"{name} | {mean_s * 1e3:g} | {rms_us[0]:.0f} | {rms_us[-1]:.1f} | {drift_ppm:.2f} | {inside:.1%}")


if __name__ == "__main__":
    main()
