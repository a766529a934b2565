"""The cards' own sampling clocks on their way into the record: control publishes them, the supervisor counts them."""

from __future__ import annotations

from rig.config.schema import RigConfig
from rig.hardware.bench import Bench
from rig.realtime.shared_state import CLOCKS, SharedState


def publish(memory: SharedState, bench: Bench) -> None:
    """Say how every card's clock goes; of a rig with more than CLOCKS cards, the first ones'."""
    for number, name in list(enumerate(bench.card_names))[:CLOCKS]:
        if (clock := bench.clock(name)) is not None:
            memory.board["scan_period_ns"][0, number], memory.board["scan_drift_ppm"][0, number] = clock


def clock_counters(memory: SharedState, config: RigConfig) -> dict[str, int]:
    """What the record keeps of each card that samples by its own clock, under names that begin with the card's.

    `scan_period_ns` is the period as the driver rounded it; `scan_drift_ppb` how much longer it is by the computer's
    clock, in parts per thousand million, as learnt by the end.
    """
    counters = {}
    for name, period_ns, drift_ppm in _clocks(memory, config):
        counters[f"{name}_scan_period_ns"] = round(period_ns)
        counters[f"{name}_scan_drift_ppb"] = round(drift_ppm * 1e3)
    return counters


def descriptions(memory: SharedState, config: RigConfig) -> list[str]:
    """A sentence for each card that samples by its own clock."""
    return [
        f"card {name} samples by its own clock every {period_ns * 1e-3:.3f} us "
        f"(asked for: {1e6 / config.cards[name].sampling_hz:.3f} us)"
        for name, period_ns, _ in _clocks(memory, config)
    ]


def _clocks(memory: SharedState, config: RigConfig) -> list[tuple[str, float, float]]:
    board = memory.board[0]
    rows = zip(config.cards, board["scan_period_ns"].tolist(), board["scan_drift_ppm"].tolist(), strict=False)
    return [row for row in rows if row[1] > 0]
