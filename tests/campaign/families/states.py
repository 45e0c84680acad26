"""Saved states of a filter with damaged bytes: refused, or the state that was saved."""

from __future__ import annotations

from functools import partial

import torch

from ahnn.estimation import initial_belief, load_state, save_state
from ahnn_plugins.ukf import UnscentedKalmanFilter

from .damage import damaged


def cases(draw, folder):
    """Yield damaged states."""
    state = UnscentedKalmanFilter().start(initial_belief([[1.0, 2.0]], torch.eye(2)), 0.0)
    save_state(state, folder / "good")
    good = (folder / "good").read_bytes()
    while True:
        what, content = damaged(draw, good)
        yield what, partial(attempt, folder / "bad", content)


def attempt(path, content) -> None:
    """Load a damaged state."""
    path.write_bytes(content)
    state = load_state(path)
    assert state.belief.mean.shape[-1] == state.belief.chol.shape[-1]
