"""`rig reproduce`: the paper's tables and figures beside ours, from archives that are there or simulated ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rig.cli import main
from rig.paper import motion
from rig.paper.compared import Compared
from rig.paper.page import write


def test_the_text_alone_tells_what_average_rmse_means() -> None:
    # Table 4's best is the mean of Table 5's four numbers, to the last printed digit.
    four = [value for pair in motion.TABLE5_MM for value in pair]
    best = min(value for row in motion.TABLE4_MM.values() for value in row if value is not None)
    assert round(float(np.mean(four)), 4) == best


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("paper")
    with pytest.raises(SystemExit) as left:
        main(["reproduce", "fig14", "--out", str(out)])
    assert left.value.code == 0
    return out


def test_what_is_missing_is_simulated_once_and_said_to_be(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    archives = sorted((folder / "runs").glob("*.h5"))
    assert len(archives) == 2
    with pytest.raises(SystemExit):
        main(["reproduce", "table5", "--out", str(folder)])
    told = capsys.readouterr().out
    assert sorted((folder / "runs").glob("*.h5")) == archives
    assert "simulated" in told
    assert "1.7349" in told


def test_figures_and_page_lie_in_the_folder(folder: Path) -> None:
    page = (folder / "paper.html").read_text()
    assert (folder / "fig14.png").read_bytes().startswith(b"\x89PNG")
    assert (folder / "fig14.pdf").read_bytes().startswith(b"%PDF")
    assert "measure nothing of the paper" in page
    assert "<script" not in page
    assert "src=" not in page


def test_a_page_of_a_real_rig_does_not_call_itself_simulated(tmp_path: Path) -> None:
    row = Compared("Fig 11", "tip <x>", "", "1.0", "measured", "another arm")
    page = write(tmp_path, [row], [], ["a remark"]).read_text()
    assert "measure nothing of the paper" not in page
    assert "tip &lt;x&gt;" in page
