"""Sliding windows by index arithmetic: no window is ever stored."""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.errors import UserError
from ahnn.types import Trajectories, Window


class Windows:
    """All windows of W consecutive steps that fit inside single trajectories.

    Window i is found by arithmetic: trajectory by the cumulative count of windows, offset by the rest. A
    window never straddles two trajectories nor the end of a short one.

    Args:
        trajectories: the data; kept in float64.
        steps: W, the steps of a window (it spans W + 1 samples).
        dtype: type in which batches are handed out.

    Raises:
        UserError: no trajectory is long enough for a window.
    """

    def __init__(self, trajectories: Trajectories, steps: int, dtype: torch.dtype) -> None:
        states, lengths, self.dt = trajectories
        per_trajectory = (lengths - steps).clamp(min=0)
        if steps < 1 or int(per_trajectory.sum()) == 0:
            message = (
                f"window: expected 1 <= W <= {int(lengths.max()) - 1} steps, the longest trajectory; "
                f"received W={steps}"
            )
            raise UserError(message)
        self.ends = per_trajectory.cumsum(0)
        self.begins = self.ends - per_trajectory
        self.samples = states.shape[1]
        self.flat = states.reshape(-1, states.shape[-1])
        self.offsets = torch.arange(steps + 1)
        self.dtype = dtype

    def __len__(self) -> int:
        """Return the number of windows."""
        return int(self.ends[-1])

    def first_sample(self, index: Tensor) -> Tensor:
        """Return the row of `flat`, shape (B,), at which each window of `index`, shape (B,), begins."""
        trajectory = torch.searchsorted(self.ends, index, right=True)
        return trajectory * self.samples + index - self.begins[trajectory]

    def speeds(self) -> Tensor:
        """Return how fast momenta change over the first step of each window, shape (windows,), mean 1."""
        rows = self.first_sample(torch.arange(len(self), device=self.flat.device))
        momenta = self.flat.chunk(2, dim=-1)[1]
        speed = (momenta[rows + 1] - momenta[rows]).norm(dim=-1)
        return speed / speed.mean()

    def gather(self, index: Tensor) -> Window:
        """Return the windows of `index`, shape (B,), as one batch."""
        rows = self.first_sample(index).unsqueeze(-1) + self.offsets
        states = self.flat[rows]
        increments = states[:, 1:] - states[:, :-1]
        return Window(states[:, 0].to(self.dtype), increments.to(self.dtype), self.dt)

    def to(self, device: torch.device) -> None:
        """Move samples and index tables to a device, once; batches are then gathered there."""
        for name in ("flat", "ends", "begins", "offsets"):
            setattr(self, name, getattr(self, name).to(device))
