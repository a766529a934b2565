"""A process that opens a card for the contract test: it holds the card until it is killed, or writes it once.

`python -m rig.driver_contract.card_holder hold|write RIG_FILE CARD V1,V2,..` prints one line of JSON: the read-back,
the process ids of a busy card, or the error.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import replace

import numpy as np

from rig.config import loader
from rig.hardware.cards.base import CardBusyError, CardError
from rig.hardware.cards.opening import open_card
from rig.hardware.cards.setup import card_setup

HELD_PERIOD_S = 0.005
SETTLED_S = 0.02
"""Time for the read-back of a device on a bus."""


def main(mode: str, rig_file: str, name: str, outputs: str) -> None:
    """Open the card; `hold`: start it, and write and read it until the process is killed."""
    config = loader.load(rig_file)
    setup = card_setup(config, name)
    written = np.array([float(v) for v in outputs.split(",")])
    try:
        card = open_card(config.cards[name], setup if mode == "hold" else replace(setup, inputs=()))
        if mode == "hold":
            card.start()
        card.write(written)
        time.sleep(SETTLED_S if mode == "write" else 0.0)
        stands = card.readback().tolist()
    except CardBusyError as busy:
        _tell(busy=busy.holders, message=str(busy))
        return
    except CardError as error:
        _tell(error=str(error))
        return
    except Exception as error:  # the code of another package may raise anything
        _tell(raised=f"{type(error).__name__}: {error}")
        return
    _tell(stands=stands)
    while mode == "hold":
        time.sleep(HELD_PERIOD_S)
        card.read()
        card.write(written)
    card.close()


def _tell(**words: object) -> None:
    print(json.dumps(words), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
