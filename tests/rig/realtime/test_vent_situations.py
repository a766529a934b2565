"""`rig vent` vents a running experiment whatever has happened to its files, its processes and the caller's folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from scripts.vent_situations import SITUATIONS, Situation, play

pytestmark = pytest.mark.realtime


@pytest.mark.parametrize("situation", SITUATIONS, ids=lambda situation: situation.name)
def test_rig_vent_vents_and_ends_the_run(situation: Situation, tmp_path: Path) -> None:
    vented = play(situation, tmp_path)
    assert vented.status == situation.status, vented.said
    assert vented.run_status != 0, vented.run
    if situation.status:
        assert "NOT vented" in vented.said
    if not situation.moving:
        assert "its cards do not exist" in vented.said
        assert "stopped before the run began: vented by `rig vent`" in vented.run
