"""Time from the call of `rig vent` until the vent voltage is on the card, in every situation that tests play.

`python -m benchmarks.vent [PART OF A NAME]`: a table of each situation on the machine as it is, and beside four busy
loops. A simulated card is read every millisecond by this process.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from scripts.vent_situations import SITUATIONS, Situation, Vented, play

BUSY_LOOPS = 4


@contextmanager
def busy(loops: int) -> Iterator[None]:
    """Run loops that never wait, beside what happens inside."""
    processes = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(loops)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def measured(situation: Situation, loops: int) -> Vented | str:
    """One call in one situation; why it failed, if it did."""
    with tempfile.TemporaryDirectory() as folder, busy(loops):
        try:
            return play(situation, Path(folder))
        except AssertionError as error:
            return str(error)


def main() -> None:
    """Print one row per situation."""
    wanted = sys.argv[1] if len(sys.argv) > 1 else ""
    print("situation | exit status | quiet [s] | beside four busy loops [s]")
    print("--- | --- | --- | ---")
    slowest = [0.0, 0.0]
    for situation in SITUATIONS:
        if wanted not in situation.name:
            continue
        outcomes = [measured(situation, loops) for loops in (0, BUSY_LOOPS)]
        cells = [f"{o.vented_s:.2f}" if isinstance(o, Vented) else o for o in outcomes]
        statuses = {o.status for o in outcomes if isinstance(o, Vented)}
        for place, outcome in enumerate(outcomes):
            if isinstance(outcome, Vented):
                slowest[place] = max(slowest[place], outcome.vented_s)
        print(f"{situation.name} | {', '.join(map(str, sorted(statuses)))} | {' | '.join(cells)}", flush=True)
    print(f"slowest |  | {slowest[0]:.2f} | {slowest[1]:.2f}")


if __name__ == "__main__":
    main()
