"""What the text alone decides about Table 3."""

from __future__ import annotations

from dataclasses import replace

import pytest

import model
from rig.reproduce.positions import PRINTED
from scripts.table3_rules import ERROR_DEFINITIONS, table3, verdict


def test_what_section_6_calls_15_93_and_11_71_percent_are_differences_of_table_3_in_points() -> None:
    neither, radial, both = PRINTED
    assert (neither - both, neither - radial) == pytest.approx((15.93, 11.71))
    assert (neither - both) / neither == pytest.approx(0.926, abs=1e-3)


def test_no_rule_gives_table_3_with_the_printed_parameters() -> None:
    rows = table3()
    assert len(rows) == 5 * len(ERROR_DEFINITIONS)
    assert not any(row.possible for row in rows)
    said = verdict(rows)
    assert "none of the rules" in said
    # Under a fixed scale the radial effect is too small whatever the rule; over the tip's own excursion it is not.
    assert not any(row.between_possible for row in rows if row.definition == "distance over the arm's length")
    assert "distance over the tip's excursion" in said


def test_three_models_obey_the_triangle_inequality_under_every_reading() -> None:
    for row in table3():
        assert abs(row.homogeneous - row.radial) <= row.between + 1e-9
        assert row.between <= row.homogeneous + row.radial + 1e-9


def test_without_radial_effect_both_homogeneous_models_are_one() -> None:
    paper = model.Arm.paper()
    rows = table3(paper.with_segment(material=replace(paper.material, rpe_per_bar=0.0)))
    assert all(row.between == pytest.approx(0.0, abs=1e-9) for row in rows)


def test_an_arm_with_a_larger_radial_effect_would_pass_the_first_inequality() -> None:
    paper = model.Arm.paper()
    rows = table3(paper.with_segment(material=replace(paper.material, rpe_per_bar=0.09)))
    assert any(row.between_possible for row in rows)
