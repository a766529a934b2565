"""The sampling clocks of the cards: control publishes them, the supervisor records them as counters."""

from __future__ import annotations

from rig.config.schema import RigConfig
from rig.hardware.bench import Bench
from rig.realtime.shared_state import CLOCKS, SharedState


def publish(memory: SharedState, bench: Bench) -> None:
    """Publish period and drift of the clock of each card, of at most CLOCKS cards."""
    for number, clock in bench.clocks.items():
        if number < CLOCKS:
            memory.flags["scan_period_ns"][0, number], memory.flags["scan_drift_ppm"][0, number] = clock


def clock_counters(memory: SharedState, config: RigConfig) -> dict[str, int]:
    """Counters of each card with its own sampling clock; their names begin with the name of the card.

    `scan_period_ns` is the period as rounded by the driver; `scan_drift_ppb` its estimated relative error by the
    computer's clock in parts per billion (1e-9).
    """
    counters = {}
    for name, period_ns, drift_ppm in _clocks(memory, config):
        counters[f"{name}_scan_period_ns"] = round(period_ns)
        counters[f"{name}_scan_drift_ppb"] = round(drift_ppm * 1e3)
    return counters


def descriptions(memory: SharedState, config: RigConfig) -> list[str]:
    """A sentence for each card with its own sampling clock."""
    return [
        f"card {name} samples by its own clock every {period_ns * 1e-3:.3f} us "
        f"(requested: {1e6 / config.cards[name].sampling_hz:.3f} us)"
        for name, period_ns, _ in _clocks(memory, config)
    ]


def _clocks(memory: SharedState, config: RigConfig) -> list[tuple[str, float, float]]:
    flags = memory.flags[0]
    rows = zip(config.cards, flags["scan_period_ns"].tolist(), flags["scan_drift_ppm"].tolist(), strict=False)
    return [row for row in rows if row[1] > 0]
