"""Files that other users plant in shared folders cannot harm a run or mislead `rig vent`."""

from __future__ import annotations

import errno
import os
import re
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import rig.config.loader
import rig.hardware.vent
from rig.config.schema import RigConfig
from rig.hardware import lock, runtime_folder
from rig.hardware.cards.base import CardBusyError, CardError
from rig.hardware.lock import cards_locked, held_by_unseen, holders, lock_file
from rig.hardware.running import records
from rig.hardware.runtime_folder import open_private
from rig.hardware.vent_verification import VentOutcome
from rig.realtime.control_socket import socket_paths
from rig.simulator.mock_card import MockCard
from rig.simulator.registers import Registers, path_of
from scripts.rig_process import with_one_opener

OTHER_USER = 65534
NODE = "/dev/full"
"""A device node that every user may open; it stands for the node of a card."""

needs_root = pytest.mark.skipif(os.getuid() != 0, reason="only root can act as a second user")


def another_user(do: Callable[[], None]) -> None:
    """Call a function in a process of another user, and wait for its end."""
    pid = os.fork()
    if pid == 0:
        status = 1
        try:
            os.setgroups([])
            os.setgid(OTHER_USER)
            os.setuid(OTHER_USER)
            do()
            status = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(status)
    assert os.waitpid(pid, 0)[1] == 0


@pytest.fixture
def shared(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder like /dev/shm: everybody can write to it, only the owner of a file can rename or remove it."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o1777)
    monkeypatch.setattr(runtime_folder, "BASE", folder)
    yield folder
    shutil.rmtree(folder)


def mock_rig() -> RigConfig:
    return rig.config.loader.parse(rig.config.loader.text("mock"), "rig.yaml")


def real_text(node: str = NODE) -> str:
    return re.sub(r"device: \S*comedi0", f"device: {node}", rig.config.loader.text("pci1716"))


def real_rig(node: str = NODE) -> RigConfig:
    return rig.config.loader.parse(real_text(node), "rig.yaml")


def test_the_runtime_folder_is_one_and_only_its_user_can_enter_it(shared: Path) -> None:
    folder = runtime_folder.runtime_folder()
    assert folder == shared / f"softrig-{os.getuid()}"
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert runtime_folder.runtime_folder() == folder


@pytest.mark.parametrize("trap", ["link", "file", "folder open to others"])
def test_a_taken_name_of_the_runtime_folder_is_replaced_by_a_random_one(
    shared: Path, tmp_path: Path, trap: str
) -> None:
    usual = shared / f"softrig-{os.getuid()}"
    if trap == "link":
        usual.symlink_to(tmp_path)
    elif trap == "file":
        usual.touch()
    else:
        usual.mkdir()
        usual.chmod(0o777)
    folder = runtime_folder.runtime_folder()
    assert folder.parent == shared
    assert folder != usual
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert runtime_folder.runtime_folder() == folder
    with cards_locked(mock_rig(), "a test"):
        assert holders(mock_rig()) == (os.getpid(),)
    assert not list(tmp_path.iterdir())


def test_a_parent_in_which_others_can_replace_files_is_refused(shared: Path) -> None:
    shared.chmod(0o777)
    with pytest.raises(PermissionError, match="other users can replace the files"):
        runtime_folder.runtime_folder()
    with pytest.raises(CardError, match="other users can replace"), cards_locked(real_rig(), "a test"):
        pass


@needs_root
def test_another_users_folder_of_that_name_is_not_used(shared: Path) -> None:
    another_user(lambda: (shared / "softrig-0").mkdir(mode=0o700))
    folder = runtime_folder.runtime_folder()
    assert folder != shared / "softrig-0"
    with cards_locked(mock_rig(), "a test"):
        assert holders(mock_rig()) == (os.getpid(),)
    # The replacement stays in use after the trap is removed, because a run may use it.
    (shared / "softrig-0").rmdir()
    assert runtime_folder.runtime_folder() == folder


PLACES: dict[str, tuple[Callable[[], Path], Callable[[], object]]] = {
    "lock": (lambda: lock_file(real_rig().cards["daq"]), lambda: cards_locked(real_rig(), "a test").__enter__()),
    "registers made": (lambda: path_of("mock0"), lambda: Registers.create("mock0", 2, 8)),
    "registers used": (lambda: path_of("mock0"), lambda: Registers.attach("mock0")),
    "one opener": (lambda: path_of("mock0").with_suffix(".open"), lambda: _open_alone()),
}


def _open_alone() -> MockCard:
    from rig.hardware.cards.base import card_setup

    text = with_one_opener(rig.config.loader.text("mock"), one_opener=True)
    return MockCard(card_setup(rig.config.loader.parse(text, "rig.yaml"), "daq"))


@pytest.mark.parametrize("trap", ["link", "dangling link", "hard link", "FIFO", "writable by all"])
@pytest.mark.parametrize("place", PLACES)
def test_a_planted_link_fifo_or_file_is_refused_and_never_written(
    shared: Path, tmp_path: Path, place: str, trap: str
) -> None:
    where, opened = PLACES[place]
    victim = tmp_path / "victim"
    if trap != "dangling link":
        victim.write_text("mine")
        victim.chmod(0o644)  # whatever the umask is
    path = where()
    match trap:
        case "link" | "dangling link":
            path.symlink_to(victim)
        case "hard link":
            path.hardlink_to(victim)
        case "FIFO":
            os.mkfifo(path, 0o600)
        case _:
            path.write_text("forged")
            path.chmod(0o666)
    with pytest.raises(CardError, match=re.escape(str(path))):
        opened()
    if trap == "dangling link":
        assert not victim.exists()
    else:
        assert victim.read_text() == "mine"
        assert stat.S_IMODE(victim.stat().st_mode) & 0o022 == 0


@needs_root
def test_a_file_of_another_user_is_not_opened_though_its_mode_is_right(shared: Path) -> None:
    file = shared / "file"
    another_user(lambda: os.close(os.open(file, os.O_CREAT | os.O_RDWR, 0o600)))
    with pytest.raises(PermissionError, match="only this user"):
        open_private(file)


def test_text_in_a_lock_file_names_no_holder(shared: Path) -> None:
    """Only the kernel says who holds a lock. Forged text neither adds a holder nor hides one."""
    config = real_rig()
    path = lock_file(config.cards["daq"])
    path.write_text(f"process {os.getpid()}, protocol forged, since 2026-01-01\n")
    path.chmod(0o600)
    with path.open():
        assert holders(config) == ()
    with cards_locked(config, "a test"):
        path.write_text("process 1, protocol forged, since 2026-01-01\n")
        assert holders(config) == (os.getpid(),)


def test_a_killed_run_locks_nothing_and_keeps_its_record_for_rig_vent(shared: Path, tmp_path: Path) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text(rig.config.loader.text("mock"))
    with holder(file, shared) as process:
        ((run,), _) = records()
        assert (run.process.pid, run.rig, run.purpose) == (process.pid, "mock", "of another process")
        assert run.process.alive
        process.kill()
        process.wait()
        ((killed,), _) = records()
        assert not killed.process.alive
    with cards_locked(mock_rig(), "the next"):
        assert "the next" in [run.purpose for run in records()[0]]
    assert [run.purpose for run in records()[0]] == ["of another process"]


@pytest.mark.parametrize("forged", ["", "[]", '{"purpose": "x"}', '{"purpose": 1, "rig": {"name": 2}}', "\x00" * 99])
def test_a_damaged_record_is_named_with_its_process(shared: Path, forged: str) -> None:
    with cards_locked(mock_rig(), "a test"):
        (record,) = (runtime_folder.runtime_folder() / "rigs").iterdir()
        record.write_text(forged)
        (read, (unreadable,)) = records()
        assert read == ()
        assert unreadable.process.pid == os.getpid()


def test_the_message_names_the_holder_that_the_kernel_reports(shared: Path, tmp_path: Path) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text(real_text())
    with holder(file, shared) as process, pytest.raises(CardError) as refused, cards_locked(real_rig(), "a test"):
        pass
    assert f"in use by another run: process {process.pid} of user" in str(refused.value)
    assert re.search(r"since \d{4}-\d\d-\d\dT", str(refused.value))


HOLD = (
    "import os, sys, time\nfrom pathlib import Path\nimport rig.config.loader\n"
    "from rig.hardware import runtime_folder\nfrom rig.hardware.lock import cards_locked\n"
    "runtime_folder.BASE = Path(sys.argv[2])\n"
    "uid = int(sys.argv[3])\n"
    "config = rig.config.loader.load(sys.argv[1])\n"
    "os.setgroups([]) if uid != os.getuid() else None\nos.setuid(uid)\n"
    "with cards_locked(config, 'of another process'):\n"
    "    print('held', flush=True)\n    time.sleep(60)\n"
)


@contextmanager
def holder(file: Path, base: Path, uid: int = -1) -> Iterator[subprocess.Popen[str]]:
    """A process that holds the cards of a rig; `uid` makes it one of another user."""
    command = [sys.executable, "-c", HOLD, file, base, str(uid if uid >= 0 else os.getuid())]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "held\n"
            yield process
        finally:
            process.kill()


@needs_root
def test_two_users_of_one_card_exclude_each_other(shared: Path, tmp_path: Path) -> None:
    file = tmp_path / "rig.yaml"
    text = re.sub(r"device: \S*comedi0", f"device: {NODE}", rig.config.loader.text("pci1716"))
    file.write_text(text)
    with (
        holder(file, shared, OTHER_USER) as process,
        pytest.raises(CardError, match=rf"in use by another run: process {process.pid} of user"),
        cards_locked(real_rig(), "a test"),
    ):
        pass
    with cards_locked(real_rig(), "a test"):
        assert holders(real_rig()) == (os.getpid(),)


class Outputs:
    """A card that counts how often it is vented."""

    trigger_failure = ""

    def __init__(self, config: RigConfig, card: str) -> None:
        self.vented = 0

    def make_safe(self, *, vent: bool) -> None:
        self.vented += vent

    def arm(self, *, vent: bool = False) -> tuple[str, ...]:
        """Every card has a read-back."""
        self.make_safe(vent=vent)
        return ()

    def close(self) -> None:
        """There is nothing to close."""


@needs_root
@pytest.mark.parametrize("may_signal", [True, False])
def test_vent_reports_a_holder_that_it_cannot_signal(
    shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, may_signal: bool
) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text(re.sub(r"device: \S*comedi0", f"device: {NODE}", rig.config.loader.text("pci1716")))
    monkeypatch.setattr(rig.hardware.vent, "open_safe_state", Outputs)
    monkeypatch.setattr(rig.hardware.vent, "verify_venting", lambda config, vent: VentOutcome(True, ""))
    monkeypatch.setattr(rig.hardware.vent, "ENDED_S", 0.3)
    with holder(file, shared, 0) as process:
        if may_signal:
            rig.hardware.vent.vent(real_rig())
            assert process.wait(20) == -signal.SIGTERM
            return

        def vented_by_another() -> None:
            with pytest.raises(CardError, match=rf"process {process.pid} of user root .* cannot be stopped"):
                rig.hardware.vent.vent(real_rig())

        another_user(vented_by_another)
        assert process.poll() is None


def test_vent_reports_a_holder_that_it_cannot_see(
    shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a container, where the table of locks does not list the processes of the host."""
    file = tmp_path / "rig.yaml"
    file.write_text(re.sub(r"device: \S*comedi0", f"device: {NODE}", rig.config.loader.text("pci1716")))
    monkeypatch.setattr(rig.hardware.vent, "open_safe_state", Outputs)
    monkeypatch.setattr(rig.hardware.vent, "verify_venting", lambda config, vent: VentOutcome(True, ""))
    rig.hardware.vent.vent(real_rig())
    monkeypatch.setattr(lock, "LOCKS", tmp_path / "none")
    with holder(file, shared):
        assert held_by_unseen(real_rig())
        with pytest.raises(CardError, match="cannot see"):
            rig.hardware.vent.vent(real_rig())
    assert not held_by_unseen(real_rig())


def test_a_one_opener_card_is_not_kept_open_by_its_lock(shared: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An open device would keep the control process of the same run out. The driver itself excludes others."""
    opened: list[int] = []
    real_open = os.open

    def one_at_a_time(path: os.PathLike[str] | str, flags: int, mode: int = 0o777) -> int:
        if os.fspath(path) != NODE:
            return real_open(path, flags, mode)
        if any(Path(f"/proc/self/fd/{fd}").exists() for fd in opened):
            raise OSError(errno.EBUSY, os.strerror(errno.EBUSY), NODE)
        opened.append(real_open(path, flags, mode))
        return opened[-1]

    with monkeypatch.context() as patched:
        patched.setattr(lock.os, "open", one_at_a_time)
        with cards_locked(real_rig(), "a test"):
            os.close(one_at_a_time(NODE, os.O_RDWR))
            assert holders(real_rig()) == (os.getpid(),)
            with pytest.raises(CardError, match="in use"), cards_locked(real_rig(), "another"):
                pass
        taken = one_at_a_time(NODE, os.O_RDWR)
        with pytest.raises(CardBusyError), cards_locked(real_rig(), "another"):
            pass
        os.close(taken)


def test_a_missing_card_or_a_file_that_is_not_a_device_is_refused(shared: Path, tmp_path: Path) -> None:
    with pytest.raises(CardError, match="comedi77 does not exist"), cards_locked(real_rig("/dev/comedi77"), "a test"):
        pass
    (tmp_path / "file").touch()
    with pytest.raises(CardError, match="not a device node"), cards_locked(real_rig(str(tmp_path / "file")), "a test"):
        pass


def test_control_sockets_lie_in_a_folder_that_only_their_user_can_enter(shared: Path) -> None:
    folder = socket_paths()
    assert folder.parent == runtime_folder.runtime_folder()
    folder.rmdir()
    folder.symlink_to(shared)
    with pytest.raises(PermissionError):
        socket_paths()
