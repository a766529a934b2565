"""An arm of several segments in the rig file."""

from __future__ import annotations

import numpy as np
import pytest

from protocols import BadInputError
from rig.config import loader
from rig.config.arm_model import chamber_areas_m2, model_arm, true_arm
from rig.config.schema import RigConfig

TEXT = loader.text("mock-two-sections")
ONE = """\
  geometry:
    length_mm: 170
    inner_radius_mm: 9.5
    outer_radius_mm: 14
    circle_radius_mm: 31.754264805429417
    actuator_angles_deg: [0, 120, 240]
  material:
    youngs_modulus_pa: 289142.05
    a1_per_N: 0.00742681
    a2_per_N2: 0.00031962
    rpe_per_bar: 0.05324473
    shear_ratio: 0.4094
"""


def parsed(text: str) -> RigConfig:
    return loader.parse(text, "rig.yaml")


def problem(text: str) -> tuple[int, str, str]:
    """Line, place and expectation of the only problem of a rig file."""
    with pytest.raises(BadInputError) as bad:
        parsed(text)
    (one,) = bad.value.problems
    return one.line, one.where, one.expected


def line_of(text: str, words: str, occurrence: int = 1) -> int:
    """The line of the file in which these words stand for this time."""
    found = [number for number, line in enumerate(text.splitlines(), start=1) if words in line]
    return found[occurrence - 1]


def test_segments_follow_each_other_from_the_base_to_the_tip() -> None:
    config = parsed(TEXT)
    arm = model_arm(config)
    assert config.actuators == arm.actuators == 6
    assert config.arm.length_mm == pytest.approx(215)
    assert arm.length_m == pytest.approx(0.215)
    first, second = arm.segments
    assert (first.geometry.length_m, second.geometry.length_m) == pytest.approx((0.11, 0.09))
    assert (second.coupling.length_m, second.coupling.mass_kg) == pytest.approx((0.015, 0.02))
    assert second.material.a1_per_n == 0.0121
    np.testing.assert_allclose(chamber_areas_m2(config.arm.chain), np.pi * np.repeat([9.5e-3, 7.5e-3], 3) ** 2)


def test_the_truth_of_the_simulator_has_the_stated_geometry_and_couplings_and_its_own_materials() -> None:
    config = parsed(TEXT)
    stated, true = model_arm(config), true_arm(config)
    assert [s.geometry for s in true.segments] == [s.geometry for s in stated.segments]
    assert [s.coupling for s in true.segments] == [s.coupling for s in stated.segments]
    assert [s.material.rpe_per_bar for s in true.segments] == [0.0515, 0.055]
    assert true.cap_mass_kg == pytest.approx(0.042)


def test_a_list_of_one_segment_is_the_short_form() -> None:
    short = loader.text("mock-ideal")
    assert short.count(ONE) == 1
    lines = ONE.splitlines()
    listed = "\n".join(("    - " if k == 0 else "      ") + line[2:] for k, line in enumerate(lines))
    material = short[short.index("  material:\n", short.index("simulator:")) : short.rindex("  cap_mass_g")]
    true = material.replace("  material:", "  segments:\n    - material:").replace("\n    ", "\n        ")
    true = true.replace("\n        - material:", "\n    - material:")
    long = parsed(short.replace(ONE, f"  segments:\n{listed}\n").replace(material, true))
    assert long.arm.segments is not None
    assert model_arm(long) == model_arm(parsed(short))
    assert true_arm(long) == true_arm(parsed(short))


def test_neither_and_both_forms_are_refused_at_the_line_of_the_arm() -> None:
    short = loader.text("mock-ideal")
    material = ONE[ONE.index("  material:") :]
    line, where, expected = problem(short.replace(material, "", 1))
    assert (line, where) == (line_of(short, "arm:"), "arm, material")
    assert expected.startswith("is missing: material of the one segment, or a list of `segments`")
    both = TEXT.replace("arm:\n  segments:\n", f"arm:\n{material}  segments:\n")
    line, where, expected = problem(both)
    assert (line, where) == (line_of(both, "youngs_modulus_pa:"), "arm, material")
    assert "no such key beside `segments`" in expected


@pytest.mark.parametrize(
    ("old", "new", "where", "expected"),
    [
        ("radius_mm: 7.5", "radius_mm: 12", "arm, segments #2, geometry, inner_radius_mm", "less than outer_radius_mm"),
        ("length_mm: 90", "length_mm: 0.9", "arm, segments #2, geometry, length_mm", "the diameter of a tube"),
        ("  length_mm: 110", "  lenght_mm: 110", "arm, segments #1, geometry, lenght_mm", "one of length_mm"),
        ("actuator: 6,", "actuator: 7,", "sensors #6, actuator", "from 1 to 6: the arm has 6 in its segments"),
        ("at_mm: 110", "at_mm: 215", "sections, middle, at_mm", "less than the length of the arm, 215 mm"),
        ("length_mm: 15,", "length_mm: -15,", "arm, segments #2, coupling, length_mm", "a number from 0"),
    ],
)  # fmt: skip
def test_a_fault_of_a_segment_is_refused_with_its_place(old: str, new: str, where: str, expected: str) -> None:
    text = TEXT.replace(old, new, 1)
    with pytest.raises(BadInputError) as bad:
        parsed(text)
    found = {(one.line, one.where): one.expected for one in bad.value.problems}
    assert expected in found[line_of(text, new.strip()), where]


def test_the_first_segment_has_no_coupling() -> None:
    text = TEXT.replace(
        "  segments:\n    - geometry:", "  segments:\n    - coupling: {length_mm: 5}\n      geometry:", 1
    )
    line, where, expected = problem(text)
    assert (line, where) == (line_of(text, "coupling: {length_mm: 5}"), "arm, segments #1, coupling")
    assert "the first segment, which is clamped" in expected


def test_the_truth_has_as_many_segments_as_the_arm() -> None:
    start = TEXT.index("    - material: {<<: *true")
    text = TEXT[:start] + TEXT[TEXT.index("\n", start) + 1 :]
    line, where, expected = problem(text)
    assert (line, where) == (line_of(text, "material: &true"), "simulator, segments")
    assert "2 `segments`, as many as the arm has" in expected


def test_a_true_geometry_of_other_actuators_than_the_stated_ones_is_refused() -> None:
    geometry = (
        "{length_mm: 91, inner_radius_mm: 7.5, outer_radius_mm: 11, circle_radius_mm: 24, "
        "actuator_angles_deg: [60, 180]}"
    )
    text = TEXT.replace("    - material: {<<: *true", f"    - geometry: {geometry}\n      material: {{<<: *true")
    line, where, expected = problem(text)
    assert (line, where) == (line_of(text, geometry), "simulator, segments #2, geometry, actuator_angles_deg")
    assert expected == "3 angles, as many as arm, segments #2, geometry, actuator_angles_deg has"
    full = parsed(text.replace("[60, 180]", "[60, 180, 300]", 1).replace("[60, 180]", "[60, 180, 300]"))
    assert true_arm(full).segments[1].geometry.length_m == pytest.approx(0.091)
