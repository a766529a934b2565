"""Standard uncertainties in the rig file: read with their units, refused with their line, complete by defaults."""

from __future__ import annotations

import math

import pytest

from calibration.identify import Setup, known
from protocols import BadInputError
from rig.config.arm_model import model_arm
from rig.config.loader import parse, text
from rig.config.uncertainties import Uncertainties
from rig.identify.estimation import rig_uncertainties

STATED = """
uncertainties:
  cap_mass_g: 0.5
  inner_radius_mm: 0.05
  actuator_angles_deg: 1
  sensor_gain_percent: 0.2
  base_rotation_deg: 2
"""


def test_stated_uncertainties_reach_the_parameters_in_si_units() -> None:
    config = parse(text("mock") + STATED, "rig.yaml")
    found = rig_uncertainties(config, Setup(model_arm(config)))
    assert found["cap_mass_kg"].std == pytest.approx(5e-4)
    assert found["inner_radius_m"].std == pytest.approx(5e-5)
    assert found["actuator_3_turn_rad"].std == pytest.approx(math.radians(1))
    assert found["sensor_2_gain"].std == pytest.approx(2e-3)
    assert found["base_ry_rad"].std == pytest.approx(math.radians(2))
    # Half the accuracy of the sensor.
    assert found["sensor_1_offset_pa"].std == pytest.approx(500.0)
    assert set(found) == set(known(3))
    assert all(prior.std > 0 for prior in found.values())


def test_every_key_is_of_a_parameter() -> None:
    ones = Uncertainties.model_validate(dict.fromkeys(Uncertainties.model_fields, 1.5))
    config = parse(text("mock"), "rig.yaml").model_copy(update={"uncertainties": ones})
    stated = rig_uncertainties(config, Setup(model_arm(config)))
    by_kind = rig_uncertainties(parse(text("mock"), "rig.yaml"), Setup(model_arm(config)))
    unchanged = {name for name in stated if stated[name] == by_kind[name]}
    assert unchanged == {f"sensor_{n}_offset_pa" for n in (1, 2, 3)}


@pytest.mark.parametrize(("line", "said"), [("cap_mass_g: 0", "a number above 0"), ("cap_mas_g: 1", "cap_mass_g")])
def test_an_uncertainty_that_is_zero_or_unknown_is_refused_with_its_line(line: str, said: str) -> None:
    rig = text("mock") + f"\nuncertainties:\n  {line}\n"
    with pytest.raises(BadInputError) as refused:
        parse(rig, "rig.yaml")
    (problem,) = refused.value.problems
    assert said in str(problem)
    assert problem.line == len(rig.splitlines())
