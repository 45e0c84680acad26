"""Reading and reduction of a run's arrays for figures."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from ahnn.contents import require_regular
from ahnn.errors import UserError
from ahnn.evaluation.titles import estimator_title
from ahnn.metrics import errors
from ahnn.systems import System
from ahnn.types import Space
from ahnn_plugins.report.collection import PREDICTIONS, Entry
from ahnn_plugins.report.figures.equations import system_of
from ahnn_plugins.report.scores import plain_filter

HOURS = 7200.0
"""Duration in seconds above which a time axis uses hours."""
STARTS = ("true", "perturbed", "fitted")


class Teeth(NamedTuple):
    """Filter estimates along one trajectory, alternately before and after updates.

    Attributes:
        time: (K,) times.
        truth, mean, deviation: (K, D), velocities in place of momenta.
        updates: (K,) bool, whether the entry is after an update.
        member: index of the trajectory.
    """

    time: Tensor
    truth: Tensor
    mean: Tensor
    deviation: Tensor
    updates: Tensor
    member: int


class Kept(NamedTuple):
    """Reduced arrays of a run.

    Attributes:
        entry: run.
        slot: slot of its model.
        system: equations of its system, or None if unknown.
        time: (T,) since the start, in `unit`.
        unit: unit of time.
        known: reference of predictions: `truth`, `test data` or `measurements`.
        members: number of test trajectories.
        path: (T, D) reference path of the first of them.
        first: predicted first trajectory, (T, D), by start, such as `true`, and by `floor`.
        rms: root mean square over trajectories of the errors, (T, D + 2): of each component, then norms of
            position and velocity; by `true`, `floor_true`, `ukf/true` and so on.
        averages: stored moving averages of norms, (2, T), by `ukf/floor_true` and so on.
        nees: mean NEES over trajectories, (T,), by start.
        teeth: filter estimates, by start.
        deviations: (T, D) standard deviations of the first trajectory, if the parameter covariance is known.
    """

    entry: Entry
    slot: int
    system: System | None
    time: Tensor
    unit: str
    known: str
    members: int
    path: Tensor
    first: dict[str, Tensor]
    rms: dict[str, Tensor]
    averages: dict[str, Tensor]
    nees: dict[str, Tensor]
    teeth: dict[str, Teeth]
    deviations: Tensor | None

    @property
    def filter(self) -> str:
        """Name of the filter in figures."""
        return estimator_title(plain_filter([self.entry]))

    @property
    def space(self) -> Space:
        """Description of the state components."""
        return self.entry.results.space

    @property
    def start(self) -> str:
        """Start of the plotted rollouts."""
        return next(start for start in (*STARTS, "") if start in self.first or not start)


def kept(entry: Entry, slot: int) -> Kept | None:
    """Reduce the arrays of a run for figures; None without saved predictions.

    Raises:
        UserError: the file is damaged, or contains arrays of wrong shapes.
    """
    path = entry.folder / PREDICTIONS
    if not path.exists():
        return None
    try:
        require_regular(path)
        with safe_open(str(path), "pt") as file:
            return _reduced(Arrays(path, file, set(file.keys())), entry, slot)
    except (SafetensorError, OSError) as error:
        message = f"{path}: expected the arrays of an evaluation; received: {error}. Evaluate the run again"
        raise UserError(message) from error


class Arrays(NamedTuple):
    """Open array file."""

    path: Path
    file: Any
    keys: set[str]

    def get(self, key: str, shape: tuple[int | None, ...]) -> Tensor | None:
        """Return an array as float64, None if missing; raises UserError for a wrong shape."""
        if key not in self.keys:
            return None
        array = self.file.get_tensor(key)
        same = [n in (m, None) for m, n in zip(array.shape, shape, strict=False)]
        if array.ndim != len(shape) or not all(same):
            words = ", ".join("any" if n is None else str(n) for n in shape)
            message = (
                f"{self.path}: {key}: expected shape ({words}); received {tuple(array.shape)}. Evaluate the "
                "run again"
            )
            raise UserError(message)
        return array.double()


def _reduced(arrays: Arrays, entry: Entry, slot: int) -> Kept | None:
    space, system = entry.results.space, system_of(entry)
    size = 2 * space.dof
    known = "truth" if "truth" in arrays.keys else "measurements"
    truth = arrays.get(known, (None, None, size))
    if truth is None or not truth.numel():
        return None
    batch, samples, _ = truth.shape
    times = arrays.get("times", (batch, samples))
    time, unit = _time(times, samples, space.units.time)
    sigma = arrays.get("true_start_deviations", truth.shape)
    found = Kept(
        *(entry, slot, system, time, unit),
        "test data" if known == "truth" and not _has_floor(entry) else known,
        *(batch, truth[0].clone(), {}, {}, {}, {}, {}),
        None if sigma is None else sigma[0].clone(),
    )
    own = plain_filter([entry])
    for start in STARTS:
        for key, name in _names(start, own):
            states = arrays.get(key, (batch, samples, size))
            if states is None:
                continue
            # Members lost by a filter are excluded, as in its figures; a diverged rollout has infinite error.
            error = states - truth if name.startswith("ukf/") else errors(states, truth)
            found.rms[name] = _rms(error, space.divisor)
            found.first[name] = states[0].clone()  # copied, since a view would keep the full array
        nees = arrays.get(f"{own}/{start}_nees", (batch, samples))
        average = arrays.get(f"{own}/{start}_sma_floor", (2, samples))
        teeth = _teeth(arrays, f"{own}/{start}", truth, time, space.divisor)
        found.nees.update({} if nees is None else {start: nees.nanmean(0)})
        found.averages.update({} if average is None else {f"ukf/floor_{start}": average.clone()})
        found.teeth.update({} if teeth is None else {start: teeth})
    return found


def _names(start: str, own: str) -> tuple[tuple[str, str], ...]:
    """Return the keys of a start's rollouts in the file, each with its name in `Kept`."""
    return (
        (f"{start}_start", start),
        (f"floor_{start}_start", f"floor_{start}"),
        (f"{own}/{start}_start", f"ukf/{start}"),
    )


def _has_floor(entry: Entry) -> bool:
    """Return whether the equations were known to the evaluation."""
    return any(row.who.floor for row in entry.results.rows)


def _time(times: Tensor | None, samples: int, unit: str) -> tuple[Tensor, str]:
    """Return the mean times since the start, (T,), with their unit, or sample numbers."""
    numbers = torch.arange(samples, dtype=torch.float64)
    if times is None:
        return numbers, "samples"
    elapsed = (times - times[:, :1]).nanmean(0)
    step = float(elapsed.diff().nanmean()) if samples > 1 else 1.0
    time = elapsed.where(elapsed.isfinite(), step * numbers)
    return (time / 3600, "h") if unit == "s" and float(time[-1]) > HOURS else (time, unit)


def velocities(states: Tensor, inertia: float | Tensor) -> Tensor:
    """Return states (..., D) with p / m in place of momenta p, NaN where they are not finite."""
    position, momentum = states.chunk(2, dim=-1)
    both = torch.cat((position, momentum / inertia), dim=-1)
    return both.masked_fill(~both.isfinite(), torch.nan)


def _rms(error: Tensor, inertia: float | Tensor) -> Tensor:
    """Return rms errors over trajectories, (T, D + 2), of components and of the norms of both blocks."""
    position, momentum = error.chunk(2, dim=-1)
    squares = torch.cat((position, momentum / inertia), dim=-1).square()
    norms = [block.sum(-1, keepdim=True) for block in squares.chunk(2, dim=-1)]
    return torch.cat((squares, *norms), dim=-1).nanmean(0).sqrt()


def _teeth(arrays: Arrays, prefix: str, truth: Tensor, time: Tensor, inertia: float | Tensor) -> Teeth | None:
    """Return a filter's estimates along its plotted trajectory; None if they were not saved."""
    shape = (2 * len(time) - 1, truth.shape[-1])
    mean = arrays.get(f"{prefix}_sawtooth_mean", shape)
    deviation = arrays.get(f"{prefix}_sawtooth_deviation", shape)
    number = arrays.get(f"{prefix}_sawtooth_member", (1,))
    if mean is None or deviation is None or number is None or float(number) not in range(len(truth)):
        return None
    sample = torch.arange(len(time)).repeat_interleave(2)[1:]
    changed = ((mean[1:] != mean[:-1]) | (deviation[1:] != deviation[:-1])).any(-1)
    after = torch.cat((torch.zeros(1, dtype=torch.bool), changed & (sample[1:] == sample[:-1])))
    exact, mean, deviation = (velocities(x, inertia) for x in (truth[int(number), sample], mean, deviation))
    return Teeth(time[sample], exact, mean, deviation, after, int(number))
