"""`python -m benchmarks.rod`: the rod model's speed beside its peers, at equal error against a converged reference.

Times are the best of several runs, in this process, one thread unless said. Ratios carry over to other machines; times
do not. Not part of the tests: timing asserts lie on a busy machine.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import math
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace

import numba
import numpy as np

from model import Arm, Loads, batch
from model.arrays import Array
from model.dynamics import Dynamics
from model.paper.rod import PaperRod
from model.sensitivities import statics as answers
from model.sensitivities import tip_gradient
from model.statics import statics
from model.variation import Variation

BAR = 1e5
DT = 1 / 30
# Operations of one lane in one stage of RK4 with a constant stiffness, counted in the machine code of
# model/kernels/rod.py: a multiply-add is two. 257 are the right-hand side, 52 move the state on.
FLOP_PER_STAGE = 309
LANES = 8


def best(action: Callable[[], object], repeats: int) -> float:
    """Shortest time [s] of an action."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return min(times)


def line(what: str, value: str, note: str = "") -> None:
    """One row of the report."""
    print(f"  {what:<58}{value:>14}  {note}", flush=True)


@numba.njit(fastmath={"contract"})
def _chain(x: float, rounds: int) -> float:
    for _ in range(rounds):
        x = x * 0.999999 + 1e-9
    return x


@numba.njit(fastmath={"contract"})
def _burn(x: Array, rounds: int) -> None:
    for _ in range(rounds):
        for i in range(128):
            x[i] = x[i] * 0.999999 + 1e-9


def burst(rounds: int = 16_000) -> float:
    """Operations per second, now: fused multiply-adds on sixteen vectors that stay in the registers or first cache.

    About as long as a simulated second takes, so that some are undisturbed on a busy machine.
    """
    x = np.ones(128)
    start = time.perf_counter()
    _burn(x, rounds)
    return 2 * 128 * rounds / (time.perf_counter() - start)


def chain_ns() -> float:
    """Time [ns] of one multiply-add that waits for the one before: what a scalar chain of dependent stages costs."""
    _chain(1.0, 1)
    rounds = 1_000_000
    return best(lambda: _chain(1.0, rounds), 5) / rounds * 1e9


def path_of_sine(parts: int) -> Array:
    """The paper's sinusoid on actuator 1 over one second, (parts + 1, 3) [Pa], from rest on."""
    t = np.arange(parts + 1) / parts
    return np.stack([0.35 + 0.25 * np.sin(t + 4 * math.pi / 3), 0 * t, 0 * t], axis=1) * BAR


def ours(arm: Arm, nodes: int, repeats: int = 300) -> tuple[float, Array, float]:
    """Seconds per simulated second at 30 steps, the tip's path, and what the arithmetic peak could do in that time.

    The last [operations] is of the shortest run and of the best of the bursts that alternate with the runs: both are
    taken in the same moments.
    """
    path = path_of_sine(30)
    times, peaks, tips = [], [], np.empty(0)
    for _ in range(repeats):
        dynamics = Dynamics(arm, DT, nodes=nodes)
        dynamics.start(path[0])
        start = time.perf_counter()
        tips = dynamics.run(path[1:]).tip_m
        times.append(time.perf_counter() - start)
        peaks.append(burst())
    return min(times), tips, min(times) * max(peaks)


def operations(variant: str, nodes: int) -> dict[str, int]:
    """What that second needs, counted in a process without compiled kernels."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.support.operations", variant, str(nodes)],
        check=True,
        capture_output=True,
        text=True,
    )
    return dict(json.loads(done.stdout))


def plain(arm: Arm, space: str, steps: int) -> tuple[float, Array]:
    """The same by the paper's and Till's plain method: scalar shooting, compiled, with MINPACK."""
    path = path_of_sine(30)
    times, tips = [], np.empty(0)
    for _ in range(3):
        rod = PaperRod(arm, DT, space=space, steps=steps)  # type: ignore[arg-type]
        rod.start(path[0])
        start = time.perf_counter()
        tips = np.array([rod.step(p).tip_m for p in path[1:]])
        times.append(time.perf_counter() - start)
    return min(times), tips


def dynamics() -> None:
    """Point by point: error, time, real-time factor, distance from the arithmetic limit, and the plain method."""
    burst(1)
    peak = max(burst() for _ in range(1000)) / 1e9
    print(f"\nDynamics: 30 steps of 1/30 s; arithmetic peak of one core {peak:.0f} GFLOP/s in vectors,", end=" ")
    print(f"a dependent multiply-add {chain_ns():.2f} ns")
    for variant in ("homogeneous+rpe", "inhomogeneous+rpe"):
        arm = Arm.paper(variant)  # type: ignore[arg-type]
        exact = ours(arm, 80, 1)[1]
        cheapest = None
        for nodes in (4, 5, 6, 8, 10, 20):
            seconds, tips, _ = ours(arm, nodes)
            error = np.abs(tips - exact).max()
            line(
                f"{variant}, RK4 N = {nodes}",
                f"{seconds * 1e3:.3f} ms",
                f"error {error:.0e} m, {1 / seconds:.0f} x real time",
            )
            if cheapest is None and error < 1e-6:
                cheapest = nodes
        assert cheapest is not None
        # Once more and more often: on a busy machine few runs are undisturbed.
        nodes = cheapest
        seconds, _, possible = ours(arm, nodes, 3000)
        line("at 1e-6 m", f"{seconds * 1e3:.3f} ms", f"N = {nodes}; aim: 0.2 ms")
        need = operations(variant, nodes)
        limit = need["all"] / (peak * 1e9)
        line(
            "  the same at the arithmetic peak", f"{limit * 1e3:.3f} ms",
            f"{need['all'] / 1e6:.2f} million operations in {need['passes']} passes, {need['divide']} of them divisions"
            f" and {need['root']} roots",
        )  # fmt: skip
        share = f"{need['all'] / seconds / 1e9:.1f} of {possible / seconds / 1e9:.0f} GFLOP/s beside it; aim: 3 x"
        line("  of the arithmetic limit", f"{possible / need['all']:.2f} x", share)
        if variant == "homogeneous+rpe":
            # As if there were nothing to do but to integrate, once a step.
            strict = 30 * 4 * nodes * LANES * FLOP_PER_STAGE
            line("  of one integration a step", f"{possible / strict:.2f} x", f"{strict / 1e6:.2f} million operations")
            for space, steps in (("euler", 50), ("rk4", 12), ("rk4", 25), ("rk4", 50), ("rk4", 200)):
                slow, tips = plain(arm, space, steps)
                error = np.abs(tips - exact).max()
                line(
                    f"plain shooting, {space} N = {steps}",
                    f"{slow * 1e3:.1f} ms",
                    f"error {error:.0e} m, {slow / seconds:.0f} x ours",
                )


def stepping() -> None:
    """1 kHz steps from Python, a 0.5 bar jump in the middle; also in CPU time, which other programs do not disturb."""
    print("\nStepping at 1 kHz from Python with a 0.5 bar jump")
    for variant in ("homogeneous+rpe", "inhomogeneous+rpe"):
        dynamics = Dynamics(Arm.paper(variant), 0.001)  # type: ignore[arg-type]
        dynamics.start((0, 0, 0))
        dynamics.step((0, 0, 0))
        times = np.empty((1000, 2))
        for k in range(1000):
            p = (0.5 * BAR if k >= 500 else 0.0, 0, 0)
            start = np.array([time.perf_counter(), time.thread_time()])
            assert dynamics.step(p).ok
            times[k] = np.array([time.perf_counter(), time.thread_time()]) - start
        for clock, column in zip(("wall", "CPU"), times.T, strict=True):
            median, high, most = np.quantile(column, [0.5, 0.99, 1.0]) * 1e3
            line(f"{variant}, {clock} time", f"{high:.3f} ms", f"p99; median {median:.3f}, worst {most:.3f}; aim: 0.5")


def twelve(arm: Arm, rows: Array) -> list[Variation]:
    """What an identification may ask for: changes of material, geometry, cap and each pressure."""
    step = 1e-7
    material = ("youngs_modulus_pa", "a1_per_n", "a2_per_n2", "rpe_per_bar", "shear_ratio")
    moved = [
        arm.with_segment(material=replace(arm.material, **{n: (1 + step) * getattr(arm.material, n)})) for n in material
    ]
    geometry = arm.geometry
    moved += [arm.with_segment(geometry=replace(geometry, length_m=(1 + step) * geometry.length_m))]
    moved += [arm.with_segment(geometry=replace(geometry, inner_radius_m=(1 + step) * geometry.inner_radius_m))]
    first, *others = geometry.actuator_xy_m
    moved += [arm.with_segment(geometry=replace(geometry, actuator_xy_m=(((1 + step) * first[0], first[1]), *others)))]
    moved += [replace(arm, cap_mass_kg=(1 + step) * arm.cap_mass_kg)]
    pressed = [Variation(0.01, arm, rows + shift) for shift in 0.01 * np.eye(3)]
    return [*(Variation(step, one) for one in moved), *pressed]


def equilibria() -> None:
    """Cold solves, gradients against solves, and batches over the cores."""
    print("\nStatics, from scratch, RK4 N = 20")
    for variant in ("homogeneous+rpe", "inhomogeneous+rpe"):
        arm = Arm.paper(variant)  # type: ignore[arg-type]
        p = np.array([0.65, 0.2, 0.0]) * BAR
        solve = best(lambda arm=arm, p=p: statics(arm, p), 300)  # type: ignore[misc]
        gradient = best(lambda arm=arm, p=p: tip_gradient(arm, p), 300)  # type: ignore[misc]
        line(f"{variant}, one solve", f"{solve * 1e6:.0f} us", "aim: 100")
        line("  with the gradient by parameters and pressures", f"{gradient / solve:.1f} x", "aim: 3 x")
        some = np.random.default_rng(1).uniform(0, 0.65 * BAR, (200, 3))
        plain, by = (
            best(lambda c=c, arm=arm, p=some: answers(arm, p, c, workers=1), 10) for c in ((), twelve(arm, some))
        )  # type: ignore[misc]
        line("  200 in one call, with the gradient by 12 changes", f"{by / plain:.1f} x", "aim: 3 x")
        rows = np.random.default_rng(0).uniform(0, 0.65 * BAR, (4000, 3))
        one, many = (best(lambda w=w, arm=arm, rows=rows: batch.statics(arm, rows, workers=w), 3) for w in (1, None))  # type: ignore[misc]
        line("  4000 in one call, one core", f"{one / 4000 * 1e6:.1f} us", "each")
        line("  4000 in one call, all cores", f"{many / 4000 * 1e6:.1f} us", f"each; {one / many:.1f} x")


def start_up() -> None:
    """Import and first solve in a fresh interpreter, kernels on disk."""
    code = "import model; from model.statics import statics; statics(model.Arm.paper(), (5e4, 0, 0))"
    seconds = best(lambda: subprocess.run([sys.executable, "-c", code], check=True), 3)
    print("\nStart-up")
    line("interpreter, import and first solve", f"{seconds:.2f} s", "aim: 1.5")


def elastica() -> None:
    """One tube swung by a growing tip load: PyElastica and ours at its error."""
    if importlib.util.find_spec("elastica") is None:
        print("\nPyElastica is not installed: skipped")
        return
    from benchmarks.support.elastica_rod import FORCE, RAMP_S, ROD, elastica_tips

    duration, samples = 0.24, 24
    print(f"\nPyElastica: one tube, {duration} s, tip load growing over {RAMP_S} s; rms error of the tip")

    def path(parts: int, nodes: int | None = None) -> tuple[float, Array]:
        times = np.arange(1, parts + 1) * duration / parts
        loads = [Loads(tip_force_n=f) for f in np.outer(np.minimum(1, times / RAMP_S), FORCE)]
        dynamics = Dynamics(ROD, duration / parts, "trapezoidal", nodes=nodes)
        dynamics.start((0,))
        start = time.perf_counter()
        tips = np.array([dynamics.step((0,), load).tip_m for load in loads])
        return time.perf_counter() - start, tips[parts // samples - 1 :: parts // samples]

    rough, smooth = path(240, 96)[1], path(480, 96)[1]
    exact = smooth + (smooth - rough) / 3
    for elements in (10, 20, 40):
        elastica_tips(elements, 0.001, 0.0, 1, pull=True)
        start = time.perf_counter()
        theirs = elastica_tips(elements, duration, 0.0, samples, pull=True)
        slow = time.perf_counter() - start
        error = math.sqrt(((theirs - exact) ** 2).sum(axis=1).mean())
        for parts in (24, 48, 120, 240, 480):
            runs = [path(parts) for _ in range(3)]
            fast = min(seconds for seconds, _ in runs)
            mine = math.sqrt(((runs[0][1] - exact) ** 2).sum(axis=1).mean())
            if mine <= error:
                break
        line(
            f"PyElastica, {elements} elements", f"{slow / duration * 1e3:.0f} ms",
            f"per s, error {error:.0e} m; ours {fast / duration * 1e3:.1f} ms, error {mine:.0e} m: {slow / fast:.0f} x",
        )  # fmt: skip


def robustness(steps: int, seed: int) -> None:
    """Random jumps over the paper's whole range at every step: how many steps fail."""
    print(f"\nRobustness: {steps} random jumps over [0, 0.65]^3 bar, seed {seed}")
    for variant in ("homogeneous+rpe", "inhomogeneous+rpe"):
        for dt in (0.001, 0.002, 0.005, 0.01, 1 / 30, 1 / 15):
            dynamics = Dynamics(Arm.paper(variant), dt)  # type: ignore[arg-type]
            dynamics.start((0, 0, 0))
            start = time.perf_counter()
            run = dynamics.run(np.random.default_rng(seed).uniform(0, 0.65, (steps, 3)) * BAR)
            each = (time.perf_counter() - start) / steps
            assert np.isfinite(run.tip_m).all()
            line(f"{variant}, dt = {dt * 1e3:.1f} ms", f"{int((~run.ok).sum())} failed", f"{each * 1e6:.0f} us a step")


def main() -> None:
    """Everything, or one part by name."""
    parts = {
        "dynamics": dynamics,
        "stepping": stepping,
        "statics": equilibria,
        "start-up": start_up,
        "elastica": elastica,
    }
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="*", help=", ".join([*parts, "robustness"]))
    parser.add_argument("--steps", type=int, default=10_000, help="random jumps in the robustness part")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    chosen = arguments.parts or [*parts, "robustness"]
    unknown = [name for name in chosen if name not in parts and name != "robustness"]
    if unknown:
        parser.error(f"unknown part {unknown[0]!r}")
    for name in chosen:
        if name == "robustness":
            robustness(arguments.steps, arguments.seed)
        else:
            parts[name]()


if __name__ == "__main__":
    main()
