"""Foreign measurements become archives: what is right arrives exactly, what is wrong is named by its place."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import ClassVar, get_args

import h5py
import numpy as np
import pytest
from beside import shared_data
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.io import savemat
from scipy.spatial.transform import Rotation

import runs
from calibration.identify.data import poses_of
from protocols import BadInput
from rig import config, identified
from rig.importing import Imported, import_table
from rig.mapping import (
    KILOGRAMS,
    METRES,
    PASCALS,
    SECONDS,
    VOLTS,
    LengthUnit,
    Mapping,
    MassUnit,
    PressureUnit,
    TimeUnit,
    VoltUnit,
    load,
)
from runs.archive import verify
from runs.export import export
from runs.records import Level, Seen, Status
from runs.report import write
from runs.run import Run

ROOT = Path(__file__).parent.parent
EXAMPLE = ROOT / "docs" / "examples" / "stiff-flop.yaml"

# Other columns, units, separators and conventions than the example's: gauge kPa, tip already seen from the base.
BENCH = """\
title: Two bellows on the lab bench
started: 2024-05-06T07:08:09+02:00
file: {delimiter: semicolon, decimal: comma, skip_lines: 2, lines_after_header: 1, comment: "%", missing: ["--"]}
time: {column: clock, unit: ms}
pressures: {columns: [right, left], unit: [kPa, mbar], reading: gauge}
setpoints: {columns: [want right, want left], unit: kPa}
valves: {columns: [valve], unit: mV}
weight: {column: load, unit: g}
tip: {position: {columns: [X, Y, Z], unit: [mm, mm, cm]}, uncertainty_mm: [0.1, 0.2, 0.3]}
"""
BENCH_CSV = """\
Bench 3, file 17

Z;clock;valve;want left;want right;left;right;X;Y;remark;load
cm;ms;mV;kPa;kPa;mbar;kPa;mm;mm;;g
16,5;1000,0;5000;10;20;99,5;20,25;1,5;-2,0;start;0
% the operator sneezed
16,25;1050,0;5250;10;20;100,5;20,5;2,5;-2,25;;0

--;1100,0;5500;10;20;101,0;20,75;--;;lost;100
"""

# The shortest mapping; columns by number.
SMALL = """\
title: Small
file: {first_column: 0, header: false}
time: {column: 0, unit: s}
pressures: {columns: [1], unit: bar, reading: gauge}
tip: {position: {columns: [2, 3, 4], unit: mm}}
"""

Bring = Callable[..., Run]


@pytest.fixture
def bring(tmp_path: Path) -> Bring:
    """Imports a text or a file by a mapping and opens the archive."""

    def imported(data: str | Path, mapping: str) -> Run:
        return runs.open(imported_in(tmp_path, data, mapping).archive)

    return imported


def imported_in(folder: Path, data: str | Path, mapping: str) -> Imported:
    file = data if isinstance(data, Path) else folder / "data.csv"
    if isinstance(data, str):
        file.write_text(data, encoding="utf-8")
    (folder / "mapping.yaml").write_text(mapping, encoding="utf-8")
    return import_table(file, folder / "mapping.yaml", folder / "archives")


def warnings_of(run: Run) -> str:
    return "\n".join(event.message for event in run.events if event.level is Level.WARNING)


def complaint(bring: Bring, data: str | Path, mapping: str = SMALL) -> str:
    with pytest.raises(BadInput) as caught:
        bring(data, mapping)
    return str(caught.value)


@pytest.fixture(scope="module")
def stiff_flop(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The real data set, by the mapping that the documentation shows."""
    folder = tmp_path_factory.mktemp("stiff")
    return runs.open(import_table(shared_data("stiff_flop", "NoLoad.mat"), EXAMPLE, folder, "ada").archive)


class TestStiffFlop:
    def test_every_row_arrives(self, stiff_flop: Run) -> None:
        assert len(stiff_flop.tip.time_s) == len(stiff_flop.pressure.time_s) == 1094
        assert stiff_flop.header.camera_hz == pytest.approx(20)
        assert stiff_flop.duration_s == pytest.approx(54.65)
        assert (stiff_flop.tip.seen == Seen.MEASURED).all()
        assert (np.diff(stiff_flop.tip.frame) == 1).all()

    def test_absolute_pressures_become_gauge(self, stiff_flop: Run) -> None:
        measured = stiff_flop.pressure.measured_bar
        np.testing.assert_allclose(measured[:20].mean(axis=0), 0, atol=1e-12)
        np.testing.assert_allclose(measured.max(axis=0), 1.1, atol=0.03)
        ambient = next(q for q in stiff_flop.header.quantities if q.name == "ambient_pressure")
        np.testing.assert_allclose(ambient.value, [1.029, 1.020, 1.038], atol=2e-3)

    def test_the_tip_is_seen_from_the_base_sensor(self, stiff_flop: Run) -> None:
        np.testing.assert_allclose(stiff_flop.tip.measured_mm[0], [1.39 - 0.5, 1.70 - 0.66, -91.36 + 157.19], atol=6e-3)

    def test_the_broken_quaternion_is_said_in_the_archive(self, stiff_flop: Run) -> None:
        said = warnings_of(stiff_flop)
        assert "z (column 10) repeats y (column 9) in every row" in said
        assert "not used, as the mapping says" in said

    def test_a_broken_quaternion_is_refused_where_it_is_needed(self, bring: Bring) -> None:
        said = complaint(
            bring, shared_data("stiff_flop", "NoLoad.mat"), EXAMPLE.read_text().replace(", use: ignore", "")
        )
        assert "no rotation: its norm lies between 1.406 and 1.407" in said
        assert "z (column 10) repeats y (column 9)" in said
        assert "use: ignore" in said

    def test_the_archive_says_that_it_is_no_run_of_softrig(self, stiff_flop: Run) -> None:
        header = stiff_flop.header
        assert (header.executor, header.simulated, header.seed) == ("imported", False, None)
        assert header.operator == "ada"
        assert "NoLoad.mat, SHA-256 71592c3750e22154094ca10c1d9808d222df478bb16b89bb1b8c92c4d02755ff" in header.notes
        assert header.protocol_yaml == EXAMPLE.read_text(encoding="utf-8")
        assert stiff_flop.status is Status.FINISHED
        assert "does not say when the measurement began" in warnings_of(stiff_flop)

    def test_there_is_no_model_and_no_uncertainty_that_nobody_stated(self, stiff_flop: Run) -> None:
        tip = stiff_flop.tip
        assert not tip.model_ok.any()
        for unknown in (tip.model_mm, tip.error_mm, tip.covariance_mm2, tip.reprojection_px):
            assert np.isnan(unknown).all()
        assert np.isnan(stiff_flop.pressure.setpoint_bar).all()
        assert stiff_flop.pressure.valve_v.shape == (1094, 0)

    def test_it_verifies_and_goes_on_to_report_and_exports(self, stiff_flop: Run, tmp_path: Path) -> None:
        assert verify(stiff_flop.path)
        page = write([stiff_flop.path], tmp_path / "report.html").read_text(encoding="utf-8")
        assert "imported" in page
        for kind, files in (("csv", 4), ("mat", 1), ("nc", 1)):
            assert len(export(stiff_flop.path, kind, tmp_path)) == files
        (table,) = tmp_path.glob("*-tip.csv")
        assert len(table.read_text(encoding="utf-8").splitlines()) == 1095


class TestAnotherLayout:
    def test_every_quantity_arrives_in_the_archives_units(self, bring: Bring) -> None:
        run = bring(BENCH_CSV, BENCH)
        np.testing.assert_allclose(run.pressure.time_s, [0, 0.05, 0.1], atol=1e-12)
        np.testing.assert_allclose(run.pressure.measured_bar, [[0.2025, 0.0995], [0.205, 0.1005], [0.2075, 0.101]])
        np.testing.assert_allclose(run.pressure.setpoint_bar, [[0.2, 0.1]] * 3)
        np.testing.assert_allclose(run.pressure.valve_v, [[5], [5.25], [5.5]])
        np.testing.assert_allclose(run.tip.measured_mm[:2], [[1.5, -2, 165], [2.5, -2.25, 162.5]])
        np.testing.assert_allclose(run.tip.uncertainty_mm[:2], [[0.1, 0.2, 0.3]] * 2)
        np.testing.assert_allclose(run.tip.weight_g, [0, 0, 100])
        np.testing.assert_allclose(run.tip.pressure_bar, run.pressure.measured_bar)

    def test_the_start_is_the_stated_one_and_the_files_clock_is_kept(self, bring: Bring) -> None:
        run = bring(BENCH_CSV, BENCH)
        with h5py.File(run.path) as file:
            assert file["entry/start_time"].asstr()[()] == "2024-05-06T05:08:09.000000Z"
        assert run.header.started_t_ns == 1_000_000_000

    def test_a_missing_tip_is_a_row_without_one_and_a_warning(self, bring: Bring) -> None:
        run = bring(BENCH_CSV, BENCH)
        assert run.tip.seen.tolist() == [Seen.MEASURED, Seen.MEASURED, Seen.NO_FRAME]
        assert np.isnan(run.tip.measured_mm[2]).all()
        assert np.isnan(run.tip.uncertainty_mm[2]).all()
        assert "the tip's position is missing in 1 of 3 rows, the first in line 9" in warnings_of(run)

    @settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(data=st.data())
    def test_what_is_written_as_csv_arrives_as_it_was(self, data: st.DataObject, tmp_path: Path) -> None:
        n, actuators = data.draw(st.integers(2, 12)), data.draw(st.integers(1, 4))
        number = st.floats(-1e3, 1e3, allow_nan=False).map(lambda x: round(x, 6))
        steps_us = data.draw(st.lists(st.integers(1, 10_000_000), min_size=n, max_size=n))
        t_us = data.draw(st.integers(-(10**9), 10**9)) + np.cumsum(steps_us)
        kpa = np.array(data.draw(st.lists(number, min_size=n * actuators, max_size=n * actuators))).reshape(n, -1)
        mm = np.array(data.draw(st.lists(number, min_size=3 * n, max_size=3 * n))).reshape(n, 3)
        table = {"t": t_us, **{f"p{i}": kpa[:, i] for i in range(actuators)}, **dict(zip("xyz", mm.T, strict=True))}
        order = data.draw(st.permutations(list(table)))
        mark = data.draw(st.sampled_from([";", "\t", "|", " ", ","]))
        comma = mark != "," and data.draw(st.booleans())
        lines = [mark.join(order)]
        for row in range(n):
            cells = mark.join(repr(table[name][row].item()) for name in order)
            lines.append(cells.replace(".", ",") if comma else cells)
        mapping = (
            f"title: T\nfile: {{decimal: {'comma' if comma else 'point'}}}\ntime: {{column: t, unit: us}}\n"
            f"pressures: {{columns: [{', '.join(f'p{i}' for i in range(actuators))}], unit: kPa, reading: gauge}}\n"
            "tip: {position: {columns: [x, 'y', z], unit: mm}}\n"
        )
        end = data.draw(st.sampled_from(["\n", "\r\n"]))
        (tmp_path / "csv.txt").write_text(end.join(lines), encoding=data.draw(st.sampled_from(["utf-8", "utf-8-sig"])))
        run = runs.open(imported_in(tmp_path, tmp_path / "csv.txt", mapping).archive)
        np.testing.assert_array_equal(run.header.started_t_ns, t_us[0] * 1000)
        np.testing.assert_allclose(run.pressure.time_s, (t_us - t_us[0]) * 1e-6, rtol=1e-12, atol=0.5e-9)
        np.testing.assert_allclose(run.pressure.measured_bar, kpa / 100, rtol=1e-12)
        np.testing.assert_allclose(run.tip.measured_mm, mm, rtol=1e-12)


class TestFrames:
    """The tip in the rod-base frame, from sensors anywhere in the room."""

    N = 5
    MAPPING = SMALL.replace("tip: ", "tip: &tip ").split("tip:")[0] + (
        "tip:\n  position: {columns: [2, 3, 4], unit: mm}\n  orientation: {columns: [5, 6, 7, 8], order: xyzw}\n"
        "  offset_mm: [0, 15, 2]\n  uncertainty_mm: [0.1, 0.2, 0.3]\n"
        "base:\n  position: {columns: [9, 10, 11], unit: mm}\n"
        "  orientation: {columns: [12, 13, 14, 15], order: wxyz}\n  uncertainty_mm: 0.1\n"
        "frame: {translation_mm: [1, 2, 3], rotation_deg: [0, 0, 90], rotation_std_deg: 0.5}\n"
    )

    def table(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """A moving base that carries an arm, and the tool centre points in the rod-base frame."""
        rng = np.random.default_rng(4)
        wanted = rng.uniform(-60, 60, (self.N, 3))
        sensor_in_rod = Rotation.from_rotvec([0, 0, 90], degrees=True)
        base_m, base = rng.uniform(-500, 500, (self.N, 3)), Rotation.random(self.N, random_state=5)
        tip = Rotation.random(self.N, random_state=6)
        from_base = sensor_in_rod.inv().apply(wanted - [1, 2, 3])
        tip_mm = base.apply(from_base) + base_m - tip.apply([0, 15, 2])
        columns = (np.arange(self.N), np.zeros(self.N), tip_mm, tip.as_quat(), base_m, base.as_quat()[:, [3, 0, 1, 2]])
        return np.column_stack(columns), wanted

    def test_the_tool_centre_point_arrives_where_it_was(self, bring: Bring, tmp_path: Path) -> None:
        table, wanted = self.table()
        np.savetxt(tmp_path / "moved.csv", table, fmt="%.17g", delimiter=",")
        run = bring(tmp_path / "moved.csv", self.MAPPING)
        np.testing.assert_allclose(run.tip.measured_mm, wanted, atol=1e-9)
        assert "no rotation" not in warnings_of(run)

    def test_uncertainties_are_turned_with_it(self, bring: Bring, tmp_path: Path) -> None:
        table, wanted = self.table()
        np.savetxt(tmp_path / "moved.csv", table, fmt="%.17g", delimiter=",")
        run = bring(tmp_path / "moved.csv", self.MAPPING)
        base = Rotation.from_quat(table[:, [13, 14, 15, 12]])
        turn = (Rotation.from_rotvec([0, 0, 90], degrees=True) * base.inv()).as_matrix()
        sensors = turn @ np.diag([0.02, 0.05, 0.1]) @ turn.transpose(0, 2, 1)
        lever = wanted - [1, 2, 3]
        tilt = np.radians(0.5) ** 2 * np.array([v @ v * np.eye(3) - np.outer(v, v) for v in lever])
        np.testing.assert_allclose(run.tip.covariance_mm2, sensors + tilt, rtol=1e-9, atol=1e-12)

    def test_a_row_without_orientation_has_no_tip(self, bring: Bring, tmp_path: Path) -> None:
        table, wanted = self.table()
        table[2, 12] = np.nan
        np.savetxt(tmp_path / "moved.csv", table, fmt="%.17g", delimiter=",")
        run = bring(tmp_path / "moved.csv", self.MAPPING)
        assert run.tip.seen.tolist() == [0, 0, Seen.NO_FRAME, 0, 0]
        np.testing.assert_allclose(run.tip.measured_mm[[1, 3]], wanted[[1, 3]], atol=1e-9)
        assert "the base's orientation is missing in 1 of 5 rows, the first in line 3" in warnings_of(run)

    def test_a_quaternion_of_another_length_is_refused(self, bring: Bring, tmp_path: Path) -> None:
        table, _ = self.table()
        table[3, 5:9] *= 1.1
        np.savetxt(tmp_path / "moved.csv", table, fmt="%.17g", delimiter=",")
        said = complaint(bring, tmp_path / "moved.csv", self.MAPPING)
        assert "the tip's orientation is no rotation" in said
        assert "in 1 of 5 rows, the first in line 4" in said

    def test_a_repeated_component_of_a_good_quaternion_is_only_said(self, bring: Bring, tmp_path: Path) -> None:
        table, _ = self.table()
        diagonal = Rotation.from_rotvec(np.outer(np.linspace(0.1, 1, self.N), [1, 0, 1]))
        table[:, 12:] = diagonal.as_quat()[:, [3, 0, 1, 2]]
        np.savetxt(tmp_path / "moved.csv", table, fmt="%.17g", delimiter=",")
        assert "base orientation: component z (column 15) repeats x (column 13)" in warnings_of(
            bring(tmp_path / "moved.csv", self.MAPPING)
        )


class TestMatlab:
    VECTORS = (
        "title: V\nfile: {variable: exp}\ntime: {column: t, unit: s}\n"
        "pressures: {columns: ['p(:,1)', 'p(:,2)'], unit: bar, reading: absolute, ambient_bar: 1.013}\n"
        "tip: {position: {columns: ['tip(:,1)', 'tip(:,2)', 'tip(:,3)'], unit: m}}\n"
    )
    FIELDS: ClassVar = {
        "t": np.arange(4.0),
        "p": np.linspace(1.013, 2, 8).reshape(4, 2),
        "tip": np.arange(12.0).reshape(4, 3),
    }

    def expect(self, run: Run) -> None:
        np.testing.assert_allclose(run.pressure.measured_bar, self.FIELDS["p"] - 1.013, atol=1e-12)
        np.testing.assert_allclose(run.tip.measured_mm, self.FIELDS["tip"] * 1e3)

    def test_fields_of_a_struct_are_columns(self, bring: Bring, tmp_path: Path) -> None:
        savemat(tmp_path / "s.mat", {"exp": {**self.FIELDS, "who": "ada"}, "other": np.eye(3)})
        self.expect(bring(tmp_path / "s.mat", self.VECTORS))

    def test_version_7_3_is_read_too(self, bring: Bring, tmp_path: Path) -> None:
        with h5py.File(tmp_path / "h.mat", "w") as file:
            for name, values in self.FIELDS.items():
                file[f"exp/{name}"] = np.atleast_2d(values).T if name != "t" else values[None]
                file[f"exp/{name}"].attrs["MATLAB_class"] = np.bytes_(b"double")
        self.expect(bring(tmp_path / "h.mat", self.VECTORS))

    def test_what_is_missing_is_named_with_what_there_is(self, bring: Bring, tmp_path: Path) -> None:
        savemat(tmp_path / "s.mat", {"exp": self.FIELDS, "other": np.eye(3)})
        said = complaint(bring, tmp_path / "s.mat", self.VECTORS.replace("variable: exp", "variable: expp"))
        assert "no variable 'expp'" in said
        said = complaint(bring, tmp_path / "s.mat", self.VECTORS.replace("'p(:,2)'", "'p(:,3)'"))
        assert "no column 'p(:,3)'" in said
        assert "p(:,1), p(:,2)" in said

    def test_columns_of_different_length_are_refused(self, bring: Bring, tmp_path: Path) -> None:
        savemat(tmp_path / "s.mat", {"exp": {**self.FIELDS, "p": np.ones((3, 2))}})
        assert "3 rows in column p(:,1)" in complaint(bring, tmp_path / "s.mat", self.VECTORS)

    @pytest.mark.parametrize("content", [b"", b"MATLAB 5.0 MAT-file" + b"\0" * 200, b"\x89HDF\r\n\x1a\n" + b"\0" * 99])
    def test_a_broken_file_is_one_message(self, bring: Bring, tmp_path: Path, content: bytes) -> None:
        (tmp_path / "b.mat").write_bytes(content)
        assert "b.mat" in complaint(bring, tmp_path / "b.mat", self.VECTORS)

    def test_a_file_that_kills_its_reader_is_one_message(self, bring: Bring, tmp_path: Path) -> None:
        savemat(tmp_path / "k.mat", {"a": np.zeros((4, 2))})
        damaged = bytearray((tmp_path / "k.mat").read_bytes())
        # The kind of the variable's name: SciPy 1.17 reads on with it and is killed by a segmentation fault.
        damaged[176] = 255
        (tmp_path / "k.mat").write_bytes(damaged)
        assert "k.mat\n  this" in complaint(bring, tmp_path / "k.mat", self.VECTORS)


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

    def test_every_bad_cell_is_said_at_once(self, bring: Bring) -> None:
        found = complaint(bring, self.rows("0.2,x,1,2,3", "0.5,0.1,1,y,3"))
        assert "5: column 1" in found
        assert "6: column 3" in found
        assert "5: column 0" in found

    def test_a_missing_column_is_named_with_its_neighbours(self, bring: Bring) -> None:
        assert "no column 5" in complaint(bring, self.rows(), SMALL.replace("[2, 3, 4]", "[2, 3, 5]"))
        said = complaint(bring, BENCH_CSV, BENCH.replace("column: clock", "column: cloc"))
        assert "no column 'cloc'" in said
        assert "did you mean clock?" in said

    def test_decimal_commas_are_recognised(self, bring: Bring) -> None:
        said = complaint(bring, "0;0,1;1;2;3\n0,1;0,1;1;2;3\n")
        assert "'decimal: comma'" in said

    @settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(text=st.text(alphabet='01.,;-e \t\n\r"|nax\0é', max_size=80) | st.binary(max_size=40))
    def test_no_text_is_more_than_a_message(self, text: str | bytes, tmp_path: Path) -> None:
        (tmp_path / "any.csv").write_bytes(text.encode() if isinstance(text, str) else text)
        try:
            made = imported_in(tmp_path, tmp_path / "any.csv", SMALL.split("tip:")[0])
        except BadInput as bad:
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

    def test_a_missing_pressure_stays_a_hole_with_a_warning(self, bring: Bring) -> None:
        run = bring(self.rows("0.4,,1,2,3"), SMALL)
        assert np.isnan(run.pressure.measured_bar[4]).all()
        assert "the pressure of column 1 is missing in 1 of 5 rows, the first in line 5" in warnings_of(run)

    def test_missing_rows_are_counted_as_lost_frames(self, bring: Bring) -> None:
        run = bring(self.rows("0.6,0.1,1,2,3"), SMALL)
        assert run.tip.frame.tolist() == [0, 1, 2, 3, 6]
        assert run.tip.dropped.tolist() == [0, 0, 0, 0, 2]
        assert "2 rows are missing from even time steps, the first after line 4" in warnings_of(run)

    def test_uneven_time_steps_are_said(self, bring: Bring) -> None:
        run = bring(self.rows("0.35,0.1,1,2,3"), SMALL)
        assert run.tip.frame.tolist() == [0, 1, 2, 3, 4]
        assert "uneven, from 0.05 to 0.1 s" in warnings_of(run)

    def test_absolute_pressures_called_gauge_are_doubted(self, bring: Bring) -> None:
        run = bring(self.rows().replace(",0.1,", ",1.02,"), SMALL)
        assert "never falls below 1.02 bar: is it absolute?" in warnings_of(run)

    def test_gauge_pressures_called_absolute_are_doubted(self, bring: Bring) -> None:
        run = bring(self.rows(), SMALL.replace("gauge", "absolute, ambient_rows: 2"))
        assert "is 0.1 bar: is it really absolute?" in warnings_of(run)

    def test_an_ambient_pressure_from_moving_rows_is_doubted(self, bring: Bring) -> None:
        text = "0,1.0,1,2,3\n0.1,1.1,1,2,3\n"
        run = bring(text, SMALL.replace("gauge", "absolute, ambient_rows: 2"))
        assert "moves by 0.1 bar within the first 2 rows" in warnings_of(run)

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
        assert run.header.rig_yaml == config.text("mock")

    def test_identification_takes_a_run_without_set_points_for_a_motion(self, bring: Bring) -> None:
        rows = "".join(f"{0.1 * i:.1f},{0.01 * i:.2f},1,2,3\n" for i in range(40))
        poses = poses_of(bring(rows, SMALL.replace("unit: mm}}", "unit: mm}, uncertainty_mm: 0.2}")))
        assert poses.moving
        assert len(poses) == 40
        np.testing.assert_allclose(poses.pressure_pa[:, 0], 1e3 * np.arange(40), atol=1e-6)

    def test_identification_says_that_an_archive_has_no_rig(self, bring: Bring) -> None:
        with pytest.raises(BadInput, match="the rig's YAML"):
            identified.from_runs([bring("0,0.1,1,2,3\n1,0.2,1,2,3\n", SMALL)], (), {})

    def test_a_file_without_a_tip_is_an_archive_of_pressures(self, bring: Bring, tmp_path: Path) -> None:
        run = bring("0,0.1\n1,0.2\n", SMALL.split("tip:")[0])
        assert (run.tip.seen == Seen.NO_FRAME).all()
        np.testing.assert_allclose(run.pressure.measured_bar, [[0.1], [0.2]])
        assert write([run.path], tmp_path / "report.html").exists()


class TestDocumentation:
    PAGE = (ROOT / "docs" / "import.md").read_text(encoding="utf-8")

    def test_its_mappings_are_mappings(self, tmp_path: Path) -> None:
        blocks = re.findall(r"```yaml\n(.*?)```", self.PAGE, re.DOTALL)
        assert len(blocks) == 2
        for block in blocks:
            (tmp_path / "m.yaml").write_text(block, encoding="utf-8")
            load(tmp_path / "m.yaml")

    def test_its_first_mapping_means_the_same_as_the_example(self, tmp_path: Path) -> None:
        block = self.PAGE.split("```yaml\n")[1].split("```")[0]
        (tmp_path / "m.yaml").write_text(block, encoding="utf-8")
        assert load(tmp_path / "m.yaml")[0] == load(EXAMPLE)[0]

    def test_it_names_every_key_and_every_unit(self) -> None:
        schema = Mapping.model_json_schema()
        keys = {key for part in (schema, *schema["$defs"].values()) for key in part["properties"]}
        units = {unit for table in (SECONDS, PASCALS, METRES, KILOGRAMS, VOLTS) for unit in table}
        assert {word for word in keys | units if not re.search(rf"\b{word}\b", self.PAGE)} == set()

    def test_every_unit_that_a_mapping_may_say_is_known(self) -> None:
        for said, known in (
            (TimeUnit, SECONDS),
            (PressureUnit, PASCALS),
            (LengthUnit, METRES),
            (MassUnit, KILOGRAMS),
            (VoltUnit, VOLTS),
        ):
            assert set(get_args(said)) == set(known)

    def test_the_example_tells_editors_its_schema(self) -> None:
        schema = EXAMPLE.read_text(encoding="utf-8").splitlines()[0].removeprefix("# yaml-language-server: $schema=")
        assert (EXAMPLE.parent / schema).resolve() == ROOT / "docs" / "schemas" / "import.schema.json"


def test_the_command_prints_archives_and_warnings(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / f"{name}.csv").write_text("0,0.1,1,2,3\n1,0.2,1,2,3\n")
    (tmp_path / "map.yaml").write_text(SMALL)
    command = [sys.executable, "-m", "rig", "import", "one.csv", "two.csv", "--mapping", "map.yaml", "--note", "old"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    archives = [runs.open(tmp_path / line) for line in done.stdout.splitlines()]
    assert [run.header.notes[:26] for run in archives] == ["old; imported from one.csv", "old; imported from two.csv"]
    assert "warning: one.csv: the mapping does not say when" in done.stderr
    (tmp_path / "map.yaml").write_text(SMALL.replace("unit: s", "unit: h"))
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False, timeout=120)
    assert done.returncode == 2
    assert "map.yaml:3:25: time, unit" in done.stderr
    assert "Traceback" not in done.stderr
