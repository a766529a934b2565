"""An independent program, PyElastica, finds the same rod: one tube on the axis, pulled aside at its tip."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import pytest
from numpy.typing import NDArray

from model import Loads

with warnings.catch_warnings():
    # What PyElastica's own dependencies say at import is theirs.
    warnings.simplefilter("ignore")
    pytest.importorskip("elastica", exc_type=ImportError)

from benchmarks.support.elastica_rod import FORCE, LENGTH, RADIUS, RAMP_S, ROD, STEPPED, TIP_RADIUS, elastica_tips
from model.dynamics import Dynamics
from model.statics import statics

pytestmark = pytest.mark.slow

Peer = Callable[..., NDArray[np.float64]]


@pytest.fixture(scope="module")
def peer() -> Iterator[Peer]:
    """PyElastica in a process of its own: its kernels are compiled without this program's settings."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        yield lambda *about: pool.submit(elastica_tips, *about).result()


def extrapolated(
    peer: Peer, duration_s: float, damping: float, samples: int, courant: float, tip_radius: float = RADIUS
) -> NDArray[np.float64]:
    """PyElastica's tip path without its errors of first order (its clamp holds the first element) and second."""
    coarse, middle, fine = (peer(n, duration_s, damping, samples, True, courant, tip_radius) for n in (10, 20, 40))
    return (8 * fine - 6 * middle + coarse) / 3


def test_a_tip_load_bends_it_as_in_pyelastica(peer: Peer) -> None:
    ours = statics(ROD, (0,), Loads(tip_force_n=FORCE)).tip_m
    # Nearly critical damping of the first mode: what is left of the motion then is a ten-thousandth.
    theirs = extrapolated(peer, 0.9, 24.0, 1, 0.5)[-1]
    assert abs(ours[0]) > 0.03
    assert np.linalg.norm(ours - theirs) < 1e-3 * np.linalg.norm(ours - [0, 0, LENGTH])


def test_a_tip_load_bends_two_segments_as_radii_by_element_in_pyelastica(peer: Peer) -> None:
    ours = statics(STEPPED, (0, 0), Loads(tip_force_n=FORCE)).tip_m
    theirs = extrapolated(peer, 1.2, 16.0, 1, 0.5, TIP_RADIUS)[-1]
    assert abs(ours[0]) > 0.04
    # 1.1e-3: its node at the step of the radii has the mean stiffness of two elements, an error of first order.
    assert np.linalg.norm(ours - theirs) < 1.5e-3 * np.linalg.norm(ours - [0, 0, LENGTH])


def test_a_growing_load_swings_it_as_in_pyelastica(peer: Peer) -> None:
    duration, samples = 0.24, 24
    theirs = extrapolated(peer, duration, 0.0, samples, 0.25)

    def ours(parts: int) -> NDArray[np.float64]:
        dynamics = Dynamics(ROD, duration / parts, "trapezoidal", nodes=96)
        dynamics.start((0,))
        times = np.arange(1, parts + 1) * duration / parts
        pulls = np.outer(np.minimum(1.0, times / RAMP_S), FORCE)
        path = [dynamics.step((0,), Loads(tip_force_n=pull)).tip_m for pull in pulls]
        return np.array(path)[parts // samples - 1 :: parts // samples]

    rough, smooth = ours(240), ours(480)
    found = smooth + (smooth - rough) / 3
    rms = math.sqrt(((found - theirs) ** 2).sum(axis=1).mean())
    swing = math.sqrt(((theirs - [0, 0, LENGTH]) ** 2).sum(axis=1).mean())
    assert swing > 0.02
    assert rms < 2.5e-3 * swing


def test_without_load_neither_moves(peer: Peer) -> None:
    assert peer(8, 0.02, 0.0, 1, False)[-1] == pytest.approx([0, 0, LENGTH], abs=1e-12)
    still = statics(replace(ROD), (0,))
    assert still.tip_m == pytest.approx([0, 0, LENGTH], abs=1e-12)
