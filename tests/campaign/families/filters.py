"""Filter inputs: the result agrees with a Kalman filter, has a status, or the input is refused."""

from __future__ import annotations

from functools import partial

import torch

from ahnn.estimation import Gate, Status, initial_belief
from ahnn.measurements import Position
from ahnn_plugins.ukf import SQUARE_ROOT, STANDARD, UnscentedParameters, unscented_filter

F64 = torch.float64
ODD = [float("nan"), float("inf"), -1.0, 0.0, 1e300, 1e-300, 1j, "a", None, [], torch.zeros(0), torch.ones(3)]


def cases(draw, folder):
    """Yield filter problems with one or two arguments changed."""
    del folder
    while True:
        odd = {name: draw.choice(ODD) for name in draw.sample(NAMES, draw.randint(0, 2))}
        alpha = 10.0 ** -draw.uniform(0, 12)
        yield f"alpha {alpha:.1e} {odd}", partial(attempt, draw.randrange(10**6), alpha, odd)


NAMES = ["mean", "covariance", "rows", "q", "r", "dt", "gate", "patience", "start_time"]


def attempt(seed, alpha, odd) -> None:
    """Run a linear problem both ways."""
    draw = torch.Generator().manual_seed(seed)
    step = torch.eye(2, dtype=F64) + 0.1 * torch.randn(2, 2, generator=draw, dtype=F64)
    rows = torch.randn(1, 12, 1, generator=draw, dtype=F64)
    rows[:, ::3] = torch.nan
    given = {"mean": torch.zeros(1, 2), "covariance": torch.eye(2), "rows": rows, "q": 0.1 * torch.eye(2)}
    given |= {"r": 0.5 * torch.eye(1), "dt": 1.0, "gate": None, "patience": None, "start_time": 0.0} | odd
    patience = 5 if given["patience"] is None else given["patience"]
    gate = None if given["gate"] is None else Gate(given["gate"], patience)
    result = unscented_filter(
        lambda x, _: x @ step.mT,
        initial_belief(given["mean"], given["covariance"]),
        given["rows"],
        Position(1),
        given["q"],
        given["r"],
        given["dt"],
        parameters=UnscentedParameters(alpha, 2.0, 0.0),
        form=SQUARE_ROOT if seed % 2 else STANDARD,
        gate=gate,
        start_time=given["start_time"],
    )
    if not odd and result.status.tolist() == [int(Status.OK)]:
        expected = kalman(step, rows[0], 0.1 * torch.eye(2, dtype=F64), 0.5)
        sd = expected[1].diagonal().sqrt()
        worst = float(((result.means[0, -1] - expected[0]) / sd).abs().max())
        assert worst < 0.05, f"{worst:.1e} standard deviations off the Kalman filter"


def kalman(step, rows, q, r):
    """Return the textbook estimate and covariance after all rows of positions."""
    mean, cov = torch.zeros(2, dtype=F64), torch.eye(2, dtype=F64)
    for (y,) in rows:
        mean, cov = step @ mean, step @ cov @ step.mT + q
        if y.isfinite():
            gain = cov[:, 0] / (cov[0, 0] + r)
            mean, cov = mean + gain * (y - mean[0]), cov - torch.outer(gain, cov[0])
    return mean, cov
