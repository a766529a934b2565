"""The delay of the pressures, as a table shows it."""

from __future__ import annotations

import numpy as np
import pytest

from model.arrays import Array
from rig.importing.pressure_columns import measured_delay
from tests.support.import_bench import SMALL, Bring, complaint, warnings_of

# An arm that bends to three sides, and gets longer, per bar [m].
BENDS = 1e-3 * np.array([[20.0, 0.0, 2.0], [-10.0, 17.0, 2.0], [-10.0, -17.0, 2.0]])


def steps(seed: int, delay_s: float, period_s: float = 0.05, pushed: bool = True) -> tuple[Array, Array, Array]:
    """Times (n,), pressures (n, 3) that step every few seconds, and tips (n, 3) that follow them late.

    The pressures rise within a fifth of a second. Somebody pushes at the tip several times.
    """
    rng = np.random.default_rng(seed)
    fine_s = np.arange(0.0, 50.0, 0.005)
    levels = rng.uniform(0.0, 1.0, (12, 3)) * rng.integers(0, 2, (12, 3))
    at_s = np.cumsum(rng.uniform(3.0, 5.0, 12))
    target = np.zeros((len(fine_s), 3))
    for start_s, level in zip(at_s, levels, strict=True):
        target[fine_s >= start_s] = level
    rise = 40
    course = np.stack([np.convolve(np.pad(c, (rise - 1, 0)), np.ones(rise) / rise, "valid") for c in target.T], axis=1)
    time_s = np.arange(0.5, 49.0, period_s)
    sampled = [np.stack([np.interp(time_s - late_s, fine_s, c) for c in course.T], axis=1) for late_s in (0, delay_s)]
    tips = sampled[1] @ BENDS + [0.0, 0.0, 0.06]
    if pushed:
        for centre_s in rng.uniform(5.0, 45.0, 5):
            tips += 0.015 * np.exp(-(((time_s - centre_s) / 0.7) ** 2))[:, None] * rng.standard_normal(3)
    tips += 3e-4 * rng.standard_normal(tips.shape)
    pressures = 1e5 * sampled[0] + 300.0 * rng.standard_normal(sampled[0].shape)
    return time_s, pressures, tips


@pytest.mark.slow
@pytest.mark.parametrize("delay_s", [-0.3, 0.0, 0.15, 0.4])
def test_the_delay_is_found_within_its_uncertainty(delay_s: float) -> None:
    errors = []
    for seed in range(25):
        found = measured_delay(*steps(seed, delay_s))
        assert found is not None
        assert found.share > 0.3
        errors.append((found.delay_s - delay_s) / found.std_s)
    assert np.abs(errors).max() < 3
    assert abs(np.mean(errors)) < 1


def test_the_delay_is_finer_than_the_rows() -> None:
    found = [measured_delay(*steps(seed, 0.17, 0.1, pushed=False)) for seed in range(10)]
    assert np.mean([one.delay_s for one in found if one is not None]) == pytest.approx(0.17, abs=0.02)


def test_missing_tips_do_not_move_the_delay() -> None:
    time_s, pressure_pa, tip_m = steps(3, 0.2)
    tip_m[np.random.default_rng(1).uniform(size=len(tip_m)) < 0.1] = np.nan
    found = measured_delay(time_s, pressure_pa, tip_m)
    assert found is not None
    assert found.delay_s == pytest.approx(0.2, abs=3 * found.std_s)


def test_tips_that_do_not_follow_the_pressures_show_no_delay() -> None:
    time_s, pressure_pa, _ = steps(1, 0.0)
    _, _, of_another = steps(2, 0.0)
    assert measured_delay(time_s, pressure_pa, of_another) is None
    assert measured_delay(time_s, 0 * pressure_pa, of_another) is None
    assert measured_delay(time_s, pressure_pa, 0 * of_another) is None
    assert measured_delay(time_s[:50], pressure_pa[:50], of_another[:50]) is None


def table(delay_s: float) -> str:
    """The steps as a table of times, the first pressure in bar and tips in mm."""
    time_s, pressure_pa, tip_m = steps(5, delay_s, pushed=False)
    rows = np.column_stack([time_s, 1e-5 * pressure_pa, 1e3 * tip_m])
    return "".join(",".join(f"{x:.5f}" for x in row) + "\n" for row in rows)


THREE = SMALL.replace("columns: [1]", "columns: [1, 2, 3]").replace("[2, 3, 4]", "[4, 5, 6]")


def test_an_import_measures_the_delay_where_the_mapping_asks_for_it(bring: Bring) -> None:
    run = bring(table(0.2), THREE.replace("gauge", "gauge, delay_s: measured"))
    (delay,) = (q for q in run.header.quantities if q.name == "pressure_delay")
    assert delay.value[0] == pytest.approx(0.2, abs=3 * delay.uncertainty)
    assert 0 < delay.uncertainty < 0.05
    assert "the tip follows" not in warnings_of(run)


@pytest.mark.parametrize(("stated", "warned"), [("", True), (", delay_s: 0.2", False), (", delay_s: -0.2", True)])
def test_a_delay_against_that_of_the_mapping_gives_a_warning(bring: Bring, stated: str, warned: bool) -> None:
    run = bring(table(0.2), THREE.replace("gauge", f"gauge{stated}"))
    assert ("the tip follows the pressures by 0.2" in warnings_of(run)) == warned


def test_a_delay_that_the_table_does_not_show_is_asked_for(bring: Bring) -> None:
    text = "".join(f"{0.1 * k},0.{k % 10},{k},2,3\n" for k in range(9))
    said = complaint(bring, text, SMALL.replace("gauge", "gauge, delay_s: measured"))
    assert "a delay in seconds: the table does not show" in said
    assert "mapping.yaml:4" in said
