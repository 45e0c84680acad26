"""Progress bars where standard error is no terminal."""

import pytest
from rich.progress import Progress

from ahnn import progress


@pytest.fixture
def older_rich(monkeypatch):
    """Rich before version 14.3: a bar that ends prints a line, even if it is disabled."""
    monkeypatch.setattr(Progress, "stop", lambda bar: (bar.live.stop(), bar.console.print()))


@pytest.mark.usefixtures("older_rich")
def test_a_silent_bar_leaves_no_empty_line(capsys):
    assert [*progress.track(range(3), "counting", 3)] == [0, 1, 2]
    with progress.stage("a stage"):
        progress.note("a note")
    assert capsys.readouterr().err == ""
