"""The command `rig` in the process of the test."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner, Result

from rig.cli.app import app, main


def status_of(*words: object) -> int:
    """Call `rig` with these words; return its exit status. An unexpected exception reaches the test."""
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    assert isinstance(ended.value.code, int)
    return ended.value.code


def invoke(*words: object) -> Result:
    """Call `rig` with these words; return its exit code and its output."""
    return CliRunner().invoke(app, [str(word) for word in words])
