"""What softrig relies on between the outputs of a card and its pressure sensors."""

from __future__ import annotations

import time
from contextlib import closing

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array
from model.units import PA_PER_BAR
from rig.config.drivers import Reality
from rig.conformance.card_subject import CardSubject, needs_outputs, polled
from rig.conformance.check import Check, NonconformityError, NotApplicableError
from rig.hardware.bench import Bench
from rig.hardware.cards.base import Card
from rig.hardware.vent_verification import VENTED_TOLERANCE_PA, VentVerification, real_time
from rig.valves.base import RegulatorState, ValveSection

TARGET = 0.5
"""Pressure to reach, as a share of the limit of the rig."""
LEAST, MOST = 0.5, 1.5
"""Shares of that pressure between which a sensor must be."""


def pressures(subject: CardSubject) -> str:
    """Each valve brings its own chambers to the pressure that its output stands for, and no others."""
    valves = _measured_valves(subject)
    supplied = subject.config.cards[subject.name].reality is not Reality.REAL
    found = []
    with closing(subject.open()) as card:
        card.start()
        sensors = Bench(subject.config, {subject.name: card})
        for output, valve in valves.items():
            _vent(subject, card, sensors)
            reached_pa = _pressurised(subject, card, sensors, output, valve)
            own = [a - 1 for a in valve.actuators]
            raised = np.abs(reached_pa - valve.vented_pa) >= VENTED_TOLERANCE_PA
            if not raised.any() and not supplied:
                raise NotApplicableError("no pressure rises: the valves have no supply")
            _judge(subject, valve, reached_pa, raised)
            found += [f"{p / PA_PER_BAR:.2f}" for p in reached_pa[own]]
    return f"{len(valves)} valves one by one, {', '.join(found)} bar for {_target_pa(subject) / PA_PER_BAR:.2f} bar"


def vented(subject: CardSubject) -> str:
    """Once the venting outputs are written, the sensors show that the chambers are empty."""
    _measured_valves(subject)
    with closing(subject.open()) as card:
        card.start()
        for _ in polled(card, subject.period_s, subject.timing.sample_s):
            card.write(subject.outputs(TARGET))  # the heartbeat of a device that vents by itself
        return _vent(subject, card, Bench(subject.config, {subject.name: card}))


def _measured_valves(subject: CardSubject) -> dict[int, ValveSection]:
    """Valves of the card, by output, whose chambers all have a sensor on it."""
    needs_outputs(subject)
    measured = {sensor.actuator for sensor in subject.config.sensors if sensor.card == subject.name}
    valves = {i: valve for i, valve in enumerate(subject.valves) if measured.issuperset(valve.actuators)}
    if not valves:
        raise NotApplicableError("no pressure sensor of these valves is on this card")
    return valves


def _target_pa(subject: CardSubject) -> float:
    return TARGET * subject.config.limits.pressure_bar * PA_PER_BAR


def _pressurised(subject: CardSubject, card: Card, sensors: Bench, output: int, valve: ValveSection) -> Array:
    """The pressures (N,) [Pa] after a valve has regulated towards the target, with the others vented."""
    regulator = valve.regulator(subject.config.limits, subject.config.control)
    target_pa = _target_pa(subject)
    outputs = np.array([v.vent_output for v in subject.valves])
    state, measured_pa = RegulatorState(integral_pa_s=0.0), sensors.read().pressure_pa
    until = time.monotonic() + subject.timing.pressurised_s
    while time.monotonic() < until:
        if len(new_pa := sensors.read().pressure_pa):
            measured_pa = new_pa
        if len(measured_pa):
            own_pa = float(measured_pa[-1, valve.actuators[0] - 1])
            state = regulator.command(state.integral_pa_s, subject.period_s, own_pa, target_pa, 0.0)
            outputs[output] = state.output
            card.write(outputs)
        time.sleep(subject.period_s)
    if not len(measured_pa):
        raise NonconformityError(f"no scan in {subject.timing.pressurised_s:g} s")
    return np.asarray(measured_pa[-1])


def _judge(subject: CardSubject, valve: ValveSection, reached_pa: Array, raised: NDArray[np.bool_]) -> None:
    """Raise NonconformityError where the pressures are not those that the valve was given."""
    target_pa = _target_pa(subject)
    own = ", ".join(map(str, valve.actuators))
    written = f"{valve.output_unit} for {target_pa / PA_PER_BAR:.2f} bar at actuator {own}"
    for actuator, pressure_pa in enumerate(reached_pa.tolist(), 1):
        reads = f"the sensor of actuator {actuator} reads {pressure_pa / PA_PER_BAR:.2f} bar"
        if actuator in valve.actuators and not LEAST * target_pa <= pressure_pa <= MOST * target_pa:
            raise NonconformityError(f"{written} were written and {reads}: in which unit, to which channel?")
        if actuator not in valve.actuators and raised[actuator - 1]:
            raise NonconformityError(f"{written} were written and {reads}: are two channels swapped?")


def _vent(subject: CardSubject, card: Card, sensors: Bench) -> str:
    """Write the outputs that vent, and wait until the sensors show it; return what they show."""
    card.write(subject.safe.vented)
    config = subject.config.model_copy(update={"valves": tuple(_measured_valves(subject).values())})
    verification = VentVerification(config, sensors, vent=True, since_ns=time.monotonic_ns())
    outcome = verification.outcome(real_time(lambda: None))
    if not outcome.confirmed:
        raise NonconformityError(outcome.sentence)
    return outcome.sentence.partition(", actuator")[0]


PRESSURE_CHECKS: tuple[Check[CardSubject], ...] = (
    Check("pressures", "a valve brings its own chambers to the set-point, and no others", pressures),
    Check("vented", "once the venting outputs are written, the pressure sensors show empty chambers", vented),
)
