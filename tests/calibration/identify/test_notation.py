"""Numbers with uncertainties: digits, powers of ten and units of the bench."""

from __future__ import annotations

import pytest

from calibration.identify.presentation.notation import Scale, quantity, units_note


@pytest.mark.parametrize(
    ("name", "unit", "value", "std", "expected"),
    [
        ("a1_per_n", "1/N", 0.0076123, 4.1e-5, "7.61(4) x 10^-3 /N"),
        ("a2_per_n2", "1/N^2", 3.3e-4, 5e-7, "3.300(5) x 10^-4 /N^2"),
        ("cap_mass_kg", "kg", 0.0518, 0.0013, "51.8(13) g"),
        ("base_x_m", "m", -1.08e-4, 2.1e-4, "-0.1(2) mm"),
        ("sensor_1_offset_pa", "Pa", 1760.0, 20.0, "17.6(2) mbar"),
        ("youngs_modulus_pa", "Pa", 289142.0, 950.0, "289.1(10) kPa"),
        ("density_kg_m3", "kg/m^3", 1080.0, 54.0, "1080(50) kg/m^3"),
        ("shear_ratio", "1", 0.4094, 0.0205, "0.41(2)"),
        ("damping_s", "s", 0.0, 0.02, "0(20) ms"),
        ("base_rx_rad", "rad", 0.0, 0.03, "0.0(17) deg"),
    ],
)
def test_a_value_has_the_uncertainty_of_its_last_digits_and_the_unit_of_the_bench(
    name: str, unit: str, value: float, std: float, expected: str
) -> None:
    assert quantity(name, unit, value, std) == expected


def test_the_ends_of_an_interval_have_the_digits_of_the_value() -> None:
    scale = Scale.of("a1_per_n", "1/N", 0.0076123, 4.1e-5)
    assert scale.interval((0.00753, 0.0076927)) == "7.53 .. 7.69"


def test_an_interval_between_bounds_that_are_closer_than_the_uncertainty_is_not_rounded_to_nothing() -> None:
    assert Scale.of("shear_ratio", "1", 0.42, 50.0).interval((0.01, 5.0)) == "0.0 .. 5.0"
    assert Scale.of("shear_ratio", "1", 0.42, 50.0).interval((0.02, 0.47)) == "0.02 .. 0.47"


def test_a_note_explains_names_that_end_with_another_unit_than_their_numbers_have() -> None:
    assert "SI unit" in units_note({"youngs_modulus_pa": "Pa", "shear_ratio": "1"})
    assert "SI unit" in units_note({"damping_s": "s"})
    assert units_note({"shear_ratio": "1", "law": "1/bar"}) == ""
