"""Set-points from a CSV file."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from protocols.decimals import pa
from protocols.steps.base import HIGHEST_BAR, LOWEST_BAR, PressureStep, SecondsOrNone, Text
from protocols.steps.csv_samples import read_columns
from protocols.trajectory_builder import TrajectoryBuilder
from protocols.waveforms import Samples, Smooth


class Csv(PressureStep):
    """Set-points from a CSV file beside the protocol: a column `time_s` and a column `actuator_N_bar` for each
    actuator. Time counts from the first row. With `lead_in_s` the first values are approached smoothly.
    """

    file: Text = Field(description="path, relative to the protocol's folder")
    between: Literal["linear", "hold"] = Field(default="linear", description="what happens between the rows")
    lead_in_s: SecondsOrNone = 0.0

    def play(self, builder: TrajectoryBuilder) -> None:
        """A smooth transition to the first row, if it takes time, then the rows."""
        waves: tuple[Samples, ...] = builder.data(self)
        label = self.label or self.file
        if self.lead_in_s > 0:
            leads = [
                Smooth(start, wave.values[0], self.lead_in_s)
                for start, wave in zip(builder.level_pa(self.actuators), waves, strict=True)
            ]
            builder.move("lead-in", f"into {label}", self.actuators, self.lead_in_s, leads)
        builder.move("csv", label, self.actuators, waves[0].times_s[-1], waves)

    def read(self, folder: Path) -> tuple[tuple[Samples, ...], dict[str, str]]:
        """The waveform of each actuator, and the text of the file."""
        bounds = {f"actuator_{number}_bar": (LOWEST_BAR, HIGHEST_BAR, "bar") for number in self.actuators}
        (times, *levels), text = read_columns(folder / self.file, bounds)
        held = self.between == "hold"
        return tuple(Samples(times, tuple(map(pa, level)), held) for level in levels), {self.file: text}
