"""Sliding windows by index arithmetic: no window is ever stored."""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.errors import UserError
from ahnn.statistics import sampling_interval
from ahnn.types import Trajectories, Window


class Windows:
    """All windows of W consecutive steps that fit inside single trajectories.

    The samples of a trajectory that follow each other without a gap are a stretch. Window i is found by
    arithmetic: its stretch by the cumulative count of windows, its offset by the rest. So a window straddles
    neither two trajectories nor a sample that is absent.

    Args:
        trajectories: the data; kept in float64.
        steps: W, the steps of a window (it spans W + 1 samples).
        dtype: type in which batches are handed out.

    Raises:
        UserError: no stretch is long enough for a window.
    """

    def __init__(self, trajectories: Trajectories, steps: int, dtype: torch.dtype) -> None:
        firsts, lengths = stretches(trajectories.present)
        counts = (lengths - steps).clamp(min=0)
        require_span(steps, int(lengths.max()) - 1 if len(lengths) else 0)
        self.ends = counts.cumsum(0)
        self.firsts = firsts - (self.ends - counts)
        self.flat = trajectories.states.reshape(-1, trajectories.states.shape[-1])
        dt = sampling_interval(trajectories)
        self.dt = dt if isinstance(dt, float) else None
        self.times = trajectories.times[:0] if self.dt is not None else trajectories.times.reshape(-1)
        self.offsets = torch.arange(steps + 1)
        self.dtype = dtype

    def __len__(self) -> int:
        """Return the number of windows."""
        return int(self.ends[-1])

    def first_sample(self, index: Tensor) -> Tensor:
        """Return the row of `flat`, shape (B,), at which each window of `index`, shape (B,), begins."""
        return self.firsts[torch.searchsorted(self.ends, index, right=True)] + index

    def speeds(self) -> Tensor:
        """Return how fast momenta change over the first step of each window, shape (windows,), mean 1."""
        rows = self.first_sample(torch.arange(len(self), device=self.flat.device))
        momenta = self.flat.chunk(2, dim=-1)[1]
        speed = (momenta[rows + 1] - momenta[rows]).norm(dim=-1)
        if self.dt is None:
            speed = speed / (self.times[rows + 1] - self.times[rows])
        return speed / speed.mean()

    def gather(self, index: Tensor) -> Window:
        """Return the windows of `index`, shape (B,), as one batch."""
        rows = self.first_sample(index).unsqueeze(-1) + self.offsets
        states = self.flat[rows]
        increments = states[:, 1:] - states[:, :-1]
        dt = self.dt if self.dt is not None else self.times[rows].diff(dim=-1).to(self.dtype)
        return Window(states[:, 0].to(self.dtype), increments.to(self.dtype), dt)

    def to(self, device: torch.device) -> None:
        """Move samples and index tables to a device, once; batches are then gathered there."""
        for name in ("flat", "times", "ends", "firsts", "offsets"):
            setattr(self, name, getattr(self, name).to(device))


def require_span(steps: int, longest: int) -> None:
    """Raise UserError for windows of no step, or of more than the longest stretch of samples has."""
    if not 1 <= steps <= longest:
        message = (
            f"window, loss.order: expected windows of 1 to {longest} steps, the longest stretch of samples "
            f"without a gap; received {steps}. Shorten the windows, or set loss.derivative=0"
        )
        raise UserError(message)


def stretches(present: Tensor) -> tuple[Tensor, Tensor]:
    """Return where each run of samples without a gap begins and how long it is, in rows of the flat samples.

    Args:
        present: (B, T) bool; a run ends with its trajectory.

    Returns:
        Two tensors (R,) int64, in the order of the samples.
    """
    edges = torch.nn.functional.pad(present.to(torch.int8), (1, 1)).diff(dim=1)
    begins, ends = (edges == 1).nonzero(), (edges == -1).nonzero()
    firsts = begins[:, 0] * present.shape[1] + begins[:, 1]
    return firsts, ends[:, 1] - begins[:, 1]
