"""Checks of the machine's cards, from the board to its channels, and of a rig's Comedi card."""

from __future__ import annotations

import platform
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from rig.config.drivers import Finding
from rig.config.schema import RigConfig
from rig.hardware.cards.base import CardError, card_setup
from rig.hardware.cards.comedi import ComediCard
from rig.hardware.cards.comedi_device import closed, device_paths, require
from rig.hardware.cards.comedi_survey import ComediCardSurvey, survey
from rig.hardware.cards.kernel_devices import ComediModule, PciCard, comedi, has_module, pci_cards

ADVANTECH = "0x13fe"
FAMILY_DRIVER = "adv_pci1710"
IN_KERNEL = {"0x1710": "PCI-1710", "0x1711": "PCI-1711", "0x1713": "PCI-1713", "0x1731": "PCI-1731"}
BOARDS = {**IN_KERNEL, "0x1716": "PCI-1716"}
WITHOUT_COMEDI = (
    "install what has it: Debian's linux-image-amd64 (not -cloud), Ubuntu's linux-modules-extra-$(uname -r)"
)
OUT_OF_TREE = (
    f"the kernel's own {FAMILY_DRIVER} does not know this board: build the out-of-tree Linux-Comedi drivers "
    "(https://github.com/Linux-Comedi/comedi; docs/how-to/set-up-the-computer.md, The card's driver), "
    f"then sudo modprobe {FAMILY_DRIVER}"
)
ELSEWHERE = (
    "look for it among the drivers of https://github.com/Linux-Comedi/comedi; if there is none, use another card"
)
SEE_DMESG = "dmesg says why; docs/how-to/troubleshoot-a-bench.md"
POWER_UP = (
    "keep the air and the valves' 24 V off until `rig vent --rig FILE` has put the outputs to where they vent; "
    "docs/how-to/build-a-bench.md, Power up, power down"
)
_KINDS = {
    "ai": "analogue in",
    "ao": "analogue out",
    "di": "digital in",
    "do": "digital out",
    "dio": "digital in/out",
    "calib": "calibration",
}


def cards(root: Path = Path("/")) -> tuple[Finding, ...]:
    """Check every card from the PCI bus to its channels. Opens devices to query them; reads and writes no channel."""
    kernel = comedi(root)
    release = platform.release()
    on_bus = pci_cards(ADVANTECH, release, root)
    binding = _binding(kernel)
    return (
        *_boards(on_bus),
        *_drivers(kernel, on_bus, has_module("comedi", release, root)),
        binding,
        *_nodeless(kernel),
        *_devices(kernel, binding.verdict == "ok"),
    )


def _boards(on_bus: tuple[PciCard, ...]) -> list[Finding]:
    other = "dry runs need none; a board of another make is seen once its Comedi driver has it"
    return [_board(card) for card in on_bus] or [Finding("board", "note", "no Advantech board on the PCI bus", other)]


def _board(card: PciCard) -> Finding:
    name = f"{BOARDS.get(card.device, f'Advantech board {card.device}')} in PCI slot {card.slot}"
    if card.driver:
        return Finding("board", "ok", f"{name}, driver {card.driver}")
    if card.modules:
        return Finding("board", "missing", f"{name}: its driver is not loaded", f"sudo modprobe {card.modules[0]}")
    remedy = WITHOUT_COMEDI if card.device in IN_KERNEL else OUT_OF_TREE if card.device in BOARDS else ELSEWHERE
    return Finding("board", "missing", f"{name}: this kernel has no driver for it", remedy)


def _drivers(kernel: ComediModule | None, on_bus: tuple[PciCard, ...], available: bool) -> list[Finding]:
    if kernel is None:
        found = "not loaded"
        remedy = "sudo modprobe the board's driver (for a trial without hardware: comedi_test); dry runs need none"
        if not available:
            found = f"not loaded, and kernel {platform.release()} has no Comedi"
            remedy = f"{WITHOUT_COMEDI}; dry runs need none"
        return [Finding("Comedi", "missing" if on_bus else "note", found, remedy)]
    loaded = f"version {kernel.version}, drivers loaded: {', '.join(kernel.drivers) or 'none'}"
    if not kernel.attached:
        remedy = (
            "the loaded driver supports no board in this machine: load the board's own (PCI boards need no more; "
            "ISA and serial ones are attached with comedi_config)"
        )
        return [Finding("Comedi", "missing", f"{loaded}; no card is attached", remedy)]
    return [Finding("Comedi", "ok", loaded)]


def _binding(kernel: ComediModule | None) -> Finding:
    attached = kernel is not None and bool(kernel.attached)
    try:
        require()
    except CardError as error:
        return Finding("pycomedi", "missing" if attached else "note", error.what, f"{error.remedy}; dry runs need none")
    except Exception as error:  # a build against another NumPy may raise any exception
        found = f"installed, and cannot be imported ({error})"
        return Finding("pycomedi", "missing", found, "pip uninstall pycomedi, then make comedi")
    return Finding("pycomedi", "ok", "installed")


def _nodeless(kernel: ComediModule | None) -> list[Finding]:
    """Return attached cards without a device node."""
    there = device_paths()
    return [
        Finding(
            "card",
            "missing",
            f"{card.board} (driver {card.driver}) is attached, and {card.node} does not exist",
            "sudo udevadm trigger; in a container, pass the device to it",
        )
        for card in (kernel.attached if kernel else ())
        if card.node not in there
    ]


def _devices(kernel: ComediModule | None, queryable: bool) -> list[Finding]:
    if queryable:
        return [finding for found in survey() for finding in _card(found, kernel)]
    findings = []
    for path in device_paths():
        fault = closed(path) or CardError(f"{path} can be opened, but not queried", "make comedi")
        findings.append(Finding("card", "missing", f"{_called(path, kernel)}{fault.what}", fault.remedy or SEE_DMESG))
    return findings


def _called(path: str, kernel: ComediModule | None) -> str:
    """Return the kernel's name of a card that cannot be queried."""
    attached = kernel.attached if kernel else ()
    return next((f"{c.board} (driver {c.driver}): " for c in attached if path == c.node), "")


def _card(found: ComediCardSurvey, kernel: ComediModule | None) -> list[Finding]:
    if found.failure:
        what = f"{_called(found.path, kernel)}{found.failure}"
        return [Finding("card", "missing", what, found.remedy or SEE_DMESG)]
    parts = Counter((kind, channels) for kind, channels in found.subdevices if kind != "unused")
    has = ", ".join(
        f"{f'{times} x ' if times > 1 else ''}{channels} {_KINDS.get(kind, kind)}"
        for (kind, channels), times in parts.items()
    )
    findings = [Finding("card", "ok", f"{found.path}: {found.board}, driver {found.driver}; {has}")]
    if found.inputs is None:
        findings.append(Finding("card inputs", "missing", "no analogue inputs", "sensors need a card that has some"))
    elif found.inputs.fastest_hz is None:
        remedy = "nothing, if one scan in each control period is enough; else a driver that has commands"
        findings.append(Finding("card inputs", "note", f"{found.inputs}, by instruction only", remedy))
    else:
        findings.append(Finding("card inputs", "ok", str(found.inputs)))
    if found.outputs is None:
        findings.append(Finding("card outputs", "missing", "no analogue outputs", "valves need a card that has some"))
    else:
        findings.append(Finding("card outputs", "ok", str(found.outputs)))
        at_zero = "attaching the driver put every output to 0 V, where a 5/3 valve (MPYE) is fully open"
        findings.append(Finding("power-up", "note", at_zero, POWER_UP))
    return findings


def examine_comedi(config: RigConfig, name: str) -> Iterator[Finding]:
    """Check one card against the channels and ranges that the rig uses; opens it, and writes no channel."""
    topic = f"rig's card {name}"
    try:
        opened = ComediCard(card_setup(config, name))
    except CardError as error:
        remedy = error.remedy or f"change card '{name}' of the rig, or use another card"
        yield Finding(topic, "missing", error.what, remedy)
    else:
        used = sum(valve.card == name for valve in config.valves)
        left = opened.outputs_there - used
        yield Finding(
            topic,
            "ok",
            f"{opened.description} has every channel and range that the rig uses; "
            f"{used} of {opened.outputs_there} outputs used, {left or 'none'} left",
        )
        opened.close()
    for number, valve in enumerate(config.valves, 1):
        if valve.card == name and valve.fills_at_power_up:
            yield Finding(
                f"rig's valve {number}",
                "note",
                "at 0 V, where attaching the driver puts it, it FILLS its chamber up to the supply's pressure",
                f"connect the chamber to port 4 (fills: above); until then {POWER_UP}",
            )
