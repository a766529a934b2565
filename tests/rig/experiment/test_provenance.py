"""Provenance of a run: the commit of the code that made it."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from rig.experiment import provenance


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout with one commit and a folder in it."""
    folder = tmp_path / "project"
    (folder / "packages").mkdir(parents=True)
    (folder / "a.txt").write_text("a\n")
    identity = ("-c", "user.name=someone", "-c", "user.email=someone@example.org", "-c", "commit.gpgsign=false")
    for command in (("init", "-q"), ("add", "a.txt"), (*identity, "commit", "-q", "-m", "First")):
        subprocess.run(["git", "-C", str(folder), *command], check=True)
    return folder


@pytest.fixture(autouse=True)
def unread() -> Iterator[None]:
    """The state of git is read again."""
    provenance.git_state.cache_clear()
    yield
    provenance.git_state.cache_clear()


def test_a_checkout_has_its_commit_and_its_changes(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(provenance, "_ROOT", checkout)
    (checkout / "a.txt").write_text("b\n")
    commit, diff = provenance.git_state()
    assert len(commit) == 40
    assert "+b" in diff


def test_packages_inside_the_checkout_of_another_project_have_no_commit(
    checkout: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(provenance, "_ROOT", checkout / "packages")
    assert provenance.git_state() == ("", "")


def test_the_environment_of_git_does_not_choose_another_checkout(
    checkout: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GIT_DIR", str(checkout / ".git"))
    monkeypatch.setattr(provenance, "_ROOT", tmp_path)
    assert provenance.git_state() == ("", "")
