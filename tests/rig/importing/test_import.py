"""Foreign measurements become archives: what is right arrives exactly, what is wrong is named by its place."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.io import savemat
from scipy.spatial.transform import Rotation

import runs
import tests.support.synthetic_runs as made_up
from rig.importing import import_table
from runs.archive.writer import finalise
from runs.export.exporters import export
from runs.records import DetectionStatus, Status
from runs.report.page import write
from runs.run import Run
from tests.support.budget import examples
from tests.support.command_line import status_of
from tests.support.import_bench import BENCH, BENCH_CSV, SMALL, Bring, complaint, imported_in, warnings_of
from tests.support.shared_data import shared_data

ROOT = Path(__file__).parents[3]
DATED = "title: D\ntime: {column: when, unit: iso}\npressures: {columns: [p], unit: bar, reading: gauge}\n"
EXAMPLE = ROOT / "docs" / "examples" / "stiff-flop.yaml"


@pytest.fixture(scope="module")
def stiff_flop(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The real data set, by the mapping that the documentation shows."""
    folder = tmp_path_factory.mktemp("stiff")
    return runs.open(import_table(shared_data("stiff_flop", "NoLoad.mat"), EXAMPLE, folder, "ada").archive)


def test_a_table_without_a_clock_has_the_stated_period(bring: Bring) -> None:
    mapping = SMALL.replace("time: {column: 0, unit: s}", "time: {period_ms: 25}")
    run = bring("".join(f"{k},0.{k},1,2,3\n" for k in range(4)), mapping)
    assert run.tip.time_s == pytest.approx([0, 0.025, 0.05, 0.075])
    assert run.header.camera_hz == pytest.approx(40)
    assert "two rows at least" in complaint(bring, "0,0.1,1,2,3\n", mapping)


@pytest.mark.parametrize(
    ("time", "expected"),
    [
        ("{period_ms: 25, column: 0, unit: s}", "period_ms is for a table without a clock"),
        ("{column: 0}", "is missing: a column and its unit, or period_ms"),
        ("{period_ms: 0}", "0.001"),
    ],
)
def test_a_time_is_a_column_with_its_unit_or_a_period(bring: Bring, time: str, expected: str) -> None:
    assert expected in complaint(bring, "0,0,1,2,3\n1,0,1,2,3\n", SMALL.replace("{column: 0, unit: s}", time))


class TestStiffFlop:
    def test_every_row_is_imported(self, stiff_flop: Run) -> None:
        assert len(stiff_flop.tip.time_s) == len(stiff_flop.pressure.time_s) == 1094
        assert stiff_flop.header.camera_hz == pytest.approx(20)
        assert stiff_flop.duration_s == pytest.approx(54.65)
        assert (stiff_flop.tip.seen == DetectionStatus.MEASURED).all()
        assert (np.diff(stiff_flop.tip.frame) == 1).all()

    def test_absolute_pressures_become_gauge(self, stiff_flop: Run) -> None:
        measured = stiff_flop.pressure.measured_bar
        np.testing.assert_allclose(measured[:20].mean(axis=0), 0, atol=1e-12)
        np.testing.assert_allclose(measured.max(axis=0), 1.1, atol=0.03)
        ambient = next(q for q in stiff_flop.header.quantities if q.name == "ambient_pressure")
        np.testing.assert_allclose(ambient.value, [1.029, 1.020, 1.038], atol=2e-3)

    def test_the_tip_is_seen_from_the_base_sensor(self, stiff_flop: Run) -> None:
        np.testing.assert_allclose(stiff_flop.tip.measured_mm[0], [1.39 - 0.5, 1.70 - 0.66, -91.36 + 157.19], atol=6e-3)

    def test_a_broken_quaternion_is_reported_in_the_archive(self, stiff_flop: Run) -> None:
        said = warnings_of(stiff_flop)
        assert "z (column 10) repeats y (column 9) in every row" in said
        assert "not used, as the mapping says" in said

    def test_a_broken_quaternion_is_refused_where_it_is_needed(self, bring: Bring) -> None:
        said = complaint(
            bring,
            shared_data("stiff_flop", "NoLoad.mat"),
            EXAMPLE.read_text().replace(", use: ignore", "").replace("rig: stiff-flop-arm.yaml\n", ""),
        )
        assert "no rotation: its norm lies between 1.406 and 1.407" in said
        assert "z (column 10) repeats y (column 9)" in said
        assert "use: ignore" in said

    def test_the_archive_states_that_it_is_an_import(self, stiff_flop: Run) -> None:
        header = stiff_flop.header
        assert (header.executor, header.simulated, header.seed) == ("imported", False, None)
        assert header.operator == "ada"
        assert "NoLoad.mat, SHA-256 71592c3750e22154094ca10c1d9808d222df478bb16b89bb1b8c92c4d02755ff" in header.notes
        assert header.protocol_yaml == EXAMPLE.read_text(encoding="utf-8")
        assert stiff_flop.status is Status.FINISHED
        assert "does not say when the measurement began" in warnings_of(stiff_flop)

    def test_an_import_has_no_model_columns(self, stiff_flop: Run) -> None:
        tip = stiff_flop.tip
        assert not tip.model_ok.any()
        for unknown in (tip.model_mm, tip.error_mm, tip.reprojection_px):
            assert np.isnan(unknown).all()
        np.testing.assert_allclose(tip.covariance_mm2, np.broadcast_to(0.3**2 * np.eye(3), (1094, 3, 3)))
        assert np.isnan(stiff_flop.pressure.setpoint_bar).all()
        assert stiff_flop.pressure.valve_v.shape == (1094, 0)

    def test_an_import_is_verified_reported_and_exported(self, stiff_flop: Run, tmp_path: Path) -> None:
        page = write([stiff_flop.path], tmp_path / "report.html").read_text(encoding="utf-8")
        assert "imported" in page
        for kind, files in (("csv", 5), ("mat", 1)):
            assert len(export(stiff_flop.path, kind, tmp_path)) == files
        (table,) = tmp_path.glob("*-tip.csv")
        assert len(table.read_text(encoding="utf-8").splitlines()) == 1095


class TestAnotherLayout:
    def test_every_quantity_is_converted_to_the_archives_units(self, bring: Bring) -> None:
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

    def test_dates_give_times_and_the_start(self, bring: Bring) -> None:
        text = (
            "when;p\n2024-05-06T07:08:09.125+02:00;0.1\n2024-05-06 07:08:09.150+02:00;0.2\n20240506T050809.175Z;0.3\n"
        )
        run = bring(text, DATED)
        np.testing.assert_allclose(run.pressure.time_s, [0, 0.025, 0.05], atol=1e-12)
        with h5py.File(run.path) as file:
            assert file["entry/start_time"].asstr()[()] == "2024-05-06T05:08:09.125000Z"
        assert warnings_of(run) == ""

    def test_dates_without_a_zone_leave_the_start_to_the_mapping(self, bring: Bring) -> None:
        text = "when;p\n2024-05-06T23:59:59.5;0.1\n2024-05-07T00:00:00.5;0.2\n"
        run = bring(text, DATED)
        np.testing.assert_allclose(run.pressure.time_s, [0, 1], atol=1e-12)
        assert "does not say when the measurement began" in warnings_of(run)
        with h5py.File(bring(text, f"started: 2024-05-06T23:59:59.5+02:00\n{DATED}").path) as file:
            assert file["entry/start_time"].asstr()[()] == "2024-05-06T21:59:59.500000Z"

    def test_a_missing_tip_is_a_row_without_one_and_a_warning(self, bring: Bring) -> None:
        run = bring(BENCH_CSV, BENCH)
        assert run.tip.seen.tolist() == [DetectionStatus.MEASURED, DetectionStatus.MEASURED, DetectionStatus.NO_FRAME]
        assert np.isnan(run.tip.measured_mm[2]).all()
        assert np.isnan(run.tip.uncertainty_mm[2]).all()
        assert "the tip's position is missing in 1 of 3 rows, the first in line 9" in warnings_of(run)

    @pytest.mark.slow
    @examples(12, HealthCheck.function_scoped_fixture)
    @given(data=st.data())
    def test_an_exported_csv_is_imported_unchanged(self, data: st.DataObject, tmp_path: Path) -> None:
        n, actuators = data.draw(st.integers(2, 12)), data.draw(st.integers(1, 4))
        number = st.floats(-1e3, 1e3, allow_nan=False).map(lambda x: round(x, 6))
        steps_us = data.draw(st.lists(st.integers(1, 10_000_000), min_size=n, max_size=n))
        t_us = data.draw(st.integers(-(10**9), 10**9)) + np.cumsum(steps_us)
        gauge = st.floats(-100, 1e3, allow_nan=False).map(lambda x: round(x, 6))
        kpa = np.array(data.draw(st.lists(gauge, min_size=n * actuators, max_size=n * actuators))).reshape(n, -1)
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

    def test_the_tool_centre_point_is_transformed(self, bring: Bring, tmp_path: Path) -> None:
        table, wanted = self.table()
        np.savetxt(tmp_path / "moved.csv", table, fmt="%.17g", delimiter=",")
        run = bring(tmp_path / "moved.csv", self.MAPPING)
        np.testing.assert_allclose(run.tip.measured_mm, wanted, atol=1e-9)
        assert "no rotation" not in warnings_of(run)

    def test_uncertainties_are_rotated_with_the_tip(self, bring: Bring, tmp_path: Path) -> None:
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
        assert run.tip.seen.tolist() == [0, 0, DetectionStatus.NO_FRAME, 0, 0]
        np.testing.assert_allclose(run.tip.measured_mm[[1, 3]], wanted[[1, 3]], atol=1e-9)
        assert "the base's orientation is missing in 1 of 5 rows, the first in line 3" in warnings_of(run)

    def test_a_quaternion_of_another_length_is_refused(self, bring: Bring, tmp_path: Path) -> None:
        table, _ = self.table()
        table[3, 5:9] *= 1.1
        np.savetxt(tmp_path / "moved.csv", table, fmt="%.17g", delimiter=",")
        said = complaint(bring, tmp_path / "moved.csv", self.MAPPING)
        assert "the tip's orientation is no rotation" in said
        assert "in 1 of 5 rows, the first in line 4" in said

    def test_a_repeated_component_of_a_good_quaternion_only_gives_a_warning(self, bring: Bring, tmp_path: Path) -> None:
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
        "pressures: {columns: ['p(:,1)', 'p(:,2)'], unit: bar, reading: absolute, ambient_bar: [1.013, 1.02]}\n"
        "tip: {position: {columns: ['tip(:,1)', 'tip(:,2)', 'tip(:,3)'], unit: m}}\n"
    )
    FIELDS: ClassVar = {
        "t": np.arange(4.0),
        "p": np.linspace(1.013, 2, 8).reshape(4, 2),
        "tip": np.arange(12.0).reshape(4, 3),
    }

    def expect(self, run: Run) -> None:
        np.testing.assert_allclose(run.pressure.measured_bar, self.FIELDS["p"] - [1.013, 1.02], atol=1e-12)
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

    def test_a_missing_variable_is_reported_with_the_existing_ones(self, bring: Bring, tmp_path: Path) -> None:
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
    def test_a_broken_file_gives_one_message(self, bring: Bring, tmp_path: Path, content: bytes) -> None:
        (tmp_path / "b.mat").write_bytes(content)
        assert "b.mat" in complaint(bring, tmp_path / "b.mat", self.VECTORS)

    def test_a_file_that_crashes_its_reader_gives_one_message(self, bring: Bring, tmp_path: Path) -> None:
        savemat(tmp_path / "k.mat", {"a": np.zeros((4, 2))})
        damaged = bytearray((tmp_path / "k.mat").read_bytes())
        # The kind of the variable's name: SciPy 1.17 reads on with it and is killed by a segmentation fault.
        damaged[176] = 255
        (tmp_path / "k.mat").write_bytes(damaged)
        assert "k.mat\n  this" in complaint(bring, tmp_path / "k.mat", self.VECTORS)


def test_what_a_table_does_not_state_is_missing_and_not_zero(bring: Bring) -> None:
    tip = bring(BENCH_CSV, BENCH).tip
    for name in ("camera_skew_us", "model_mm", "error_mm", "reprojection_px"):
        assert np.isnan(tip.values[name]).all(), name


def test_a_mapping_may_declare_the_data_as_simulated(bring: Bring, tmp_path: Path) -> None:
    rows = "0,0.1,1,2,3\n1,0.2,1,2,3\n"
    assert not bring(rows, SMALL).header.simulated
    assert bring(rows, "simulated: true\n" + SMALL.lstrip("\n")).header.simulated


def test_an_export_of_a_simulated_run_is_imported_as_simulated(bring: Bring, tmp_path: Path) -> None:
    mapping = (
        "title: There and back\ntime: {column: time_s, unit: s}\n"
        "pressures: {columns: [measured_1_bar, measured_2_bar, measured_3_bar], unit: bar, reading: gauge}\n"
    )
    for simulated in (True, False):
        made_up.write_journal(tmp_path / f"{simulated}.mcap", duration_s=0.1, pictures=0, simulated=simulated)
        pressure, *_ = export(finalise(tmp_path / f"{simulated}.mcap"), "csv")
        run = bring(pressure, mapping)
        assert run.header.simulated is simulated
        assert ("these rows were not measured" in warnings_of(run)) is simulated


def test_the_command_prints_archives_and_warnings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("one", "two"):
        (tmp_path / f"{name}.csv").write_text("0,0.1,1,2,3\n1,0.2,1,2,3\n")
    (tmp_path / "map.yaml").write_text(SMALL)
    command = ["import", "one.csv", "two.csv", "--mapping", "map.yaml", "--note", "old, dry"]
    monkeypatch.setattr("sys.argv", ["rig", *command])
    assert status_of(*command) == 0
    said = capsys.readouterr()
    archives = [runs.open(tmp_path / line) for line in said.out.splitlines()]
    notes = [run.header.notes.partition(", SHA")[0] for run in archives]
    assert notes == ["old, dry; imported from one.csv", "old, dry; imported from two.csv"]
    # A command that is kept can be given to a shell again.
    assert archives[0].header.command == "rig import one.csv two.csv --mapping map.yaml --note 'old, dry'"
    assert "warning: one.csv: the mapping does not say when" in said.err
    (tmp_path / "map.yaml").write_text(SMALL.replace("unit: s", "unit: h"))
    assert status_of(*command) == 2
    assert "map.yaml:3:25: time, unit" in capsys.readouterr().err
