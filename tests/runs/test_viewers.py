"""Programs that people have open an archive, and plot the error over time without being told anything."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas
import pytest
import silx.io
import xarray
from nexusformat import nexus
from silx.io import nxdata

import runs
import tests.support.synthetic_runs as made_up
from runs.archive.writer import ArchiveError, finalise
from runs.export.exporters import export


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("viewers") / "run.mcap"
    made_up.write_journal(path)
    return finalise(path)


def test_silx_plots_the_error_over_time(archive: Path) -> None:
    with silx.io.open(str(archive)) as file:
        shown = nxdata.get_default(file)
        assert shown is not None
        assert shown.group.name == "/entry/tip"
        assert shown.signal_name.startswith("error_mm")
        assert (shown.signal.shape, shown.axes_names) == ((90,), ["time (s)"])


@pytest.mark.parametrize(
    ("group", "signal", "axes", "shape"),
    [
        ("pressure", "measured_bar", ["time", "actuator"], (600, 3)),
        ("tip", "error_mm", ["time"], (90,)),
        ("timing", "lateness_us", ["time"], (600,)),
        ("simulator", "tip_mm", ["time", "axis"], (90, 3)),
        ("backbone", "model_mm", ["time", "station", "axis"], (90, 11, 3)),
    ],
)
def test_every_group_of_data_has_a_plot_of_its_own(
    archive: Path, group: str, signal: str, axes: list[str], shape: tuple[int, ...]
) -> None:
    with silx.io.open(str(archive)) as file:
        shown = nxdata.NXdata(file[f"entry/{group}"])
        assert shown.issues == []
        assert (shown.signal_dataset_name, shown.axes_dataset_names, shown.signal.shape) == (signal, axes, shape)
    data = nexus.nxload(str(archive))[f"entry/{group}"]
    assert (data.nxsignal.nxname, [axis.nxname for axis in data.nxaxes]) == (signal, axes)
    assert data.is_plottable()


def test_nexusformat_plots_the_error_over_time(archive: Path) -> None:
    root = nexus.nxload(str(archive))
    shown = root.plottable_data
    assert shown.nxpath == "/entry/tip"
    assert shown.nxsignal.nxname == "error_mm"
    assert [axis.nxname for axis in shown.nxaxes] == ["time"]
    assert root.entry.title.nxvalue == "Staircase of actuator 1"


@pytest.mark.parametrize("engine", ["h5netcdf", "netcdf4"])
def test_xarray_finds_the_dimensions(archive: Path, engine: str) -> None:
    for group in ("pressure", "tip", "timing", "events", "protocol", "simulator", "backbone", "calibration", "model"):
        with xarray.open_dataset(archive, group=f"entry/{group}", engine=engine) as data:
            data.load()
            assert not [name for name in data.sizes if "phony" in str(name)]
    with xarray.open_dataset(archive, group="entry/tip", engine=engine) as data:
        assert dict(data.sizes) == {"time": 90, "axis": 3, "turn": 3, "component": 6, "actuator": 3, "camera": 1}
        run = runs.open(archive)
        np.testing.assert_array_equal(data.measured_mm.sel(axis="z"), run.tip.measured_mm[:, 2])
        late = data.model_mm.sel(time=slice(1.0, 2.0))
        assert 29 <= late.sizes["time"] <= 31


def test_pandas_reads_the_csv_export(archive: Path, tmp_path: Path) -> None:
    written = {path.stem: path for path in export(archive, "csv", tmp_path)}
    tip = pandas.read_csv(written["run-tip"], index_col="time_s")
    np.testing.assert_array_equal(tip["measured_x_mm"], runs.open(archive).tip.measured_mm[:, 0])


def test_a_run_becomes_a_pandas_table(archive: Path) -> None:
    run = runs.open(archive)
    tip = run.to_pandas("tip")
    np.testing.assert_array_equal(tip["model_x_mm"], run.tip.model_mm[:, 0])
    np.testing.assert_array_equal(tip.index, run.tip.time_s)
    segments = run.to_pandas("segments")
    assert segments.loc[2, "label"] == "step 2"
    assert segments.index.name == "segment"
    with pytest.raises(ArchiveError, match=r"no table 'adaptations'; it has pressure, tip, .*, segments"):
        run.to_pandas("adaptations")


def test_a_run_becomes_an_xarray_dataset(archive: Path) -> None:
    with runs.open(archive).to_xarray("frames") as frames:
        assert dict(frames.sizes) == {"time": 5, "pixel": 2, "corner": 20, "point": 11}


def test_a_missing_package_is_reported_in_one_sentence(archive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for package in ("pandas", "xarray", "h5netcdf"):
        monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ArchiveError, match="pip install pandas"):
        runs.open(archive).to_pandas()
    with pytest.raises(ArchiveError, match="pip install h5netcdf"):
        runs.open(archive).to_xarray()
