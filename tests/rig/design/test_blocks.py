"""Building blocks and inputs of `rig design`."""

from __future__ import annotations

from pathlib import Path

import pytest

import protocols
from rig.config.loader import load
from rig.config.schema import RigConfig
from rig.design.blocks import BLOCK_S, blocks, rest_bar
from rig.experiment.preflight import check
from tests.support.command_line import status_of


def slow(config: RigConfig) -> RigConfig:
    limits = config.limits.model_copy(update={"rate_bar_per_s": 0.4})
    return config.model_copy(update={"limits": limits})


@pytest.mark.slow
@pytest.mark.parametrize("change", [lambda config: config, slow])
def test_every_block_keeps_the_limits_of_the_rig(change: object) -> None:
    config = change(load("mock"))  # type: ignore[operator]
    found = blocks(config)
    every = list(range(1, config.actuators + 1))
    up = {"ramp": {"actuators": every, "to_bar": rest_bar(config), "duration_s": 2}}
    steps = [up, *(step for block in found for step in block.steps)]
    trajectory = protocols.from_steps("blocks", steps).expand(config.actuators)
    assert check(config, trajectory) == ()
    assert trajectory.duration_s == pytest.approx(2 + BLOCK_S * len(found))
    driven = {actuator for segment in trajectory.segments for actuator in segment.actuators}
    assert driven == set(every)


def frequencies_hz(config: RigConfig) -> set[float]:
    return {step["sine"]["frequency_hz"] for block in blocks(config) for step in block.steps if "sine" in step}


def test_fast_sinusoids_need_a_regulator_that_follows() -> None:
    config = load("mock")
    control = config.control.model_copy(update={"bandwidth_hz": 4.0})
    assert max(frequencies_hz(config)) == 5.0
    assert max(frequencies_hz(config.model_copy(update={"control": control}))) == 3.2


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--criterion", "e"], "one of d, minimax"),
        (["--duration-s", "3"], "8 to"),
        (["--free", "shear"], "did you mean shear_ratio"),
    ],
)
def test_bad_input_gets_one_message(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "design.yaml"
    assert status_of("design", "--rig", "mock", "--to", file, *words) == 2
    assert said in " ".join(capsys.readouterr().err.split())
    assert not file.exists()
