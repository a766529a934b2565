"""What `rig doctor` says of the machine: scheduling, memory, processor and disk."""

from __future__ import annotations

import errno
import os
import platform
import resource
from pathlib import Path

import pytest

from rig.doctor import machine
from rig.realtime.scheduling import Scheduling


def test_a_priority_that_only_a_part_of_a_run_could_have_is_not_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    def up_to_50(pid: int, policy: int, param: os.sched_param) -> None:
        if param.sched_priority > 50:
            raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

    monkeypatch.setattr(os, "sched_setscheduler", up_to_50)
    monkeypatch.setattr(resource, "getrlimit", lambda which: (50, 50))
    said = machine.real_time()
    assert said.verdict == "missing"
    assert "up to priority 50, and 60 is wanted" in said.found
    assert " - rtprio 80' to /etc/security/limits.conf" in said.remedy


def test_memory_that_may_not_be_locked_names_the_line_to_add(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "obtainable", lambda: Scheduling.NONE)
    monkeypatch.setattr(resource, "getrlimit", lambda which: (8 << 20, 8 << 20))
    monkeypatch.setattr(os, "getgid", lambda: 0)
    monkeypatch.setattr(os, "getgroups", lambda: [0])
    said = machine.memory_lock()
    assert (said.verdict, said.found) == ("missing", "limited to 8192 KiB")
    assert "'@root - memlock unlimited'" in said.remedy


def test_a_priority_of_the_tip_controller_that_is_not_permitted_names_the_line_to_add(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refused(which: int, who: int, priority: int) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(os, "setpriority", refused)
    monkeypatch.setattr(os, "getgid", lambda: 0)
    monkeypatch.setattr(os, "getgroups", lambda: [0])
    said = machine.niceness()
    assert said.verdict == "note"
    assert "niceness -10 is not permitted" in said.found
    assert "'@root - nice -10'" in said.remedy


@pytest.mark.parametrize(("name", "verdict"), [("x86_64", "ok"), ("aarch64", "missing")])
def test_a_processor_that_reorders_stores_is_reported(name: str, verdict: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(platform, "machine", lambda: name)
    said = machine.processor()
    assert (said.topic, said.verdict) == ("processor", verdict)
    assert said.found.startswith(name)


def test_free_space_and_speed_of_the_disk_are_measured_and_nothing_is_left_on_it(tmp_path: Path) -> None:
    said = machine.disk(tmp_path / "data" / "deep")
    assert f"GB free at {tmp_path}" in said.found
    assert "a megabyte" in said.found
    assert not list(tmp_path.iterdir())


def test_a_slow_disk_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "SLOW_S", 0.0)
    said = machine.disk(tmp_path)
    assert said.verdict == "missing"
    assert "a megabyte took it" in said.found
    assert "--out" in said.remedy


def test_a_folder_without_write_permission_is_reported() -> None:
    said = machine.disk(Path("/sys/kernel"))
    assert said.verdict == "missing"
    assert "/sys/kernel cannot be written: " in said.found
    assert "--out" in said.remedy


def test_a_file_in_place_of_the_folder_is_reported(tmp_path: Path) -> None:
    (tmp_path / "data").write_text("a file")
    said = machine.disk(tmp_path / "data" / "today")
    assert (said.verdict, said.found) == ("missing", f"{tmp_path / 'data'} is a file and no folder")


def test_a_disk_that_refuses_a_write_is_full_whatever_space_it_states(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(fd: int) -> None:
        raise OSError(errno.EDQUOT, os.strerror(errno.EDQUOT))

    monkeypatch.setattr(os, "fsync", full)
    said = machine.disk(tmp_path)
    assert said.verdict == "missing"
    assert "no more is taken" in said.found
    assert "make room" in said.remedy


def test_a_disk_with_little_room_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "ENOUGH_BYTES", 1 << 62)
    said = machine.disk(tmp_path)
    assert (said.verdict, said.remedy.split(",")[0]) == ("missing", "make room")
