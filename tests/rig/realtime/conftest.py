"""A supervisor with its shared memory and processes, on the mock rig; no process is started."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace

import pytest

from rig.execution.plan import NullOperator, RunPlan
from rig.experiment.prepare import prepare
from rig.realtime import supervisor
from rig.realtime.process_group import ProcessGroup
from rig.realtime.shared_state import SharedState
from rig.simulator.registers import Registers
from tests.support.mock_registers import mock_registers


@pytest.fixture(scope="module")
def plan() -> RunPlan:
    return prepare("ramp-a", "mock").plan


@pytest.fixture
def memory(plan: RunPlan) -> Iterator[SharedState]:
    memory = SharedState.create(plan.config)
    yield memory
    os.close(memory.fd)


@pytest.fixture
def group(plan: RunPlan, memory: SharedState) -> ProcessGroup:
    """The processes of a run of that plan; none is started."""
    return ProcessGroup(plan, memory, None, supervisor.PERIOD_S)


@pytest.fixture
def parent(plan: RunPlan) -> Iterator[supervisor.Supervisor]:
    parent = supervisor.Supervisor(plan, NullOperator(), None)
    yield parent
    os.close(parent.memory.fd)


@pytest.fixture
def registers() -> Iterator[Registers]:
    """A mock card with open valves and without a plant."""
    with mock_registers(f"started-{os.getpid()}", 7.0) as registers:
        yield registers


@pytest.fixture
def own_plan(plan: RunPlan, registers: Registers) -> RunPlan:
    """A plan for that card."""
    cards = {
        name: card.model_copy(update={"device": f"started-{os.getpid()}"}) for name, card in plan.config.cards.items()
    }
    return replace(plan, config=plan.config.model_copy(update={"cards": cards}))


@pytest.fixture
def own_parent(own_plan: RunPlan) -> Iterator[supervisor.Supervisor]:
    """A supervisor of a run on the card of `registers`."""
    parent = supervisor.Supervisor(own_plan, NullOperator(), None)
    yield parent
    os.close(parent.memory.fd)
