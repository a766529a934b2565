"""Environments that hold a wheel and what its metadata requires, and nothing else; without a download.

The requirements are links to the packages of the environment that runs the tests.
"""

from __future__ import annotations

import importlib.metadata
import subprocess
import sys
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name


def required(distribution: importlib.metadata.Distribution, extra: str) -> dict[str, importlib.metadata.Distribution]:
    """What a distribution requires with one of its extras ('' for none), by name; without itself."""
    found: dict[str, importlib.metadata.Distribution] = {}
    own = canonicalize_name(distribution.metadata["Name"])
    seen: set[tuple[str, str]] = set()
    waiting = [(distribution, extra)]
    while waiting:
        requiring, with_extra = waiting.pop()
        for line in requiring.requires or ():
            requirement = Requirement(line)
            # Each extra comes with the requirements that need none.
            if requirement.marker is not None and not requirement.marker.evaluate({"extra": with_extra}):
                continue
            name = canonicalize_name(requirement.name)
            found[name] = distribution if name == own else importlib.metadata.distribution(name)
            for one in requirement.extras or {""}:
                if (name, one) not in seen:
                    seen.add((name, one))
                    waiting.append((found[name], one))
    found.pop(own, None)
    return found


def environment(folder: Path, wheel: Path, extra: str) -> Path:
    """Make an environment with the wheel and one of its extras; returns its interpreter."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    (site,) = folder.glob("lib/python*/site-packages")
    options = ("--quiet", "--disable-pip-version-check", "--no-deps", "--no-index")
    subprocess.run([sys.executable, "-m", "pip", "install", *options, "--target", str(site), str(wheel)], check=True)
    (about,) = site.glob("softrig-*.dist-info")
    for one in required(importlib.metadata.PathDistribution(about), extra).values():
        tops = {file.parts[0] for file in one.files or () if file.parts[0] not in ("..", "__pycache__")}
        for top in tops:
            if not (site / top).exists():
                (site / top).symlink_to(Path(str(one.locate_file(top))))
    return folder / "bin" / "python"
