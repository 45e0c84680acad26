"""Trajectories of a user's own: what is accepted gives finite windows inside segments."""

from __future__ import annotations

from functools import partial

import torch

from ahnn.data import Given
from ahnn.data.windows import Windows
from ahnn.statistics import Statistics
from ahnn.types import Space, Trajectories

SPACE = Space("mine", ("q", "p"))


def cases(draw, folder):
    """Yield tensors with one to three faults."""
    del folder
    while True:
        faults = draw.sample(list(FAULTS), draw.randint(1, 3))
        yield " ".join(faults), partial(attempt, faults, draw.randrange(10**6), draw.randint(1, 6))


def spoil(rows, value):
    """Return a fault that sets some samples to a value."""

    def fault(states, times, draw):
        states[torch.rand(states.shape, generator=draw) < rows] = value
        return states, times

    return fault


FAULTS = {
    "nan": spoil(0.1, torch.nan),
    "many nan": spoil(0.9, torch.nan),
    "inf": spoil(0.01, torch.inf),
    "huge": spoil(0.05, 1e300),
    "no time": lambda s, t, _: (s, t * torch.nan),
    "one row of times": lambda s, t, _: (s, t[0]),
    "reversed": lambda s, t, _: (s, t.flip(-1)),
    "equal times": lambda s, t, _: (s, t * 0),
    "irregular": lambda s, t, g: (s, t + torch.rand(t.shape, generator=g, dtype=torch.float64) * 0.05),
    "single": lambda s, t, _: (s[:, :1], t[..., :1]),
    "empty": lambda s, t, _: (s[:0], t[:0]),
    "flat": lambda s, t, _: (s[0], t),
    "lists": lambda s, t, _: (s.tolist(), t.tolist()),
    "single precision": lambda s, t, _: (s.float(), t.float()),
    "integers": lambda s, t, _: (s.nan_to_num(0, 0, 0).clamp(-9, 9).long(), t),
    "complex": lambda s, t, _: (s.to(torch.complex128), t),
    "texts": lambda _, t, __: ("abc", t),
    "none": lambda s, _, __: (s, None),
}


def attempt(faults, seed, steps) -> None:
    """Bring the tensors through the door, into statistics and windows."""
    draw = torch.Generator().manual_seed(seed)
    states = torch.randn(3, 12, 2, generator=draw, dtype=torch.float64)
    times = (0.1 * torch.arange(12, dtype=torch.float64)).expand(3, -1).clone()
    for name in faults:
        try:
            states, times = FAULTS[name](states, times, draw)
        except (TypeError, AttributeError, IndexError, RuntimeError):
            return  # two faults that exclude each other
    data = Given(Trajectories(states, times), SPACE).read()
    windows = Windows(data, steps, torch.float64)
    batch = windows.gather(torch.arange(len(windows)))
    assert bool(batch.start.isfinite().all()), "a start that is absent"
    assert bool(batch.increments.isfinite().all()), "an increment over a gap"
    assert Statistics.of(data).dt > 0, "no step"
