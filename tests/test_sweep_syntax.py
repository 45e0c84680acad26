"""Sweeps written with a mistake: the message says what is missing, and the corrected text is a sweep."""

from __future__ import annotations

import pytest
from entry import call

from ahnn.cli.commandline import parse
from ahnn.errors import UserError

FAULTS = {
    "optimizer.lr=interval(1e-3 3e-2)": "a comma is missing",
    "optimizer.lr=tag(log interval(1e-3, 3e-2))": "a comma is missing",
    "optimizer.lr=tag(log, interval(1e-3, 3e-2)": "a closing parenthesis is missing",
    "a=range(1 5)": "a comma is missing",
    "a=choice(tanh gelu": "a closing parenthesis is missing",
    'a="interval(1e-3, 3e-2)"': "without quotes inside the value",
}


@pytest.mark.parametrize("text", FAULTS)
def test_the_fault_is_named_and_the_correction_is_a_sweep(text):
    with pytest.raises(UserError) as raised:
        parse(text)
    told = str(raised.value)
    assert FAULTS[text] in told
    assert "need quotes" not in told
    assert parse(told.rpartition("Type '")[2].removesuffix("'")).is_sweep_override()


def test_a_sweep_without_a_correction_shows_its_form():
    with pytest.raises(UserError, match=r"expected interval\(LOW, HIGH\); its arguments do not fit$"):
        parse("a=interval(1e-3)")


@pytest.mark.parametrize(
    "text", ["a=choice(1, 2)", "label=interval", "label='f(x)'", "a=tag(log, interval(1, 2))"]
)
def test_other_values_pass(text):
    parse(text)


def test_a_training_with_it_ends_with_one_message(tmp_path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert call("ahnn.train", "-m", "sweep=quick", "optimizer.lr=interval(1e-3 3e-2)") == 2
    assert "expected interval(LOW, HIGH); a comma is missing" in capfd.readouterr().err


def test_a_sensor_that_is_given_is_not_asked_for(tmp_path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert call("ahnn.train", "model=srnn", "system=molniya", "sensor=orbit_states", "run=run") == 2
    told = capfd.readouterr().err
    assert "received model=srnn, which sets loss=recursive in place of that of sensor=orbit_states" in told
    assert "or add loss=shooting" in told
    assert "sensor=recorded" not in told
