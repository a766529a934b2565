"""Columns of the control cycles: pressures, auxiliary inputs, timing, and the pulses that trigger the cameras."""

from __future__ import annotations

from runs.columns.conversions import from_bar, from_us, protocol_time_column, time_column, to_bar, to_us
from runs.columns.declaration import Column, Table


class Pressure(Table):
    """Control cycles: (n,), per actuator (n, N), per valve (n, V). Gauge pressures."""

    group, rows, signal, about = "pressure", "N", "measured_bar", "one row per control cycle"

    time_s = time_column("time of the newest scan of the cycle")
    cycle = Column("cycle", "<i8", about="number of the control cycle")
    protocol_s = protocol_time_column()
    setpoint_bar = Column(
        "setpoint_pa", axes=("actuator",), unit="bar", about="set-point", convert=to_bar, inverse=from_bar
    )
    measured_bar = Column(
        "measured_pa",
        axes=("actuator",),
        unit="bar",
        about="mean of the scans since the last cycle",
        convert=to_bar,
        inverse=from_bar,
    )
    valve_v = Column(
        "valve_v",
        axes=("valve",),
        unit="V",
        about="voltage commanded next, if the valve takes one",
        dataset="valve_V",
    )
    scans = Column("scans", "<i4", about="number of scans in the mean")


class ValveOutput(Table):
    """Outputs of the valves (n, V), each in its own unit. Only for rigs with a valve that takes another unit than V."""

    group, rows, signal = "valve_output", "N", "output"
    about = "outputs of the valves of a rig on which not all take a voltage, one row per control cycle"
    facts = (("units", "valve_unit"),)
    units: tuple[str, ...]

    time_s = time_column("time of the newest scan of the cycle")
    output = Column("valve_output", axes=("valve",), about="commanded next, in the unit of the valve")


class Auxiliary(Table):
    """Auxiliary inputs (n, I) at the control cycles, each in its own unit."""

    group, rows, signal = "aux", "N", "value"
    about = "auxiliary inputs of the rig file, one row per control cycle"
    facts = (("inputs", "input"), ("units", "input_unit"))
    inputs: tuple[str, ...]
    units: tuple[str, ...]

    time_s = time_column("time of the newest scan of the cycle")
    value = Column(
        "aux", axes=("input",), about="mean of the scans since the last value; NaN outside the span of the sensor"
    )


class Timing(Table):
    """Timing of the control cycles (n,), and losses of the whole run."""

    group, rows, signal = "timing", "N", "lateness_us"
    facts = tuple((name, name) for name in ("dropped_frames", "ring_overflows"))
    dropped_frames: int = 0
    ring_overflows: int
    counters: dict[str, int]
    """As the executor counted them, by name."""

    time_s = time_column("time of the newest scan of the cycle")
    overruns = Column("missed", "<i4", about="deadlines missed since the last cycle")
    lateness_us = Column(
        "lateness_ns", "<i8", unit="us", about="how late the control cycle began", convert=to_us, inverse=from_us
    )


class TriggerPulse(Table):
    """Pulses of the camera trigger (g,). Only for rigs with a `trigger`."""

    group, rows, signal = "trigger", "G", "uncertainty_us"
    about = "one row per pulse; tip/frame is the number of the pulse that began the exposure"

    time_s = time_column("rising edge")
    pulse = Column("pulse", "<i8", about="number of the pulse")
    skipped = Column("skipped", "<i4", about="frame periods without a pulse before this one, because control was late")
    uncertainty_us = Column(
        "write_s",
        unit="us",
        about="half of the duration of the write that set the output high",
        convert=lambda seconds: seconds * 0.5e6,
        inverse=lambda us: us / 0.5e6,
    )
