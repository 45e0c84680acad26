"""Sliding windows by index arithmetic: no window is ever stored."""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.clock import extended
from ahnn.errors import UserError
from ahnn.statistics import sampling_interval
from ahnn.types import Trajectories, Window

STREAMED = 2**31
"""Size of states in bytes above which batches are gathered in advance."""
SPEEDS = 2**22
"""Number of windows whose speed is computed at once."""


class Windows:
    """All windows of W consecutive steps that fit inside single trajectories.

    Consecutive samples of a trajectory without a gap form a segment. Window i is found by arithmetic: its
    segment from the cumulative count of windows, its offset from the remainder. A window therefore contains
    neither samples of two trajectories nor missing samples.

    Args:
        trajectories: the data; kept in float64.
        steps: number W of steps per window, which spans W + 1 samples.
        dtype: dtype of the batches.
        window: number of recursive predictions; None: as many as steps. See `require_span`.

    Raises:
        UserError: no segment is long enough for a window.
    """

    def __init__(
        self, trajectories: Trajectories, steps: int, dtype: torch.dtype, window: int | None = None
    ) -> None:
        firsts, lengths = segments_of(trajectories)
        counts = (lengths - steps).clamp(min=0)
        require_span(steps, int(lengths.max()) - 1 if len(lengths) else 0, window)
        self.ends = counts.cumsum(0)
        self.firsts = firsts - (self.ends - counts)
        self.flat = trajectories.states.reshape(-1, trajectories.states.shape[-1])
        dt = sampling_interval(trajectories)
        self.dt = dt if isinstance(dt, float) else None
        self.times = trajectories.times[:0] if self.dt is not None else trajectories.times.reshape(-1)
        self.offsets = torch.arange(steps + 1)
        self.dtype = dtype
        self.device = self.flat.device

    def __len__(self) -> int:
        """Return the number of windows."""
        return int(self.ends[-1])

    def first_sample(self, index: Tensor) -> Tensor:
        """Return the row of `flat`, shape (B,), where each window of `index`, shape (B,), begins."""
        return self.firsts[torch.searchsorted(self.ends, index, right=True)] + index

    def speeds(self) -> Tensor:
        """Return the rate of momentum change over the first step of each window, (windows,), with mean 1."""
        momenta, found = self.flat.chunk(2, dim=-1)[1], []
        for index in torch.arange(len(self), device=self.flat.device).split(SPEEDS):
            rows = self.first_sample(index)
            speed = (momenta[rows + 1] - momenta[rows]).norm(dim=-1)
            found.append(speed if self.dt is not None else speed / (self.times[rows + 1] - self.times[rows]))
        speeds = torch.cat(found)
        return speeds / speeds.mean()

    def gather(self, index: Tensor) -> Window:
        """Return the windows of `index`, shape (B,), as one batch."""
        rows = self.first_sample(index).unsqueeze(-1) + self.offsets
        states = self.flat[rows]
        increments = states[:, 1:] - states[:, :-1]
        to = {"dtype": self.dtype, "device": self.device}
        dt = self.dt if self.dt is not None else self.times[rows].diff(dim=-1).to(**to)
        return Window(states[:, 0].to(**to), increments.to(**to), dt)

    @property
    def streamed(self) -> bool:
        """Whether batches may wait for a disk, or for transfer to a device."""
        return not self.flat.is_cuda and self.flat.nbytes > STREAMED

    def to(self, device: torch.device) -> None:
        """Move samples and index tables to a device once, if they fit; batches are then gathered there.

        Otherwise batches are gathered on the CPU and transferred one by one.
        """
        self.device = device
        if device.type == "cuda" and self.flat.nbytes > torch.cuda.mem_get_info(device)[0] / 2:
            return
        for name in ("flat", "times", "ends", "firsts", "offsets"):
            setattr(self, name, getattr(self, name).to(device))


def on_clock(trajectories: Trajectories, count: int) -> Trajectories:
    """Return trajectories of extended states with k = `count` clock coordinates; 0 leaves them unchanged.

    Raises:
        UserError: trajectories without controls, for dynamics with controls.
    """
    if (clock := trajectories.clock(count)) is None:
        return trajectories
    if clock.values.shape[-1] < count:
        message = "forces: expected trajectories with controls; received none"
        raise UserError(message)
    return trajectories._replace(states=extended(trajectories.states, clock))


def require_span(steps: int, longest: int, window: int | None = None) -> None:
    """Check that windows fit into the data.

    Args:
        steps: number of steps of the windows.
        longest: number of steps of the longest segment of samples without a gap.
        window: number W of recursive predictions; windows with more steps have them for derivatives of the
            data, and their number is the order of these. None: as many as steps.

    Raises:
        UserError: windows of no step, or longer than the longest segment; the message names W, the order, or
            both.
    """
    if longest < 1:
        expected = "at least two consecutive samples, to form windows"
        message = f"data: expected {expected}; received none"
        raise UserError(message)
    if 1 <= steps <= longest:
        return
    window = steps if window is None else window
    keys, received, remedies = [], [], []
    if not 1 <= window <= longest:
        keys, received = ["window"], [f"window={window}"]
        remedies = [f"window={longest}" + (" or less" if longest > 1 else "")]
    if steps > window:
        lower = f"loss.order={longest - longest % 2} or less, or " if longest > 1 else ""
        keys, received = [*keys, "loss.order"], [*received, f"loss.order={steps}"]
        remedies.append(f"{lower}loss.derivative=0, which fits no derivatives")
    message = (
        f"{', '.join(keys)}: expected windows of 1 to {longest} steps, the longest segment of samples "
        f"without a gap; received {', '.join(received)}. Set {', and '.join(remedies)}"
    )
    raise UserError(message)


def segments_of(trajectories: Trajectories) -> tuple[Tensor, Tensor]:
    """Return the segments of all trajectories, found part by part; see `segments`."""
    found, before = [], 0
    for part in trajectories.parts():
        firsts, lengths = segments(part.present)
        found.append((firsts + before, lengths))
        before += part.times.numel()
    firsts, lengths = zip(*found, strict=True)
    return torch.cat(firsts), torch.cat(lengths)


def segments(present: Tensor) -> tuple[Tensor, Tensor]:
    """Return the first row, in the flat samples, and the length of each run of samples without a gap.

    Args:
        present: (B, T) bool; a run ends with its trajectory.

    Returns:
        Two tensors (R,) int64, in the order of the samples.
    """
    there = present.to(torch.int8)
    outside = there.new_zeros(len(there), 1)
    edges = there.diff(dim=1, prepend=outside, append=outside)
    begins, ends = (edges == 1).nonzero(), (edges == -1).nonzero()
    firsts = begins[:, 0] * present.shape[1] + begins[:, 1]
    return firsts, ends[:, 1] - begins[:, 1]
