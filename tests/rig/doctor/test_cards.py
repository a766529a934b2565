"""What `rig doctor` says of cards, on made-up machines: a bus, a kernel, /proc/comedi, and what a survey would find."""

from __future__ import annotations

import platform
import re
from pathlib import Path

import pytest

import rig.config.loader
from rig.config.drivers import Finding
from rig.doctor import cards
from rig.doctor.devices import rig_devices
from rig.hardware.cards.base import CardError
from rig.hardware.cards.comedi_survey import ComediCardSurvey, SubdeviceSurvey
from rig.hardware.cards.kernel_devices import AttachedDevice, ComediModule, comedi, has_module, pci_cards
from tests.support.bus_rig import bus_text

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


CARD = ComediCardSurvey(
    "/dev/comedi11",
    "pci1716",
    "adv_pci1710",
    (("ai", 16), ("ao", 2), ("di", 16), ("do", 16), ("counter", 1)),
    SubdeviceSurvey(16, 16, ((-10.0, 10.0), (0.0, 10.0)), 250_000.0),
    SubdeviceSurvey(2, 16, ((0.0, 5.0), (0.0, 10.0)), None),
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

    def survey(self, *found: ComediCardSurvey) -> None:
        """Let a survey find so much."""
        self._monkeypatch.setattr(cards, "survey", lambda: found)
        self._monkeypatch.setattr(cards, "device_paths", lambda: tuple(one.path for one in found))
        self._monkeypatch.setattr(cards, "require", lambda: None)

    def without_pycomedi(self, *paths: str, failure: CardError | None = None) -> None:
        """Nodes are there, the binding is not."""
        self.binding_fails(CardError("pycomedi is not installed", "run `make comedi`"))
        self._monkeypatch.setattr(cards, "device_paths", lambda: paths)
        self._monkeypatch.setattr(cards, "closed", lambda path: failure)

    def binding_fails(self, error: Exception) -> None:
        """Let the import of pycomedi raise this."""

        def fail() -> None:
            raise error

        self._monkeypatch.setattr(cards, "require", fail)

    def said(self) -> dict[str, Finding]:
        findings = cards.cards(self.root)
        assert all(finding.remedy for finding in findings if finding.verdict != "ok")
        return {finding.topic: finding for finding in findings}


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Machine:
    return Machine(tmp_path, monkeypatch)


def test_proc_comedi_is_read_for_the_cards_attached_and_the_drivers_loaded(machine: Machine) -> None:
    machine.write("proc/comedi", TWO_CARDS)
    cards = (AttachedDevice(0, "comedi_test", "comedi_test"), AttachedDevice(11, "adv_pci1710", "pci1716"))
    assert comedi(machine.root) == ComediModule("0.7.76", cards, ("adv_pci1710", "comedi_test"))
    machine.write("proc/comedi", NOTHING_ATTACHED)
    assert comedi(machine.root) == ComediModule("0.7.76", (), ("adv_pci1710",))


def test_an_empty_proc_comedi_is_no_comedi(machine: Machine) -> None:
    machine.write("proc/comedi", "")
    assert comedi(machine.root) is None


def test_each_board_on_the_bus_is_listed_with_its_driver_and_possible_modules(machine: Machine) -> None:
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


def test_a_driver_that_is_not_loaded_is_named(machine: Machine) -> None:
    machine.board("1711")
    said = machine.said()
    assert said["board"].verdict == "missing"
    assert said["board"].remedy == "sudo modprobe adv_pci1710"
    assert said["Comedi"].verdict == "missing"


def test_for_the_1716_the_source_of_its_driver_is_named(machine: Machine) -> None:
    machine.board("1716")
    said = machine.said()["board"]
    assert "PCI-1716" in said.found
    assert "no driver" in said.found
    assert "Linux-Comedi" in said.remedy


def test_a_board_that_the_kernels_own_driver_knows_needs_a_kernel_that_has_it(machine: Machine) -> None:
    machine.board("1710")
    machine.write(f"lib/modules/{RELEASE}/modules.alias", "")
    said = machine.said()["board"]
    assert "no driver" in said.found
    assert "linux-modules-extra" in said.remedy
    assert "git" not in said.remedy


def test_no_driver_is_promised_for_an_unknown_board(machine: Machine) -> None:
    machine.board("1816")
    said = machine.said()["board"]
    assert "Advantech board 0x1816" in said.found
    assert "another card" in said.remedy
    assert "modprobe" not in said.remedy


def test_the_1716_with_the_out_of_tree_driver_installed_needs_only_modprobe(machine: Machine) -> None:
    machine.board("1716")
    aliases = ALIASES + "alias pci:v000013FEd00001716sv*sd*bc*sc*i* adv_pci1710\n"
    machine.write(f"lib/modules/{RELEASE}/modules.alias", aliases)
    assert machine.said()["board"].remedy == "sudo modprobe adv_pci1710"


def test_a_kernel_without_comedi_is_recognised(machine: Machine) -> None:
    machine.write(f"lib/modules/{RELEASE}/modules.dep", "kernel/fs/ext4/ext4.ko:\n")
    said = machine.said()["Comedi"]
    assert "has no Comedi" in said.found
    assert "linux-image" in said.remedy
    assert "linux-modules-extra" in said.remedy


def test_a_driver_without_a_card_is_reported(machine: Machine) -> None:
    machine.write("proc/comedi", NOTHING_ATTACHED)
    said = machine.said()["Comedi"]
    assert said.verdict == "missing"
    assert "no card is attached" in said.found


def test_a_card_is_reported_with_its_abilities_and_the_order_of_powering_up(machine: Machine) -> None:
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


def test_a_card_without_a_clock_or_outputs_is_reported(machine: Machine) -> None:
    machine.survey(
        ComediCardSurvey("/dev/comedi0", "x", "y", (("ai", 8),), SubdeviceSurvey(8, 12, ((0.0, 5.0),), None), None)
    )
    said = machine.said()
    assert (said["card inputs"].verdict, said["card outputs"].verdict) == ("note", "missing")
    assert "power-up" not in said


def test_for_a_card_without_permission_the_group_to_join_is_named(machine: Machine) -> None:
    machine.write("proc/comedi", TWO_CARDS)
    failure = CardError("no permission to open /dev/comedi11", "`sudo adduser $USER iocard`, then log in again")
    machine.survey(ComediCardSurvey("/dev/comedi11", failure=failure.what, remedy=failure.remedy))
    expected = Finding(
        "card", "missing", "pci1716 (driver adv_pci1710): no permission to open /dev/comedi11", failure.remedy
    )
    assert machine.said()["card"] == expected
    machine.without_pycomedi("/dev/comedi11", failure=failure)
    assert machine.said()["card"] == expected


def test_a_missing_binding_is_reported(machine: Machine) -> None:
    machine.write("proc/comedi", TWO_CARDS)
    machine.without_pycomedi("/dev/comedi0", "/dev/comedi11")
    said = machine.said()
    assert (said["pycomedi"].verdict, said["card"].remedy) == ("missing", "make comedi")


def test_a_device_that_cannot_be_opened_for_an_unknown_reason_still_gets_a_remedy(machine: Machine) -> None:
    machine.without_pycomedi("/dev/comedi0", failure=CardError("/dev/comedi0 cannot be opened: Is a directory"))
    assert "dmesg" in machine.said()["card"].remedy


def test_without_a_card_the_binding_is_not_required(machine: Machine) -> None:
    machine.without_pycomedi()
    said = machine.said()["pycomedi"]
    assert (said.verdict, said.found) == ("note", "pycomedi is not installed")
    assert "make comedi" in said.remedy


def test_a_broken_binding_is_distinguished_from_a_missing_one(machine: Machine) -> None:
    machine.binding_fails(ValueError("numpy.dtype size changed"))
    said = machine.said()["pycomedi"]
    assert said.verdict == "missing"
    assert "numpy.dtype size changed" in said.found
    assert "make comedi" in said.remedy


def test_an_attached_card_without_a_device_node_is_reported(machine: Machine) -> None:
    machine.write("proc/comedi", TWO_CARDS)
    machine.survey()
    said = machine.said()["card"]
    assert said.verdict == "missing"
    assert said.found == "pci1716 (driver adv_pci1710) is attached, and /dev/comedi11 does not exist"


class OpenCard:
    """A card of two outputs that has all that a rig wants."""

    description = "pci1716 (driver adv_pci1710, /dev/comedi11)"
    outputs_there = 2

    def __init__(self, setup: object) -> None:
        self.setup = setup

    def close(self) -> None:
        """Nothing to release."""


def test_the_free_outputs_of_a_sufficient_card_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cards, "ComediCard", OpenCard)
    (said,) = cards.examine_comedi(rig.config.loader.load("pci1716"), "daq")
    assert said.verdict == "ok"
    assert "2 of 2 outputs used, none left" in said.found


def test_a_missing_output_is_reported_with_the_message_of_the_card(monkeypatch: pytest.MonkeyPatch) -> None:
    def lacks(setup: object) -> OpenCard:
        raise CardError("pci1716 has 2 analogue outputs (0 to 1): there is no output 2")

    monkeypatch.setattr(cards, "ComediCard", lacks)
    (said,) = cards.examine_comedi(rig.config.loader.load("pci1716"), "daq")
    assert said.verdict == "missing"
    assert "there is no output 2" in said.found
    assert "another card" in said.remedy


def test_a_valve_that_0_v_opens_to_the_supply_is_pointed_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cards, "ComediCard", OpenCard)
    text = rig.config.loader.text("pci1716").replace(
        "    dead_zone_V: 0.4\n", "    dead_zone_V: 0.4\n    fills: below\n", 1
    )
    _, said = cards.examine_comedi(rig.config.loader.parse(text, "rig.yaml"), "daq")
    assert said.topic == "rig's valve 1"
    assert "FILLS" in said.found
    assert "port 4" in said.remedy


def test_the_devices_of_a_mock_rig_are_not_examined() -> None:
    assert list(rig_devices(rig.config.loader.load("mock"))) == []


def test_a_card_that_the_doctor_cannot_check_is_named() -> None:
    text = re.sub(
        r"daq: \{driver: mock.*?\}", "daq: {driver: serial, device: /dev/ttyACM0, inputs: 4, outputs: 4}", bus_text()
    )
    said, *_ = rig_devices(rig.config.loader.parse(text, "rig.yaml"))
    assert (said.topic, said.verdict) == ("rig's card daq", "note")
    assert "driver serial of softrig" in said.found
    assert "rig test-driver" in said.remedy
