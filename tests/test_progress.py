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


def test_notes_name_the_step_and_its_usual_time(caplog, monkeypatch):
    clock = iter(range(0, 1000, 40))
    monkeypatch.setattr(progress.time, "monotonic", lambda: float(next(clock)))
    with caplog.at_level("INFO"), progress.stage("a stage"):
        for k in progress.counted(3, "step"):
            progress.note("a note")
            if k == 1:
                break
        progress.note("another")
    said = [record.message.partition(" s so far")[0].rpartition(",")[0] for record in caplog.records]
    assert said == [
        "a stage: step 1 of at most 3, a note",
        "a stage: step 2 of at most 3 (80 s each), a note",
        "a stage: another",
    ]


def test_notes_state_the_time_left_once_it_is_foreseen(caplog, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    with caplog.at_level("INFO"), progress.stage("a stage"):
        for now[0], text in ((40.0, "first"), (80.0, "second"), (400.0, "third")):
            progress.note(text)
            if text == "first":
                progress.foresee(100.0)
    with caplog.at_level("INFO"), progress.stage("another"):
        now[0] = 450.0
        progress.note("first")
    assert caplog.messages == [
        "a stage: first, 40 s so far",
        "a stage: second, 80 s so far, about 60 s left",
        "a stage: third, 400 s so far",
        "another: first, 50 s so far",
    ]


def test_a_log_states_the_part_done_and_the_time_left(caplog, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    with caplog.at_level("INFO"), progress.advancing("counting", 8) as advance:
        for now[0] in (5.0, 40.0, 45.0, 80.0):
            advance()
    assert caplog.messages == ["counting: 25 %, about 2.0 min left", "counting: 50 %, about 80 s left"]
