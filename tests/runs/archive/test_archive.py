"""A finished run as an archive: layout, NeXus, units, what is read back, and files that are refused."""

from __future__ import annotations

import dataclasses
import shutil
from datetime import datetime
from pathlib import Path

import h5py
import numpy as np
import pytest

import runs
import tests.support.synthetic_runs as made_up
from runs.archive import digest, layout
from runs.archive.digest import DamagedArchiveError
from runs.archive.writer import ArchiveError, finalise
from runs.columns.declaration import OLDEST_LAYOUT
from runs.journal import journal
from runs.records import DetectionStatus, RunFooter, Status
from tests.support.changed_archive import changed

N, M, K = 600, 90, 5
LAYOUT = {
    "title": ((), "str", ""),
    "start_time": ((), "str", ""),
    "end_time": ((), "str", ""),
    "run_id": ((), "str", ""),
    "status": ((), "str", ""),
    "operator": ((), "str", ""),
    "notes": ((), "str", ""),
    "protocol/yaml": ((), "str", ""),
    "protocol/level_bar": ((3, 3), "f", "bar"),
    "rig/yaml": ((), "str", ""),
    "versions/softrig": ((), "str", ""),
    "git/commit": ((), "str", ""),
    "git/diff": ((), "str", ""),
    "pressure/time": ((N,), "f", "s"),
    "pressure/setpoint_bar": ((N, 3), "f", "bar"),
    "pressure/measured_bar": ((N, 3), "f", "bar"),
    "pressure/valve_V": ((N, 2), "f", "V"),
    "pressure/protocol_time": ((N,), "f", "s"),
    "tip/time": ((M,), "f", "s"),
    "tip/measured_mm": ((M, 3), "f", "mm"),
    "tip/uncertainty_mm": ((M, 3), "f", "mm"),
    "tip/model_mm": ((M, 3), "f", "mm"),
    "tip/error_mm": ((M,), "f", "mm"),
    "tip/reprojection_px": ((M,), "f", "px"),
    "tip/frame": ((M,), "i", ""),
    "timing/lateness_us": ((N,), "f", "us"),
    "timing/overruns": ((N,), "i", ""),
    "timing/dropped_frames": ((), "i", ""),
    "timing/ring_overflows": ((), "i", ""),
    "frames/time": ((K,), "f", "s"),
    "frames/index": ((K,), "i", ""),
    "frames/image": ((K,), "vlen", ""),
    "events/time": ((1,), "f", "s"),
    "events/level": ((1,), "str", ""),
    "events/source": ((1,), "str", ""),
    "events/message": ((1,), "str", ""),
    "calibration/front.lens.fx": ((), "f", "px"),
    "model/youngs_modulus": ((), "f", "Pa"),
    "model/variant": ((), "str", ""),
    "simulator/tip_mm": ((M, 3), "f", "mm"),
}


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    source = tmp_path_factory.mktemp("archive") / "run.mcap"
    made_up.write_journal(source, pictures=K)
    return finalise(source)


def kind(node: h5py.Dataset) -> str:
    if h5py.check_string_dtype(node.dtype):
        return "str"
    return "vlen" if h5py.check_vlen_dtype(node.dtype) else str(node.dtype.kind)


@pytest.mark.parametrize("name", LAYOUT)
def test_every_field_stands_where_the_design_says(path: Path, name: str) -> None:
    with h5py.File(path) as file:
        node = file[f"entry/{name}"]
        assert (node.shape, kind(node), node.attrs.get("units", "")) == LAYOUT[name]


def test_it_is_nexus(path: Path) -> None:
    with h5py.File(path) as file:
        assert file.attrs["NX_class"] == "NXroot"
        assert file["entry"].attrs["NX_class"] == "NXentry"
        followed = file[file.attrs["default"]]
        tip = followed[followed.attrs["default"]]
        assert (tip.name, tip.attrs["NX_class"], tip.attrs["signal"]) == ("/entry/tip", "NXdata", "error_mm")
        assert list(tip.attrs["axes"]) == ["time"]
        for name in ("pressure", "tip", "timing", "simulator"):
            group = file["entry"][name]
            signal = group[group.attrs["signal"]]
            assert [len(group[axis]) for axis in group.attrs["axes"]] == list(signal.shape)
        for name in file["entry"]:
            node = file["entry"][name]
            assert isinstance(node, h5py.Dataset) or node.attrs["NX_class"] in {
                "NXdata",
                "NXcollection",
                "NXsample",
                "NXuser",
            }


def test_every_dimension_has_its_scale(path: Path) -> None:
    unlabelled = []

    def look(name: str, node: h5py.Group | h5py.Dataset) -> None:
        if isinstance(node, h5py.Dataset) and not node.is_scale:
            unlabelled.extend(f"{name}:{i}" for i, dimension in enumerate(node.dims) if len(dimension) != 1)

    with h5py.File(path) as file:
        file.visititems(look)
        assert file["entry/tip/measured_mm"].dims[0][0] == file["entry/tip/time"]
    assert unlabelled == []


def test_the_numbers_are_those_of_the_journal_in_bar_and_mm(path: Path) -> None:
    run = runs.open(path)
    samples, observations = made_up.samples(3.0), made_up.observations(3.0)
    np.testing.assert_allclose(run.pressure.measured_bar * 1e5, samples["measured_pa"], rtol=1e-12)
    np.testing.assert_allclose(run.pressure.time_s, np.arange(N) / 200, atol=1e-9)
    np.testing.assert_array_equal(run.pressure.valve_v, samples["valve_v"])
    np.testing.assert_allclose(run.timing.lateness_us * 1e3, samples["lateness_ns"], rtol=1e-12)
    np.testing.assert_allclose(run.tip.measured_mm, observations["measured_m"] * 1e3, rtol=1e-12)
    np.testing.assert_allclose(run.tip.covariance_mm2, observations["covariance_m2"] * 1e6, rtol=1e-12)
    np.testing.assert_allclose(run.tip.model_mm, observations["model_m"] * 1e3, rtol=1e-12)
    expected = np.linalg.norm(observations["measured_m"] - observations["model_m"], axis=1) * 1e3
    np.testing.assert_allclose(run.tip.error_mm, expected, rtol=1e-9)
    assert run.simulated is not None
    np.testing.assert_allclose(run.simulated.tip_mm, observations["truth_m"] * 1e3, rtol=1e-12)


def test_a_missing_measurement_is_nan_with_a_reason(path: Path) -> None:
    tip = runs.open(path).tip
    lost = np.flatnonzero(tip.seen != DetectionStatus.MEASURED)
    assert list(lost) == [10, 11]
    assert np.isnan(tip.measured_mm[lost]).all()
    assert np.isnan(tip.error_mm[lost]).all()
    assert np.isfinite(tip.model_mm[lost]).all()
    with h5py.File(path) as file:
        assert "1 no_board" in file["entry/tip/seen"].attrs["description"]


def test_the_header_is_read_back_unchanged(path: Path) -> None:
    run, meant = runs.open(path), made_up.header("run", 3.0)
    assert {q.name: repr(q) for q in run.header.quantities} == {q.name: repr(q) for q in meant.quantities}
    assert [i.label for i in run.header.intervals] == [i.label for i in meant.intervals]
    np.testing.assert_allclose([i.level_pa for i in run.header.intervals], [i.level_pa for i in meant.intervals])
    rest = {"quantities": (), "intervals": ()}
    assert dataclasses.replace(run.header, **rest) == dataclasses.replace(meant, **rest)
    assert run.status is Status.FINISHED
    assert run.timing.counters == {"ring_overflows": 0, "missed_deadlines": 2}
    assert run.events[0].message == "armed"
    assert run.events[0].t_ns == made_up.START_NS


def test_start_and_end_are_calendar_times(path: Path) -> None:
    with h5py.File(path) as file:
        start, end = (datetime.fromisoformat(file[f"entry/{n}"].asstr()[()]) for n in ("start_time", "end_time"))
    assert start.isoformat() == "2026-01-02T03:04:05.123456+00:00"
    assert (end - start).total_seconds() == pytest.approx(3.0, abs=2e-6)


def test_the_annotations_of_a_picture_are_read_back(path: Path) -> None:
    run = runs.open(path)
    for k in range(K):
        marks = made_up.marks(k)
        found = run.frames.corners_px[k]
        np.testing.assert_array_equal(found[np.isfinite(found).all(axis=1)], marks.corners_px)
        np.testing.assert_array_equal(run.frames.tip_px[k], marks.tip_px)
        np.testing.assert_array_equal(run.frames.model_px[k], marks.model_px)
        np.testing.assert_array_equal(run.frames.backbone_px[k], marks.backbone_px)


def test_the_backbone_ends_at_the_models_tip(path: Path) -> None:
    run = runs.open(path)
    assert run.backbone is not None
    np.testing.assert_array_equal(run.backbone.time_s, run.tip.time_s)
    np.testing.assert_allclose(run.backbone.model_mm[:, -1], run.tip.model_mm, rtol=1e-6)


def test_pictures_are_read_back_byte_for_byte(path: Path) -> None:
    run = runs.open(path)
    assert [run.picture(k) for k in range(K)] == [made_up.picture(k).data for k in range(K)]
    assert list(run.frames.index) == [0, 3, 6, 9, 12]


def test_truth_is_marked_as_simulated(path: Path, tmp_path: Path) -> None:
    with h5py.File(path) as file:
        assert file["entry/simulated"][()] == 1
        assert "SIMULATED" in file["entry/simulator"].attrs["comment"]
    source = tmp_path / "real.mcap"
    made_up.write_journal(source, simulated=False)
    with h5py.File(finalise(source)) as file:
        assert file["entry/simulated"][()] == 0
        assert "simulator" not in file["entry"]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "it is empty$"),
        (b"no HDF5 at all", "it is no HDF5 file$"),
        (b"\x89HDF\r\n\x1a\n" + bytes(100), "it does not end with its digest, so it was cut off"),
    ],
)
def test_a_file_that_is_not_an_archive_gives_one_message(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "a.h5"
    path.write_bytes(content)
    with pytest.raises(ArchiveError, match=said):
        runs.open(path)


def test_an_archive_that_was_cut_off_is_called_so(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["x"] = np.zeros(10_000)
    path.write_bytes(path.read_bytes()[:40_000])
    with pytest.raises(DamagedArchiveError, match=r"cut off.* copy it again, or rebuild it from its journal"):
        runs.open(path)


def test_foreign_hdf5_is_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = 1
    with pytest.raises(ArchiveError, match="not made by softrig"):
        runs.open(tmp_path / "a.h5")
    digest.seal(tmp_path / "a.h5")
    with pytest.raises(ArchiveError, match="this is not an archive of softrig"):
        runs.open(tmp_path / "a.h5")
    with pytest.raises(ArchiveError, match="no such archive"):
        runs.open(tmp_path / "b.h5")


def test_a_field_that_is_missing_is_named(path: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copy(path, tmp_path / "copy.h5"))
    with changed(copy) as file:
        del file["entry/tip/model_mm"]
    with pytest.raises(ArchiveError, match=r"copy\.h5: entry/tip/model_mm: found nothing, expected 64-bit floats"):
        runs.open(copy)


@pytest.mark.parametrize("newest", [OLDEST_LAYOUT, OLDEST_LAYOUT + 1])
@pytest.mark.parametrize("made", ["a newer", "an older"])
def test_another_layout_is_refused(
    path: Path, tmp_path: Path, made: str, newest: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(layout, "VERSION", newest)
    known = {OLDEST_LAYOUT: f"{newest}", OLDEST_LAYOUT + 1: f"{OLDEST_LAYOUT} to {newest}"}[newest]
    found = {"a newer": newest + 1, "an older": OLDEST_LAYOUT - 1}[made]
    copy = Path(shutil.copy(path, tmp_path / "copy.h5"))
    with changed(copy) as file:
        file.attrs["layout_version"] = found
    with pytest.raises(ArchiveError, match=rf"found layout {found}, expected {known}: {made} softrig made it"):
        runs.open(copy)


def test_texts_that_hdf5_cannot_hold_do_not_lose_a_run(tmp_path: Path) -> None:
    source = tmp_path / "odd.mcap"
    header = dataclasses.replace(made_up.header("odd"), notes="a\0b", git_diff="lone \udc80 byte")
    writer = journal.JournalWriter(source, header)
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, ""))
    run = runs.open(finalise(source))
    assert run.header.notes == "a␀b"
    assert run.header.git_diff == "lone ? byte"


def test_vectors_of_calibration_are_kept_with_a_scale(tmp_path: Path) -> None:
    source = tmp_path / "vector.mcap"
    plain = made_up.header("vector")
    vector = dataclasses.replace(plain.quantities[0], name="translation", value=(1.0, 2.0, 3.0), unit="mm")
    writer = journal.JournalWriter(source, dataclasses.replace(plain, quantities=(vector,)))
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, "", {"a_ring_overflows": 2, "b_ring_overflows": 3}))
    run = runs.open(finalise(source))
    assert run.header.quantities == (vector,)
    assert run.timing.ring_overflows == 5


def test_names_that_hdf5_cannot_hold_lose_no_number(tmp_path: Path) -> None:
    source = tmp_path / "names.mcap"
    plain = made_up.header("names")
    names = ("lens.fx", "lens.fx", "a/b", "", ".", "..")
    odd = tuple(dataclasses.replace(plain.quantities[0], name=n, value=(float(i),)) for i, n in enumerate(names))
    writer = journal.JournalWriter(source, dataclasses.replace(plain, quantities=odd))
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, "", {"": 3}))
    run = runs.open(finalise(source))
    assert {q.value[0]: q.name for q in run.header.quantities} == {
        0.0: "lens.fx",
        1.0: "lens.fx.2",
        2.0: "a.b",
        3.0: "unnamed",
        4.0: "unnamed.2",
        5.0: "unnamed.3",
    }
    assert run.timing.counters == {"unnamed": 3}
