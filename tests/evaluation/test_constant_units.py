"""Learned constants are shown and stored with the units that follow from those of the space."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from cases import KEPLER, make_case
from torch import nn

from ahnn.evaluation import run
from ahnn.evaluation.constant_units import constant_unit
from ahnn.evaluation.open_loop import open_loop
from ahnn.types import Space, Units
from ahnn.uncertainty import Constant

ORBIT = Space("orbit", ("x", "px"), Units("s", "km", "km/s", "km²/s²"))


@pytest.mark.parametrize(
    ("name", "space", "unit"),
    [
        ("mu", ORBIT, "km^3/s^2"),
        ("mu", ORBIT._replace(units=Units("d", "au", "au/d", "au²/d²")), "au^3/d^2"),
        ("mu", ORBIT._replace(units=Units()), ""),
        ("friction.coefficient[2]", ORBIT, "1/s"),
        ("friction.coefficient", ORBIT._replace(units=Units("s", "m", "m/s", "kg m²/s²")), "kg/s"),
        ("friction.coefficient", ORBIT._replace(units=Units("s", "m", "m/s", "J")), "J s/m^2"),
        ("friction.matrix[1]", ORBIT._replace(units=Units("s", "rad", "rad/s", "J")), "J s"),
        ("friction.coefficient", ORBIT._replace(units=Units()), ""),
        ("equator.cosine", ORBIT, ""),
    ],
)
def test_a_constant_has_the_unit_of_its_kind(name, space, unit):
    assert constant_unit(name, space) == unit


def test_the_line_and_the_numbers_state_it(tmp_path, monkeypatch):
    case = make_case(tmp_path, KEPLER, None, flow=nn.Identity())
    findings = open_loop(make_case(tmp_path, KEPLER, None))
    case = SimpleNamespace(uncertainty=None, flow=case.flow, space=ORBIT)
    monkeypatch.setattr(run, "learned_constants", lambda *_: [Constant("mu", 398596.0, 7.5)])
    run.add_constants(case, findings)  # pyright: ignore[reportArgumentType] - all that it reads
    assert "learned: mu 398596 ± 7.5 km^3/s^2" in findings.highlights
    assert "learned: mu 398596 ± 7.5 km^3/s^2" in findings.rows[0].note
    assert findings.numbers["constants"] == {"mu": [398596.0, 7.5]}
    assert findings.numbers["constant_units"] == {"mu": "km^3/s^2"}
