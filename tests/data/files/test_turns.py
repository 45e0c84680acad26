"""An angle wrapped to one turn is the angle that goes on, in tables and tensors alike."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

import ahnn
from ahnn.data import Given
from ahnn.data.doctor import examine
from ahnn.data.files import Files
from ahnn.data.files.reading import FileReading
from ahnn.types import Space, Units

TIMES = 0.1 * np.arange(120)
RADIANS = Units("s", "rad", "rad/s", "kg m^2/s^2")


def turning(phase):
    """A pendulum that goes round."""
    return phase + 2.5 * TIMES + 0.2 * np.sin(2.5 * TIMES), 2.5 + 0.5 * np.cos(2.5 * TIMES)


def wrapped(angle, half):
    return (angle + half) % (2 * half) - half


def table(path, sign=1.0, unit="rad", blank=None):
    size = {"rad": 1.0, "deg": 180 / math.pi}[unit]
    lines = [f"id,t [s],theta [{unit}],theta_dot [{unit}/s]"]
    for name, phase in (("a", 0.0), ("b", 2.0)):
        angle, rate = turning(phase)
        cells = zip(TIMES, wrapped(sign * angle, math.pi) * size, sign * rate * size, strict=True)
        lines += [f"{name},{t:.1f},{'' if k == blank else q},{v}" for k, (t, q, v) in enumerate(cells)]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("unit", ["rad", "deg"])
def test_a_table_of_wrapped_angles_is_read_as_one_that_goes_on(tmp_path, sign, unit):
    path = table(tmp_path / "mine.csv", sign, unit)
    found = Files("mine", str(path)).read().states[..., 0].numpy()
    for row, phase in zip(found, (0.0, 2.0), strict=True):
        whole = sign * turning(phase)[0]
        assert np.abs(row - row[0] - (whole - whole[0])).max() < 1e-12
    findings = examine([path], FileReading(), None).findings
    assert {one.level for one in findings} == {"note"}
    assert any("jumps by a full turn, 10 times" in one.what for one in findings)


def test_a_number_that_is_missing_at_the_jump_loses_no_turn(tmp_path):
    whole = turning(0.0)[0]
    jump = 1 + int(np.flatnonzero(np.abs(np.diff(wrapped(whole, math.pi))) > 3)[0])
    found = Files("mine", str(table(tmp_path / "mine.csv", blank=jump))).read().states[0, :, 0].numpy()
    assert np.isnan(found[jump])
    assert np.nanmax(np.abs(found - whole)) < 1e-12


def test_tensors_are_read_so_too_and_stay_as_they_are():
    angle, rate = turning(0.0)
    states = torch.tensor(np.stack((wrapped(angle, math.pi), rate), axis=-1))[None]
    before = states.clone()
    source = Given(ahnn.Trajectories(states, torch.tensor(TIMES)), Space("mine", ("q", "p"), RADIANS))
    source.check()
    assert np.abs(source.read().states[0, :, 0].numpy() - angle).max() < 1e-12
    assert torch.equal(states, before)


def test_lengths_and_swings_are_left_alone():
    swing = 3.0 * np.cos(2.0 * TIMES)
    states = torch.tensor(np.stack((swing, -6.0 * np.sin(2.0 * TIMES)), axis=-1))[None]
    for units in (RADIANS, Units()):
        source = Given(ahnn.Trajectories(states, torch.tensor(TIMES)), Space("mine", ("q", "p"), units))
        assert torch.equal(source.read().states, states)
