"""What is wrong with foreign measurements, or their mapping, is named by its place."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

import runs
from calibration.identify.errors import NoDataError
from calibration.identify.observations.data import poses_of
from protocols import BadInputError
from rig.config import loader
from rig.identify.initial_setup import rig_of
from runs.records import DetectionStatus
from runs.report.page import write
from tests.support.budget import examples
from tests.support.import_bench import BENCH, BENCH_CSV, SMALL, Bring, complaint, imported_in, warnings_of


class TestBadData:
    ROWS = ("0,0.1,1,2,3", "0.1,0.1,1,2,3", "0.2,0.1,1,2,3", "0.3,0.1,1,2,3")

    def rows(self, *changed: str) -> str:
        return "\n".join([*self.ROWS, *changed]) + "\n"

    @pytest.mark.parametrize(
        ("data", "said"),
        [
            ("0.4,abc,1,2,3", ("data.csv:5: column 1", "abc", "a finite number")),
            ("0.4,inf,1,2,3", ("data.csv:5: column 1", "inf", "a finite number")),
            ("0.4,1_0,1,2,3", ("data.csv:5: column 1", "1_0")),
            ("0.4,0.1,1,2", ("data.csv:5: column 4", "the end of the row")),
            ("0.4,0.1,1,2,3,9", ("data.csv:5", "6 columns", "5 columns")),
            ("0.25,0.1,1,2,3", ("data.csv:5: column 0", "a time after 0.3 s")),
            ("0.3,0.1,1,2,3", ("data.csv:5: column 0", "a time after 0.3 s")),
            (",0.1,1,2,3", ("data.csv:5: column 0", "nothing", "a time")),
            ("1e12,0.1,1,2,3", ("data.csv:5: column 0", "a time of at most")),
        ],
    )
    def test_a_bad_cell_is_named_by_line_and_column(self, bring: Bring, data: str, said: Sequence[str]) -> None:
        mapping = SMALL.replace("{first_column: 0,", "{first_column: 0, delimiter: comma,")
        found = complaint(bring, self.rows(data), mapping)
        for part in said:
            assert part in found

    @pytest.mark.parametrize(
        ("second", "said"),
        [
            ("6.5.2024 07:08:10", "data.csv:3: column 0\n  found     6.5.2024 07:08:10"),
            ("2024-05-06T07:08:10+02:00", "date and time in ISO 8601, as 2026-11-21T14:05:00.250"),
            ("2024-05-06T07:08:08", "a time after 2024-05-06T07:08:09, that of the row before"),
            ("", "found     nothing"),
            ("17.5", "found     17.5"),
        ],
    )
    def test_a_row_with_another_kind_of_date_is_refused(self, bring: Bring, second: str, said: str) -> None:
        mapping = SMALL.split("tip:")[0].replace("unit: s", "unit: iso").replace("{first", "{delimiter: comma, first")
        text = f"2024-05-06T07:08:07,0.1\n2024-05-06T07:08:09,0.1\n{second},0.1\n2024-05-06T07:08:20,0.1\n"
        assert said in complaint(bring, text, mapping)

    def test_a_start_stated_by_both_dates_and_mapping_is_refused(self, bring: Bring) -> None:
        mapping = "started: 2024-05-06T07:08:09Z\n" + SMALL.split("tip:")[0].replace("unit: s", "unit: iso")
        text = "2024-05-06T07:08:07Z,0.1\n2024-05-06T07:08:09Z,0.1\n"
        assert "mapping.yaml:1:10: started" in complaint(bring, text, mapping)

    def test_every_bad_cell_is_reported_at_once(self, bring: Bring) -> None:
        found = complaint(bring, self.rows("0.2,x,1,2,3", "0.5,0.1,1,y,3"))
        assert "5: column 1" in found
        assert "6: column 3" in found
        assert "5: column 0" in found

    def test_a_missing_column_is_named_with_its_neighbours(self, bring: Bring) -> None:
        assert "no column 5" in complaint(bring, self.rows(), SMALL.replace("[2, 3, 4]", "[2, 3, 5]"))
        said = complaint(bring, BENCH_CSV, BENCH.replace("column: clock", "column: cloc"))
        assert "no column 'cloc'" in said
        assert "did you mean clock?" in said

    def test_a_tip_has_three_columns(self, bring: Bring) -> None:
        said = complaint(bring, self.rows(), SMALL.replace("[2, 3, 4]", "[2, 3]"))
        assert "tip, position, columns\n  found     [2, 3]\n  expected  a list of 3 items" in said

    def test_decimal_commas_are_recognised(self, bring: Bring) -> None:
        said = complaint(bring, "0;0,1;1;2;3\n0,1;0,1;1;2;3\n")
        assert "'decimal: comma'" in said

    def test_a_mistake_in_every_row_is_reported_once_for_each_column(self, bring: Bring) -> None:
        rows = "".join(f"0,{k:03d};0,1;1,5;2,5;3,5\n" for k in range(200))
        said = complaint(bring, rows)
        assert said.count("'decimal: comma'") == 5
        assert "data.csv:1: column 0\n  found     0,000, and so in 199 more rows" in said
        assert len(said.splitlines()) == 20

    def test_of_many_bad_cells_of_a_column_some_are_shown_and_all_are_counted(self, bring: Bring) -> None:
        said = complaint(bring, self.rows(*(f"{k},x{k},1,2,3" for k in range(1, 40))))
        assert "found     x1\n" in said
        assert "column 1\n  and 34 more rows like these" in said
        assert "x39" not in said

    def test_commas_cannot_be_decimal_and_between_the_columns(self, bring: Bring) -> None:
        said = complaint(bring, self.rows(), SMALL.replace("header: false", "header: false, decimal: comma"))
        assert "commas that cut each line into 5 columns" in said
        assert "'decimal: point'" in said

    @examples(40, HealthCheck.function_scoped_fixture)
    @given(text=st.text(alphabet='01.,;-e \t\n\r"|nax\0é', max_size=80) | st.binary(max_size=40))
    def test_any_text_gives_at_most_an_error_message(self, text: str | bytes, tmp_path: Path) -> None:
        (tmp_path / "any.csv").write_bytes(text.encode() if isinstance(text, str) else text)
        try:
            made = imported_in(tmp_path, tmp_path / "any.csv", SMALL.split("tip:")[0])
        except BadInputError as bad:
            assert str(bad).startswith(str(tmp_path / "any.csv"))  # noqa: PT017 - either outcome is right
        else:
            assert np.isfinite(runs.open(made.archive).pressure.time_s).all()

    @pytest.mark.parametrize("text", ["", "\n\n", "0,0.1,1,2,3\n"])
    def test_a_file_without_two_rows_is_refused(self, bring: Bring, text: str) -> None:
        assert "rows" in complaint(bring, text) or "empty" in complaint(bring, text)

    def test_no_file_a_folder_and_a_spreadsheet_are_refused(self, bring: Bring, tmp_path: Path) -> None:
        (tmp_path / "x.xlsx").write_bytes(b"PK")
        for path, word in (("none.csv", "no such file"), ("none.mat", "no such file"), ("x.xlsx", "save this sheet")):
            assert word in complaint(bring, tmp_path / path)
        assert "folder" in complaint(bring, tmp_path)

    def test_a_missing_pressure_stays_nan_with_a_warning(self, bring: Bring) -> None:
        run = bring(self.rows("0.4,,1,2,3"), SMALL)
        assert np.isnan(run.pressure.measured_bar[4]).all()
        assert "the pressure of column 1 is missing in 1 of 5 rows, the first in line 5" in warnings_of(run)

    def test_missing_rows_are_counted_as_lost_frames(self, bring: Bring) -> None:
        run = bring(self.rows("0.6,0.1,1,2,3"), SMALL)
        assert run.tip.frame.tolist() == [0, 1, 2, 3, 6]
        assert run.tip.dropped.tolist() == [0, 0, 0, 0, 2]
        assert "2 rows are missing from even time steps, the first after line 4" in warnings_of(run)

    def test_uneven_time_steps_are_reported(self, bring: Bring) -> None:
        run = bring(self.rows("0.35,0.1,1,2,3"), SMALL)
        assert run.tip.frame.tolist() == [0, 1, 2, 3, 4]
        assert "uneven, from 0.05 to 0.1 s" in warnings_of(run)

    def test_absolute_pressures_declared_as_gauge_give_a_warning(self, bring: Bring) -> None:
        run = bring(self.rows().replace(",0.1,", ",1.02,"), SMALL)
        assert "never falls below 1.02 bar: is it absolute?" in warnings_of(run)

    @pytest.mark.parametrize(
        ("old", "new", "said"),
        [
            ("column: 0, unit: s", "column: 0, unit: us", "the rows follow each other by 0.1 us"),
            ("columns: [1], unit: bar", "columns: [1], unit: MPa", "the pressures reach 60 bar"),
            ("columns: [1], unit: bar", "columns: [1], unit: atm", ""),
            ("4], unit: mm", "4], unit: m", "the tip lies 1.44e+05 mm from the base: are unit"),
            ("4], unit: mm", "4], unit: um", "the tip lies 0.144 mm from the base"),
            ("4], unit: mm", "4], unit: in", ""),
            ("title: Small", "title: Small\nrig: one.yaml", ""),
            ("title: Small", "title: Small\nrig: long.yaml", "the rig's arm is 1700 mm long"),
        ],
    )
    def test_units_that_give_implausible_values_give_a_warning(
        self, bring: Bring, tmp_path: Path, old: str, new: str, said: str
    ) -> None:
        own = loader.text("mock-ideal")
        one = own[: own.index("  - type: flow\n    actuators: [2, 3]")] + own[own.index("sensors:") :]
        for line in ("  - {actuator: 2, card: daq, channel: 1}\n", "  - {actuator: 3, card: daq, channel: 2}\n"):
            one = one.replace(line, "")
        one = one.replace("actuator_angles_deg: [0, 120, 240]", "actuator_angles_deg: [0]")
        (tmp_path / "one.yaml").write_text(one)
        (tmp_path / "long.yaml").write_text(one.replace("length_mm: 170", "length_mm: 1700"))
        rows = "".join(f"{k / 10},{k},100,0,{100 + k}\n" for k in range(7))
        mapping = "started: 2026-11-21T12:00:00Z\n" + SMALL.replace(old, new)
        found = warnings_of(bring(rows, mapping))
        assert said in found
        assert said or not found

    def test_gauge_pressures_declared_as_absolute_give_a_warning(self, bring: Bring) -> None:
        run = bring(self.rows(), SMALL.replace("gauge", "absolute, ambient_rows: 2"))
        assert "is 0.1 bar: is it really absolute?" in warnings_of(run)

    def test_an_ambient_pressure_from_moving_rows_gives_a_warning(self, bring: Bring) -> None:
        text = "0,1.0,1,2,3\n0.1,1.1,1,2,3\n"
        run = bring(text, SMALL.replace("gauge", "absolute, ambient_rows: 2"))
        assert "moves by 0.1 bar within the first 2 rows" in warnings_of(run)

    def test_pressures_that_lead_the_tip_are_delayed(self, bring: Bring) -> None:
        text = "0,0.1,1,2,3\n0.1,0.2,1,2,3\n0.2,0.4,1,2,3\n0.3,0.4,1,2,3\n"
        run = bring(text, SMALL.replace("gauge", "gauge, delay_s: 0.15"))
        assert run.pressure.measured_bar[:, 0] == pytest.approx([0.1, 0.1, 0.15, 0.3])
        (delay,) = (q for q in run.header.quantities if q.name == "pressure_delay")
        assert delay.value == (0.15,)

    def test_more_ambient_rows_than_rows_are_refused(self, bring: Bring) -> None:
        assert "4 rows" in complaint(bring, self.rows(), SMALL.replace("gauge", "absolute, ambient_rows: 5"))


class TestMapping:
    @pytest.mark.parametrize(
        ("change", "said"),
        [
            (("unit: bar", "unit: Bar"), ("mapping.yaml:4:33: pressures, unit", "kPa")),
            (("unit: bar", "unit: [bar, bar]"), ("mapping.yaml:4:33", "one for each of the 1 columns")),
            (("reading: gauge", "reading: absolute"), ("mapping.yaml:4", "ambient_rows or ambient_bar")),
            (("reading: gauge", "reading: gauge, ambient_bar: 1"), ("mapping.yaml:4:", "no ambient pressure")),
            (
                ("reading: gauge", "reading: absolute, ambient_bar: [1, 1]"),
                ("mapping.yaml:4", "of the 1 columns, not 2"),
            ),
            (("first_column: 0, ", ""), ("first_column: 0} or 1", "mapping.yaml:2")),
            (("first_column: 0", "first_column: 1"), ("mapping.yaml:3", "because first_column is 1")),
            (("[2, 3, 4]", "[2, 3, 1]"), ("mapping.yaml:5:34", "1 is already used by pressures")),
            (("[2, 3, 4]", "[2, 3]"), ("mapping.yaml:5", "tip, position, columns")),
            (("[2, 3, 4]", "[x, 3, 4]"), ("mapping.yaml:2", "columns by number")),
            (("title: Small", "titel: Small"), ("mapping.yaml:1:1", "did you mean title?")),
            (("title: Small", "title: Small\nstarted: 2024-05-06"), ("mapping.yaml:2:10", "ISO 8601")),
            (("title: Small", "title: Small\nrig: nowhere"), ("nowhere",)),
            (("title: Small", "title: Small\nrig: mock"), ("mapping.yaml:2:6", "a rig with 1 actuators")),
            (("tip: {", "base: {"), ("mapping.yaml:5:7: base", "a tip beside it")),
            (("unit: mm}}", "unit: mm}, offset_mm: [0, 0, 1]}"), ("offset_mm", "an orientation beside it")),
        ],
    )
    def test_a_faulty_mapping_is_named_by_line(
        self, bring: Bring, change: tuple[str, str], said: Sequence[str]
    ) -> None:
        assert change[0] in SMALL
        found = complaint(bring, "0,0,0,0,0\n1,0,0,0,0\n", SMALL.replace(*change))
        for part in said:
            assert part in found

    def test_the_rig_that_it_names_goes_into_the_archive(self, bring: Bring) -> None:
        mapping = SMALL.replace("[1]", "[1, 1, 1]").replace("title: Small", "title: Small\nrig: mock")
        run = bring("0,0.1,1,2,3\n1,0.2,1,2,3\n", mapping)
        assert run.header.rig_name == "mock"
        assert run.header.rig_yaml == loader.text("mock")

    def test_identification_treats_a_run_without_set_points_as_a_motion(self, bring: Bring) -> None:
        rows = "".join(f"{0.1 * i:.1f},{0.01 * i:.2f},1,2,3\n" for i in range(40))
        poses = poses_of(bring(rows, SMALL.replace("unit: mm}}", "unit: mm}, uncertainty_mm: 0.2}")))
        assert poses.moving
        assert len(poses) == 40
        np.testing.assert_allclose(poses.pressure_pa[:, 0], 1e3 * np.arange(40), atol=1e-6)

    def test_identification_needs_the_tips_uncertainty_and_every_pressure(self, bring: Bring) -> None:
        with pytest.raises(NoDataError, match="without an uncertainty"):
            poses_of(bring("0,0.1,1,2,3\n1,0.2,1,2,3\n", SMALL))
        with pytest.raises(NoDataError, match="pressures are missing"):
            poses_of(bring("0,0.1,1,2,3\n1,,1,2,3\n", SMALL.replace("unit: mm}}", "unit: mm}, uncertainty_mm: 0.2}")))

    def test_identification_reports_an_archive_without_rig(self, bring: Bring) -> None:
        with pytest.raises(NoDataError, match="holds no rig; name one in the import's mapping"):
            rig_of(bring("0,0.1,1,2,3\n1,0.2,1,2,3\n", SMALL))

    def test_a_file_without_a_tip_is_an_archive_of_pressures(self, bring: Bring, tmp_path: Path) -> None:
        run = bring("0,0.1\n1,0.2\n", SMALL.split("tip:")[0])
        assert (run.tip.seen == DetectionStatus.NO_FRAME).all()
        np.testing.assert_allclose(run.pressure.measured_bar, [[0.1], [0.2]])
        assert write([run.path], tmp_path / "report.html").exists()
