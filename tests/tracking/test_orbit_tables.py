"""Output of an orbit determination: units of unknowns, and states at whole seconds."""

from __future__ import annotations

import csv
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from earth import EPOCH
from simulated import learned

from ahnn.data.files.epochs import SECOND
from ahnn.tracking.orbit_tables import unknowns_csv, whole_seconds
from ahnn.tracking.unknowns import START

HALF = EPOCH + SECOND // 2


def fit_of(*, at=0.0, times=(0.0, 900.0), epoch=EPOCH, terms=(), bias=()) -> Any:
    """What tables read of a fit."""
    arc = SimpleNamespace(first=min(at, times[0] - 1), last=max(at, times[-1] + 1))
    names = (
        *START,
        *(name for term in terms for name in term.parameters),
        *(f"bias {pair}" for pair in bias),
    )
    problem = SimpleNamespace(
        at=at,
        model=SimpleNamespace(data=SimpleNamespace(epoch=epoch, times=np.array(times))),
        forces=SimpleNamespace(terms=terms),
        unknowns=SimpleNamespace(names=names, bias=bias),
    )
    values = np.arange(len(names), dtype=float)
    return SimpleNamespace(problem=problem, point=SimpleNamespace(arc=arc, x=values), deviations=values)


@pytest.mark.parametrize(
    ("given", "begin", "expected"),
    [
        ({}, 0, [0, 300, 600, 900]),
        ({"times": (0.0, 950.0)}, 0, [0, 300, 600, 900, 950]),
        ({"times": (0.0, 900.25)}, 0, [0, 300, 600, 900, 901]),
        ({"at": -7.0, "times": (0.0, 300.0)}, -7, [0, 300, 307]),
        ({"at": 310.0, "times": (0.25, 300.0)}, 0, [0, 300, 310]),
        ({"at": -7.25, "times": (0.0, 300.0)}, -7, [0, 300, 307]),
        ({"at": 310.75, "times": (0.0, 300.0)}, 0, [0, 300, 310]),
        ({"epoch": HALF, "times": (0.0, 600.0)}, 0, [0, 300, 600, 601]),
        ({"times": (0.0, np.nextafter(86400.0, np.inf))}, 0, [*range(0, 86401, 300)]),
    ],
)
def test_an_orbit_is_written_at_round_steps_from_a_whole_second_to_the_end(given, begin, expected):
    fit = fit_of(**given)
    start, since = whole_seconds(fit, 300.0)
    assert (start - EPOCH) / SECOND == begin
    assert since.tolist() == expected
    times = since + (start - fit.problem.model.data.epoch) / SECOND
    assert fit.point.arc.first <= times[0]
    assert times[-1] <= fit.point.arc.last


def test_steps_below_a_second_do_not_repeat_the_last_state():
    _, since = whole_seconds(fit_of(times=(0.0, 3.0)), 0.1)
    assert len(since) == 31
    assert np.allclose(np.diff(since), 0.1)


def test_each_unknown_has_its_unit_and_the_state_an_epoch_and_a_frame():
    drag = SimpleNamespace(parameters=("drag",))
    fit = fit_of(at=90.5, terms=(drag, learned(2)), bias=((0, 0), (1, 2), (0, 3)))
    rows = list(csv.DictReader(unknowns_csv(fit).decode().splitlines()))
    weights = len(learned(2).parameters)
    units = ["km"] * 3 + ["km/s"] * 3 + ["1"] + ["1e-09 km/s²"] * weights + ["km", "rad", "km/s"]
    assert [row["unit"] for row in rows] == units
    assert [(row["epoch_utc"], row["frame"]) for row in rows[:6]] == [("2016-02-13T16:01:30.500", "GCRF")] * 6
    assert {(row["epoch_utc"], row["frame"]) for row in rows[6:]} == {("", "")}
