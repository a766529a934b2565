"""Data-acquisition cards from the kernel: PCI bus, drivers, /proc/comedi. No device is opened."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

_ATTACHED = re.compile(r"\s*(?P<minor>\d+): (?P<driver>\S+)\s+(?P<board>.+?)\s+(?P<subdevices>\d+)\s*")


@dataclass(frozen=True)
class AttachedDevice:
    """A card that is attached to a driver."""

    minor: int
    driver: str
    board: str

    @property
    def node(self) -> str:
        return f"/dev/comedi{self.minor}"


@dataclass(frozen=True)
class ComediModule:
    """/proc/comedi: the cards that are attached, and the drivers that are loaded."""

    version: str
    attached: tuple[AttachedDevice, ...]
    drivers: tuple[str, ...]


@dataclass(frozen=True)
class PciCard:
    """A card on the PCI bus, its `driver`, and the `modules` of this kernel that support it."""

    slot: str
    device: str
    driver: str
    modules: tuple[str, ...]


def comedi(root: Path = Path("/")) -> ComediModule | None:
    """Read /proc/comedi; None where no part of Comedi is loaded."""
    try:
        first, *lines = (root / "proc/comedi").read_text().splitlines()
    except (OSError, ValueError):
        return None
    attached = tuple(
        AttachedDevice(int(found["minor"]), found["driver"], found["board"])
        for line in lines
        if (found := _ATTACHED.fullmatch(line))
    )
    # The name of a driver is a line that ends with a colon; its boards follow, each after a blank.
    drivers = tuple(line[:-1] for line in lines if re.fullmatch(r"\S+:", line))
    return ComediModule(first.removeprefix("comedi version "), attached, drivers)


def boards_called(name: str) -> list[AttachedDevice]:
    """The attached cards with this name of a board."""
    return [card for card in attached_cards() if card.board.casefold() == name.casefold()]


def attached_cards() -> tuple[AttachedDevice, ...]:
    """The cards that are attached to a driver."""
    known = comedi()
    return known.attached if known else ()


def pci_cards(vendor: str, release: str, root: Path = Path("/")) -> tuple[PciCard, ...]:
    """Cards of a vendor (`0x13fe`), with the modules that kernel `release` has for each."""
    cards = []
    aliases = _aliases(root / "lib/modules" / release)
    for folder in sorted((root / "sys/bus/pci/devices").glob("*")):
        try:
            of, device = ((folder / name).read_text().strip() for name in ("vendor", "device"))
            alias = (folder / "modalias").read_text().strip()
        except OSError:
            continue
        if of == vendor:
            driver = (folder / "driver").resolve().name if (folder / "driver").exists() else ""
            modules = tuple(dict.fromkeys(module for pattern, module in aliases if fnmatchcase(alias, pattern)))
            cards.append(PciCard(folder.name, device, driver, modules))
    return tuple(cards)


def _aliases(modules: Path) -> list[tuple[str, str]]:
    """(pattern of a PCI device, module that drives it), as depmod has collected them."""
    try:
        lines = (modules / "modules.alias").read_text().splitlines()
    except OSError:
        return []
    words = [line.split() for line in lines if line.startswith("alias pci:")]
    return [(pattern, module) for _, pattern, module in words]


def processes_with(path: str) -> tuple[int, ...]:
    """Processes that have a device open and are visible to this user."""
    pids, node = set(), os.path.realpath(path)
    for link in Path("/proc").glob("[0-9]*/fd/*"):
        with suppress(OSError):
            if str(link.readlink()) == node:
                pids.add(int(link.parts[2]))
    return tuple(sorted(pids))


def has_module(name: str, release: str, root: Path = Path("/")) -> bool:
    """True where kernel `release` has a module of that name."""
    try:
        listed = (root / "lib/modules" / release / "modules.dep").read_text()
    except OSError:
        return False
    return re.search(rf"/{re.escape(name)}\.ko[.\w]*:", listed) is not None
