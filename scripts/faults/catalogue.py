"""The faults of the campaign: one object each, in the registry CATALOGUE."""

from __future__ import annotations

from dataclasses import replace

from rig.simulator.faults import CameraFault, SensorFault, ValveFault
from runs.records import Status
from scripts.faults.environment import DAY_NS
from scripts.faults.fault import Fault, FaultRegistry
from scripts.faults.injections import (
    KILL,
    STOP,
    BenchFault,
    ClockStep,
    DiskBlocked,
    DiskFull,
    FileLimit,
    FilesChanged,
    FolderReadOnly,
    ModelUnsolvable,
    RandomProcessSignals,
    Signal,
    StopPressed,
    TerminalBlocked,
    TerminalLost,
)
from scripts.faults.transitions import TransitionAction, TransitionFault
from scripts.faults.trial_run import CONTROL, OBSERVER, PLANT, SUPERVISOR, TIP, TIP_CONTROLLER, WATCHDOG

STUCK_WHERE_IT_IS = float("nan")
FOR_EVER = 10**9
ABORTED, FINISHED = (Status.ABORTED,), (Status.FINISHED,)
RECOVERED, INTERRUPTED = (Status.RECOVERED,), (Status.INTERRUPTED,)
GOES_ON_OR_NOT = (Status.FINISHED, Status.ABORTED)
EITHER = (Status.ABORTED, Status.RECOVERED)
PROCESS_FAULT = "process died|silent|hung|exited before"
PRESSURE = r"sensor 1|actuator 1"


def _sensor(name: str, says: str, **words: float) -> Fault:
    return Fault(name, "sensor", BenchFault(words), ABORTED, says)


def _valve(name: str, says: str, **words: float) -> Fault:
    return Fault(name, "valve and air", BenchFault(words), ABORTED, says)


def _process(
    name: str,
    injection: Signal | RandomProcessSignals,
    ends: tuple[Status, ...],
    says: str,
    remark: str = "",
    within_s: float = 3.0,
) -> Fault:
    return Fault(name, "process", injection, ends, says, virtual=False, within_s=within_s, remark=remark)


def _tip_control(name: str, injection: Signal, ends: tuple[Status, ...], says: str) -> Fault:
    return Fault(name, "tip control", injection, ends, says, virtual=False, bench=TIP)


def _while_tip_is_controlled(camera: Fault) -> Fault:
    """The same fault of the camera while the tip controller steers by it."""
    name = f"{camera.name} while the tip is controlled"
    return replace(camera, name=name, kind="tip control", bench=TIP, virtual=camera is CAMERA_FROZEN)


SENSORS = (
    _sensor("sensor open", "sensor 1 reads 10.000 V", sensor_1=SensorFault.OPEN),
    _sensor("sensor short", PRESSURE, sensor_1=SensorFault.SHORT),
    _sensor("sensor frozen", PRESSURE, sensor_1=SensorFault.FROZEN),
    _sensor("sensor noisy, 0.3 bar", PRESSURE, sensor_1=SensorFault.NOISY, sensor_value_1=30e3),
    _sensor("sensor reads 0.3 bar too much", PRESSURE, sensor_1=SensorFault.OFFSET, sensor_value_1=30e3),
    _sensor("sensor reads 0.3 bar too little", PRESSURE, sensor_1=SensorFault.OFFSET, sensor_value_1=-30e3),
    _sensor(
        "every sensor short",
        r"sensor \d|actuator \d",
        sensor_1=SensorFault.SHORT,
        sensor_2=SensorFault.SHORT,
        sensor_3=SensorFault.SHORT,
    ),
)
AIR = (
    _valve("valve stuck where it is", PRESSURE, valve_1=ValveFault.STUCK, valve_value_1=STUCK_WHERE_IT_IS),
    _valve("valve stuck open", PRESSURE, valve_1=ValveFault.STUCK, valve_value_1=10.0),
    _valve("valve stuck shut", PRESSURE, valve_1=ValveFault.STUCK, valve_value_1=5.0),
    _valve("valve leaking, 60 l/min", PRESSURE, valve_1=ValveFault.LEAKING, valve_value_1=60.0),
    _valve("valve reversed", PRESSURE, valve_1=ValveFault.REVERSED),
    _valve("supply lost", r"sensor \d|actuator \d", supply_lost=1),
    _valve(
        "both valves stuck open",
        r"sensor \d|actuator \d",
        valve_1=ValveFault.STUCK,
        valve_value_1=10.0,
        valve_2=ValveFault.STUCK,
        valve_value_2=10.0,
    ),
)
CARD = (
    Fault("emergency stop pressed", "card", StopPressed({"contact_1": 1}), ABORTED, "emergency stop 'button'"),
    Fault("card: a read fails", "card", BenchFault({"failing_reads": 1}), ABORTED, "inputs cannot be read"),
    Fault("card: three writes fail", "card", BenchFault({"failing_writes": 3}), ABORTED, "outputs cannot be written"),
    Fault(
        "card: no write succeeds any more",
        "card",
        BenchFault({"failing_writes": FOR_EVER}),
        ABORTED,
        "safe state could not be written",
        safe=False,
        remark="no program can help; the message asks the operator to shut the air off",
    ),
    Fault(
        "card reads slowly, 12 ms",
        "card",
        BenchFault({"read_delay_ns": 12e6}),
        FINISHED,
        "of the deadlines are missed",
        virtual=False,
    ),
    Fault("card hangs in a read", "card", BenchFault({"read_delay_ns": 5e9}), ABORTED, "hung", virtual=False),
    Fault("card gives no more scans", "card", BenchFault({"silent": 1}), ABORTED, "no pressure sample"),
    Fault(
        "card overruns, 30 scans",
        "card",
        BenchFault({"lost_scans": 30}),
        FINISHED,
        "30 scans were lost|scans were lost",
    ),
    Fault("card overruns, 2000 scans", "card", BenchFault({"lost_scans": 2000}), ABORTED, "no pressure sample"),
)
CAMERA_FROZEN = Fault(
    "camera frozen", "camera", BenchFault({"camera": CameraFault.FROZEN}), FINISHED, "repeats the same picture"
)
CAMERA = (
    Fault("camera unplugged", "camera", BenchFault({"camera": CameraFault.UNPLUGGED}), ABORTED, "camera"),
    Fault("camera gives no more pictures", "camera", BenchFault({"camera": CameraFault.SILENT}), ABORTED, "camera"),
    CAMERA_FROZEN,
    Fault("camera black", "camera", BenchFault({"camera": CameraFault.BLACK}), FINISHED, "no board in the picture"),
    Fault(
        "camera repeats every picture", "camera", BenchFault({"camera": CameraFault.DUPLICATED}), FINISHED, "repeats"
    ),
    Fault(
        "camera late by 0.4 s",
        "camera",
        BenchFault({"camera": CameraFault.LATE, "camera_delay_ns": 400e6}),
        FINISHED,
        "s old when they are measured",
        virtual=False,
    ),
    Fault(
        "camera drops nine of ten",
        "camera",
        BenchFault({"camera": CameraFault.DROPPING}),
        FINISHED,
        "camera drops pictures",
        virtual=False,
    ),
)
PROCESSES = (
    _process("control killed", Signal((CONTROL,), KILL), ABORTED, "control process died"),
    _process("control stopped", Signal((CONTROL,), STOP), ABORTED, "control process hung"),
    _process(
        "control slow",
        Signal((CONTROL,), STOP, lasts_s=0.012, times=60),
        GOES_ON_OR_NOT,
        "of the deadlines are missed|hung",
        "stopped for 12 ms, 60 times; continues with a warning, or counts as hung on a busy machine",
    ),
    _process("observer killed", Signal((OBSERVER,), KILL), ABORTED, "observer process died"),
    _process("observer stopped", Signal((OBSERVER,), STOP), ABORTED, "observer process has been silent"),
    _process(
        "observer slow", Signal((OBSERVER,), STOP, lasts_s=0.4, times=3), FINISHED, "drops pictures|s old when they"
    ),
    _process("watchdog killed", Signal((WATCHDOG,), KILL), ABORTED, "watchdog process died"),
    _process("watchdog stopped", Signal((WATCHDOG,), STOP), ABORTED, "watchdog"),
    _process("supervisor killed", Signal((SUPERVISOR,), KILL), RECOVERED, ""),
    _process(
        "supervisor stopped, 4 s", Signal((SUPERVISOR,), STOP, lasts_s=4.0), ABORTED, "supervisor had been silent"
    ),
    _process(
        "supervisor stopped, 1.2 s", Signal((SUPERVISOR,), STOP, lasts_s=1.2), FINISHED, "nothing was recorded for"
    ),
    _process("simulator killed", Signal((PLANT,), KILL), ABORTED, "simulator died|no pressure sample|camera"),
    _process("simulator stopped", Signal((PLANT,), STOP), ABORTED, "no pressure sample|camera"),
    _process("control, observer and supervisor killed", Signal((CONTROL, OBSERVER, SUPERVISOR), KILL), RECOVERED, ""),
    _process(
        "control, observer and supervisor stopped, 4 s",
        Signal((CONTROL, OBSERVER, SUPERVISOR), STOP, lasts_s=4.0),
        ABORTED,
        "hung",
    ),
    _process("control and watchdog killed", Signal((CONTROL, WATCHDOG), KILL), ABORTED, "process died"),
    _process("control and watchdog stopped", Signal((CONTROL, WATCHDOG), STOP), ABORTED, "silent"),
    _process("watchdog and supervisor killed", Signal((WATCHDOG, SUPERVISOR), KILL), RECOVERED, ""),
    _process("all but the observer killed", Signal((CONTROL, WATCHDOG, SUPERVISOR), KILL), RECOVERED, ""),
    _process(
        "all but the observer stopped, 4 s",
        Signal((CONTROL, WATCHDOG, SUPERVISOR), STOP, lasts_s=4.0),
        ABORTED,
        "supervisor had been silent",
    ),
    _process("one to three of the four killed, in any order", RandomProcessSignals((KILL,)), EITHER, PROCESS_FAULT),
    _process("one to three of the four stopped, in any order", RandomProcessSignals((STOP,)), EITHER, PROCESS_FAULT),
    _process(
        "one to three of the four killed or stopped, in any order",
        RandomProcessSignals((KILL, STOP)),
        EITHER,
        PROCESS_FAULT,
    ),
    _process(
        "all stopped, then rig vent, then resumed",
        Signal((SUPERVISOR, WATCHDOG, CONTROL, OBSERVER), STOP, lasts_s=3.0, then_vent=True),
        (*ABORTED, *INTERRUPTED),
        "silent|hung|another program|simulator has stalled|SIGTERM",
        "the time runs from the start of the program `rig vent`",
        within_s=8.0,
    ),
)
TIP_CONTROL = (
    _tip_control("tip controller killed", Signal((TIP_CONTROLLER,), KILL), FINISHED, "tip_controller process died"),
    _tip_control("tip controller stopped", Signal((TIP_CONTROLLER,), STOP), FINISHED, "no plan for 1 s"),
    _tip_control(
        "tip controller late, 0.6 s", Signal((TIP_CONTROLLER,), STOP, lasts_s=0.6), FINISHED, "plans are followed again"
    ),
    _tip_control(
        "tip controller late, 2 s", Signal((TIP_CONTROLLER,), STOP, lasts_s=2.0), FINISHED, "plans are followed again"
    ),
    _tip_control(
        "tip controller late again and again, 0.15 s",
        Signal((TIP_CONTROLLER,), STOP, lasts_s=0.15, times=10),
        FINISHED,
        "",
    ),
    _tip_control(
        "tip controller and control killed", Signal((TIP_CONTROLLER, CONTROL), KILL), ABORTED, "control process died"
    ),
    _tip_control(
        "tip controller and observer stopped",
        Signal((TIP_CONTROLLER, OBSERVER), STOP),
        ABORTED,
        "observer process has been silent",
    ),
    *map(_while_tip_is_controlled, CAMERA),
)
ALL_FIVE = (SUPERVISOR, WATCHDOG, CONTROL, OBSERVER, PLANT)
SURROUNDINGS = (
    *(
        _process(
            f"machine stalls, {lasts_s:g} s",
            Signal(ALL_FIVE, STOP, lasts_s=lasts_s),
            GOES_ON_OR_NOT,
            "of the deadlines are missed",
            "every process is stopped, as by a host that takes the processor away; continues, or is stopped "
            "if the pressures have left their references",
        )
        for lasts_s in (0.15, 0.6)
    ),
    Fault("disk full", "disk", DiskFull(), (*ABORTED, *RECOVERED), "full"),
    Fault("file size limit reached", "disk", FileLimit(), (*ABORTED, *RECOVERED), "full", virtual=False),
    Fault(
        "folder turns read-only",
        "disk",
        FolderReadOnly(),
        FINISHED,
        "the journal is kept",
        virtual=False,
    ),
    Fault(
        "disk slow: takes nothing for 4 s",
        "disk",
        DiskBlocked(4.0),
        FINISHED,
        "has not taken the record",
        virtual=False,
    ),
    Fault(
        "disk slow: takes nothing for 12 s",
        "disk",
        DiskBlocked(12.0),
        ABORTED,
        "has taken nothing for",
        virtual=False,
        within_s=12.0,
        remark="what waits in memory is written once it does",
        moving_s=15.0,
    ),
    Fault(
        "rig and protocol changed on disk",
        "files",
        FilesChanged(),
        FINISHED,
        "",
        remark="the run has its own",
    ),
    Fault("clock stepped forward by a day", "clock", ClockStep(DAY_NS), FINISHED, "", virtual=False),
    Fault("clock stepped back by a day", "clock", ClockStep(-DAY_NS), FINISHED, "", virtual=False),
    Fault(
        "terminal blocked (Ctrl-S, a full pipe)",
        "terminal",
        TerminalBlocked(),
        FINISHED,
        "",
        virtual=False,
    ),
    Fault("terminal closed", "terminal", TerminalLost(), INTERRUPTED, "SIGHUP", virtual=False),
    Fault("model not converging", "model", ModelUnsolvable(), FINISHED, "model cannot be solved"),
)
TRANSITIONS = tuple(
    Fault(
        f"{action.value}, while it {'ends' if ending else 'starts'}",
        "start and end",
        TransitionFault(ending, action),
        tuple(Status),
        "",
        virtual=False,
        remark="" if ending else "whatever is there by then",
    )
    for ending in (False, True)
    for action in TransitionAction
    if not (ending and action is TransitionAction.VENT)
)
CATALOGUE = FaultRegistry(*SENSORS, *AIR, *CARD, *CAMERA, *PROCESSES, *TIP_CONTROL, *SURROUNDINGS, *TRANSITIONS)
