"""Packages with plug-ins, installed by laying their metadata on the path as an installer does."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from rig.hardware.installed_drivers import REGISTRIES


def install(
    site: Path, package: str, entry_points: Mapping[str, str], modules: Mapping[str, str], version: str = "1.0"
) -> None:
    """Install a package into a folder: `entry_points` by 'group name', `modules` are texts by file name."""
    about = site / f"{package.replace('-', '_')}-{version}.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: {version}\n")
    lines = (f"[{key.split()[0]}]\n{key.split()[1]} = {value}\n" for key, value in entry_points.items())
    (about / "entry_points.txt").write_text("".join(lines))
    for name, text in modules.items():
        (site / name).write_text(text, encoding="utf-8")


def use(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put the folder on the path for one test; nothing loaded from it outlives the test."""
    monkeypatch.syspath_prepend(site)
    for registry in REGISTRIES:
        monkeypatch.setattr(registry, "_loaded", {})
