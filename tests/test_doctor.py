"""What `rig doctor` says of cards, on made-up machines: a bus, a kernel, /proc/comedi, and what a survey would find."""

from __future__ import annotations

import platform
from pathlib import Path

import pytest

import rig.rig_file
from rig import doctor_cards
from rig.daq.base import CardError
from rig.daq.kernel import Attached, Comedi, comedi, has_module, pci_cards
from rig.daq.survey import Found, Lines
from rig.finding import Finding

RELEASE = platform.release()
NOTHING_ATTACHED = """comedi version 0.7.76
format string: "%2d: %-20s %-20s %4d", i, driver_name, board_name, n_subdevices
no devices
adv_pci1710:
 pci1710
 pci1710hg
 pci1711
 pci1713
 pci1731
"""
TWO_CARDS = """comedi version 0.7.76
format string: "%2d: %-20s %-20s %4d", i, driver_name, board_name, n_subdevices
 0: comedi_test          comedi_test             3
11: adv_pci1710          pci1716                 5
adv_pci1710:
 pci1716
comedi_test:
 comedi_test
"""
ALIASES = """# Aliases extracted from modules themselves.
alias pci:v000013FEd00001710sv*sd*bc*sc*i* adv_pci1710
alias pci:v000013FEd00001711sv*sd*bc*sc*i* adv_pci1710
alias usb:v0CF3p9271d*dc*dsc*dp*ic*isc*ip*in* ath9k_htc
"""
CARD = Found(
    "/dev/comedi11",
    "pci1716",
    "adv_pci1710",
    (("ai", 16), ("ao", 2), ("di", 16), ("do", 16), ("counter", 1)),
    Lines(16, 16, ((-10.0, 10.0), (0.0, 10.0)), 250_000.0),
    Lines(2, 16, ((0.0, 5.0), (0.0, 10.0)), None),
)


class Machine:
    """A root folder with what the doctor reads of it."""

    def __init__(self, root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.root = root
        self._monkeypatch = monkeypatch
        self.survey()
        self.write(f"lib/modules/{RELEASE}/modules.dep", "kernel/drivers/comedi/comedi.ko.xz:\n")
        self.write(f"lib/modules/{RELEASE}/modules.alias", ALIASES)

    def write(self, path: str, text: str) -> None:
        file = self.root / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)

    def board(self, device: str, driver: str = "") -> None:
        """Put an Advantech board into a slot."""
        slot = f"sys/bus/pci/devices/0000:03:0{device[-1]}.0"
        self.write(f"{slot}/vendor", "0x13fe\n")
        self.write(f"{slot}/device", f"0x{device}\n")
        self.write(f"{slot}/modalias", f"pci:v000013FEd0000{device}sv000013FEsd0000{device}bc11sc80i00\n")
        if driver:
            there = self.root / "sys/bus/pci/drivers" / driver
            there.mkdir(parents=True)
            (self.root / slot / "driver").symlink_to(there)

    def survey(self, *found: Found) -> None:
        """Let a survey find so much."""
        self._monkeypatch.setattr(doctor_cards, "survey", lambda: found)
        self._monkeypatch.setattr("importlib.util.find_spec", lambda name: object())

    def without_pycomedi(self, *paths: str, trouble: CardError | None = None) -> None:
        """Nodes are there, the binding is not."""
        self._monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
        self._monkeypatch.setattr(doctor_cards, "device_paths", lambda: paths)
        self._monkeypatch.setattr(doctor_cards, "closed", lambda path: trouble)

    def said(self) -> dict[str, Finding]:
        findings = doctor_cards.cards(self.root)
        assert all(finding.remedy for finding in findings if finding.verdict != "ok")
        return {finding.topic: finding for finding in findings}


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Machine:
    return Machine(tmp_path, monkeypatch)


def test_proc_comedi_is_read_for_the_cards_attached_and_the_drivers_loaded(machine: Machine) -> None:
    machine.write("proc/comedi", TWO_CARDS)
    cards = (Attached(0, "comedi_test", "comedi_test"), Attached(11, "adv_pci1710", "pci1716"))
    assert comedi(machine.root) == Comedi("0.7.76", cards, ("adv_pci1710", "comedi_test"))
    machine.write("proc/comedi", NOTHING_ATTACHED)
    assert comedi(machine.root) == Comedi("0.7.76", (), ("adv_pci1710",))


def test_an_empty_proc_comedi_is_no_comedi(machine: Machine) -> None:
    machine.write("proc/comedi", "")
    assert comedi(machine.root) is None


def test_the_bus_tells_each_board_its_driver_and_the_modules_that_would_take_it(machine: Machine) -> None:
    machine.board("1710")
    machine.board("1713", driver="adv_pci1710")
    first, second = pci_cards("0x13fe", RELEASE, machine.root)
    assert (first.device, first.driver, first.modules) == ("0x1710", "", ("adv_pci1710",))
    assert (second.device, second.driver) == ("0x1713", "adv_pci1710")
    assert pci_cards("0x8086", RELEASE, machine.root) == ()


def test_a_module_is_found_whether_it_is_packed_or_not(machine: Machine) -> None:
    for packing in ("", ".xz", ".zst"):
        machine.write(f"lib/modules/{RELEASE}/modules.dep", f"updates/comedi.ko{packing}: updates/pcmcia.ko\n")
        assert has_module("comedi", RELEASE, machine.root)
    assert not has_module("omedi", RELEASE, machine.root)


def test_comedi_that_is_not_loaded_is_loaded_by_modprobe(machine: Machine) -> None:
    said = machine.said()["Comedi"]
    assert (said.verdict, said.found) == ("note", "not loaded")
    assert "sudo modprobe" in said.remedy


def test_a_board_whose_driver_is_not_loaded_names_it(machine: Machine) -> None:
    machine.board("1711")
    said = machine.said()
    assert said["board"].verdict == "missing"
    assert said["board"].remedy == "sudo modprobe adv_pci1710"
    assert said["Comedi"].verdict == "missing"


def test_the_1716_says_where_its_driver_is(machine: Machine) -> None:
    machine.board("1716")
    said = machine.said()["board"]
    assert "PCI-1716" in said.found
    assert "no driver" in said.found
    assert "Linux-Comedi" in said.remedy


def test_the_1716_with_the_out_of_tree_driver_installed_needs_only_modprobe(machine: Machine) -> None:
    machine.board("1716")
    aliases = ALIASES + "alias pci:v000013FEd00001716sv*sd*bc*sc*i* adv_pci1710\n"
    machine.write(f"lib/modules/{RELEASE}/modules.alias", aliases)
    assert machine.said()["board"].remedy == "sudo modprobe adv_pci1710"


def test_a_kernel_without_comedi_is_told_apart(machine: Machine) -> None:
    machine.write(f"lib/modules/{RELEASE}/modules.dep", "kernel/fs/ext4/ext4.ko:\n")
    said = machine.said()["Comedi"]
    assert "has no Comedi" in said.found
    assert "linux-image" in said.remedy


def test_a_driver_that_took_no_card_is_missing_one(machine: Machine) -> None:
    machine.write("proc/comedi", NOTHING_ATTACHED)
    said = machine.said()["Comedi"]
    assert said.verdict == "missing"
    assert "no card is attached" in said.found


def test_a_card_tells_what_it_is_and_can_do_and_in_which_order_to_power_up(machine: Machine) -> None:
    machine.write("proc/comedi", TWO_CARDS)
    machine.survey(CARD)
    said = machine.said()
    assert said["Comedi"].verdict == "ok"
    assert said["card"].found == (
        "/dev/comedi11: pci1716, driver adv_pci1710; "
        "16 analogue in, 2 analogue out, 16 digital in, 16 digital out, 1 counter"
    )
    assert "up to 250 kHz" in said["card inputs"].found
    assert "2 of 16 bit (0 to 5 V, 0 to 10 V)" in said["card outputs"].found
    assert "0 V" in said["power-up"].found
    assert "rig vent" in said["power-up"].remedy


def test_a_card_without_a_clock_or_without_outputs_says_so(machine: Machine) -> None:
    machine.survey(Found("/dev/comedi0", "x", "y", (("ai", 8),), Lines(8, 12, ((0.0, 5.0),), None), None))
    said = machine.said()
    assert (said["card inputs"].verdict, said["card outputs"].verdict) == ("note", "missing")
    assert "power-up" not in said


def test_a_closed_card_is_named_by_the_kernel_and_says_which_group_to_join(machine: Machine) -> None:
    machine.write("proc/comedi", TWO_CARDS)
    trouble = CardError("no permission to open /dev/comedi11", "`sudo adduser $USER iocard`, then log in again")
    machine.survey(Found("/dev/comedi11", trouble=trouble.what, remedy=trouble.remedy))
    expected = Finding(
        "card", "missing", "pci1716 (driver adv_pci1710): no permission to open /dev/comedi11", trouble.remedy
    )
    assert machine.said()["card"] == expected
    machine.without_pycomedi("/dev/comedi11", trouble=trouble)
    assert machine.said()["card"] == expected


def test_a_card_that_only_lacks_the_binding_says_so(machine: Machine) -> None:
    machine.write("proc/comedi", TWO_CARDS)
    machine.without_pycomedi("/dev/comedi0")
    said = machine.said()
    assert (said["pycomedi"].verdict, said["card"].remedy) == ("note", "make comedi")


class OpenCard:
    """A card of two outputs that has all that a rig wants."""

    description = "pci1716 (driver adv_pci1710, /dev/comedi11)"
    outputs_there = 2

    def __init__(self, setup: object) -> None:
        self.setup = setup

    def close(self) -> None:
        """Nothing to release."""


def test_a_rig_whose_card_has_everything_says_how_many_outputs_are_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor_cards, "ComediCard", OpenCard)
    (said,) = doctor_cards.rig_cards(rig.rig_file.load("pci1716"))
    assert said.verdict == "ok"
    assert "2 of 2 outputs used, none left" in said.found


def test_a_rig_whose_card_lacks_an_output_is_told_the_cards_own_words(monkeypatch: pytest.MonkeyPatch) -> None:
    def lacks(setup: object) -> OpenCard:
        raise CardError("pci1716 has 2 analogue outputs (0 to 1): there is no output 2")

    monkeypatch.setattr(doctor_cards, "ComediCard", lacks)
    (said,) = doctor_cards.rig_cards(rig.rig_file.load("pci1716"))
    assert said.verdict == "missing"
    assert "there is no output 2" in said.found
    assert "another card" in said.remedy


def test_a_valve_that_0_v_opens_to_the_supply_is_pointed_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor_cards, "ComediCard", OpenCard)
    text = rig.rig_file.text("pci1716").replace("    dead_zone_V: 0.4\n", "    dead_zone_V: 0.4\n    fills: below\n", 1)
    _, said = doctor_cards.rig_cards(rig.rig_file.parse(text, "rig.yaml"))
    assert said.topic == "rig's valve 1"
    assert "FILLS" in said.found
    assert "port 4" in said.remedy


def test_a_mock_rig_has_no_card_to_look_at() -> None:
    assert doctor_cards.rig_cards(rig.rig_file.load("mock")) == ()
