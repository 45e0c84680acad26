"""Noise and beliefs of any size: as an 80-digit Kalman filter has it, or a status that says no."""

from __future__ import annotations

from functools import cache

import mpmath
import numpy as np
import pytest
import torch
from precise import LinearMeasurement, kalman

from ahnn.estimation import Status, initial_belief
from ahnn_plugins.ukf import SQUARE_ROOT, STANDARD, members, unscented_filter

FORMS = [SQUARE_ROOT, STANDARD]
P = [10.0**k for k in (-12, -6, 0, 4, 7, 12)]
R = [0.0, *(10.0**k for k in range(-33, 10, 6))]


def problem(p, r, width, far, seed):
    """Two states, three rows: start, transition, model, R, and rows that the model makes."""
    draw = np.random.default_rng(seed)
    h, a = draw.normal(size=(width, 2)), np.eye(2) + 0.1 * draw.normal(size=(2, 2))
    mean, rows = np.full(2, far), []
    x = mean + np.sqrt(p) * draw.normal(size=2)
    for _ in range(3):
        x = a @ x
        rows.append(h @ x + np.sqrt(r) * draw.normal(size=width))
    return mean, p * np.eye(2), a, h, r * np.eye(width), np.array(rows)


@cache
def exact(*numbers):
    """What 80 digits give for a problem, whichever form is compared with it."""
    return kalman(*problem(*numbers))


def filtered(form, mean, p0, a, h, r, rows):
    move = torch.from_numpy(a)
    model, nothing = LinearMeasurement(torch.from_numpy(h)), np.zeros((2, 2))
    start = initial_belief(mean[None], p0)
    return unscented_filter(lambda x, _: x @ move.mT, start, rows[None], model, nothing, r, 1.0, form=form)


def off(result, reference):
    """Distance of the mean from the reference, in its standard deviations."""
    pairs = zip(result.means[0, -1].tolist(), *reference, strict=True)
    return max(float(abs(mpmath.mpf(own) - mean) / sd) for own, mean, sd in pairs)


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
@pytest.mark.parametrize("width", [1, 2, 3])
def test_every_noise_beside_every_belief_is_right_or_said_not_to_be(form, width, compiled, monkeypatch):
    if not compiled:
        monkeypatch.setattr(members, "library", lambda: None)
    kept = 0
    for p in P:
        for r in R[form is STANDARD :]:  # which refuses a singular R
            far, seed = (0.0, 1e4)[int(np.log10(p)) % 2], int(np.log10(p)) + 20
            given = problem(p, r, width, far, seed)
            result = filtered(form, *given)
            if result.status.tolist() == [Status.OK]:
                kept += 1
                if r > 0.0:
                    assert off(result, exact(p, r, width, far, seed)) < 0.05, (p, r)
                else:  # as exact as numbers are, and never more measurements than states
                    assert width == 1
                    assert len(given[-1]) <= 2
    assert kept > (len(P) * len(R)) // 3  # and not by refusing everything


def test_exact_measurements_of_more_than_the_state_are_imprecise():
    h, x = torch.tensor([[1.0, 0.3], [0.2, 1.0], [0.7, 0.7]], dtype=torch.float64), torch.tensor([0.3, 0.7])
    rows = (h @ x.double())[None, None]
    given = lambda x, _: 1.0 * x, initial_belief([[0.0, 0.0]], torch.eye(2)), rows, LinearMeasurement(h)
    result = unscented_filter(*given, torch.zeros(2, 2), torch.zeros(3, 3), 1.0)
    assert int(result.status) in (Status.IMPRECISE, Status.COLLAPSED)


def test_the_square_root_form_goes_on_where_the_standard_form_cannot():
    given = problem(1e7, 1e-15, 2, 0.0, 3)
    root, standard = (filtered(form, *given) for form in FORMS)
    assert root.status.tolist() == [Status.OK]
    assert off(root, kalman(*given)) < 1e-3
    assert standard.status.tolist() != [Status.OK]


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
@pytest.mark.parametrize(("second", "kept"), [(torch.nan, True), (0.2, False)])
def test_a_number_that_is_missing_loses_no_digits(form, second, kept):
    h, r = torch.eye(2, dtype=torch.float64), torch.diag(torch.tensor([1e-4, 1e-40], dtype=torch.float64))
    given = lambda x, _: 1.0 * x, initial_belief([[0.0, 0.0]], torch.eye(2)), [[[0.1, second]]]
    result = unscented_filter(*given, LinearMeasurement(h), torch.zeros(2, 2), r, 1.0, form=form)
    assert (int(result.status) == Status.OK) == kept
