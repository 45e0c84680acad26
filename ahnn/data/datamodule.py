"""DataModule of all models: batches of windows from trajectories."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import cached_property
from typing import Annotated, Any, Literal, Protocol

import torch
from lightning import LightningDataModule, Trainer
from torch import Tensor

from ahnn.arguments import Count, Seed, Within, checked
from ahnn.data.grouped_loader import GroupedLoader
from ahnn.data.loader import CPU, EpochLoader, SegmentLoader, WindowLoader
from ahnn.data.measured_statistics import EXAMPLES, measured_statistics
from ahnn.data.noise_floor import remark_on
from ahnn.data.segments import Segments, whole
from ahnn.data.sensor import Sensor
from ahnn.data.sources import Source
from ahnn.data.splits import Split, SplitData
from ahnn.data.windows import Windows, on_clock, require_span
from ahnn.errors import UserError
from ahnn.measurements import Instrument, Observations, Segment, reading
from ahnn.measurements.smoothing import Local, as_states, smoothed
from ahnn.memory import require_memory
from ahnn.statistics import Statistics
from ahnn.types import Trajectories

log = logging.getLogger("ahnn")

EXACT = 20_000
"""Approximate number of exact states used as examples of the training split."""


class Stages(Protocol):
    """Segments of measurements that grow from stage to stage."""

    def intervals(self, epoch: int, epochs: int) -> int | None:
        """Return the intervals per segment in an epoch; None: full trajectories."""
        ...

    def segments_per_step(self, epoch: int, epochs: int) -> int | None:
        """Return the segments per step in an epoch; None: `data.batch_size`."""
        ...


@checked
class WindowDataModule(LightningDataModule):
    """Sliding windows of trajectories, split by trajectory.

    Args:
        source: source of the trajectories.
        split: fractions of train, val and test.
        window: number W of steps per window.
        batch_size: windows per optimiser step.
        windows_per_epoch: windows drawn per epoch, different each time; None for all.
        emphasis: 0 for uniform sampling of training windows; values up to 4 sample in proportion to this
            power of the rate of momentum change. On eccentric orbits most samples lie far from perigee, where
            little happens.
        val_windows: number of evenly spread validation windows; None for all.
        precision: 32 or 64 bits for the batches.
        order_seed: seed of the batch order.
        sensor: sensor of the training data; None for exact states.
    """

    def __init__(
        self,
        source: Source,
        *,
        split: list[float],
        window: Count,
        batch_size: Count,
        windows_per_epoch: Count | None,
        emphasis: Annotated[float, Within(0, 4)],
        val_windows: Count | None,
        precision: Literal[32, 64],
        order_seed: Seed,
        sensor: Sensor | None = None,
    ) -> None:
        super().__init__()
        self.source, self.sensor = source, sensor
        self.splits = SplitData(source, split, sensor)
        self.stages: Stages | None = None
        self.epochs = 1
        self.clock = 0
        self._cut: dict[int | None, Segments] = {}
        self._too_long: set[int] = set()
        self._windows: dict[tuple[Split, int], Windows] = {}
        self.window, self.span, self.batch_size = window, window, batch_size
        self.windows_per_epoch, self.val_windows = windows_per_epoch, val_windows
        self.dtype = {32: torch.float32, 64: torch.float64}[precision]
        self.emphasis, self.orders = emphasis, [order_seed]

    def require_span(self, steps: int, clock: int = 0) -> None:
        """Require training windows of a minimum length, since derivatives may need more than W steps.

        Args:
            steps: minimum number of steps per window.
            clock: number of clock coordinates required by the dynamics.

        Raises:
            UserError: the trajectories, if their length is known in advance, are shorter.
        """
        self.span, self.clock = max(self.window, steps), clock
        truth: Any = self.source.truth
        if truth is not None and getattr(truth, "periods", None) is None:
            require_span(self.span, truth.steps, self.window)

    def trajectories(self, split: Split) -> Trajectories:
        """Return the trajectories of a split, with measured instead of true states if applicable."""
        return self.splits[split] if self.sensor is None else Trajectories(*self.measured(split))

    def measured(self, split: Split) -> Observations:
        """Return the measurements of a split, for training on measurements."""
        return self.splits.measured(split)

    @cached_property
    def smooth(self) -> Local:
        """Local polynomials at some training measurements, from which scalings and widths are derived."""
        return smoothed(self.splits.instrument(), *self.measured("train"), EXAMPLES)

    @cached_property
    def instrument(self) -> Instrument:
        """Instrument of the measurements, with the smoothness of the motion relative to their noise."""
        return self.splits.instrument()._replace(width=self.smooth.width)

    def statistics(self) -> Statistics:
        """Return the statistics of the training split, float64, from smoothed samples if measured."""
        if self.sensor is None:
            return Statistics.of(self.trajectories("train"))
        return measured_statistics(self.smooth, self.instrument, self.measured("train"))

    def examples(self) -> Tensor:
        """Return training states (M, D) float64, smoothed if measured."""
        if self.sensor is None:
            some = self.trajectories("train").spread()
            states = some.states[some.present]
            return states[:: max(1, len(states) // EXACT)]
        return as_states(self.smooth.value, self.smooth.rate, self.instrument)

    def remark(self) -> str | None:
        """Return a remark for the user on the noise of the training data, or None."""
        if self.sensor is None:
            some = self.trajectories("train").spread()
            units = reading("state", self.source.space).units
            return remark_on(some.states, some.times, self.source.space.components, units, None)
        if self.sensor.unknown.sizes:
            return None
        stated = None if self.stages is None else self.sensor.deviations
        seen = self.sensor.measurement
        return remark_on(*self.measured("train"), seen.names, seen.units, stated)

    def feed(self, trainer: Trainer) -> None:
        """Gather batches on the trainer's device; to be called before the first batch is requested."""
        self.trainer = trainer

    def follow(self, stages: Stages, epochs: int) -> None:
        """Provide growing segments of measurements over the epochs, instead of windows.

        Raises:
            UserError: there are no measurements, or `emphasis` is not 0.
        """
        if self.sensor is None:
            message = (
                "loss.stages: expected measurements; received exact states. Set data.noise, or choose "
                "recipe=second_order"
            )
            raise UserError(message)
        if self.emphasis:
            message = (
                f"data.emphasis: expected 0, since all segments are equally likely; received {self.emphasis}"
            )
            raise UserError(message)
        self.stages, self.epochs = stages, epochs

    def group(self, seeds: Sequence[int]) -> None:
        """Provide concatenated batches of several training runs, each in its own order."""
        self.orders = [*seeds]

    def train_dataloader(self) -> EpochLoader:
        """Return shuffled training batches, or those of several training runs."""
        loaders = [self._ordered(seed) for seed in self.orders]
        return loaders[0] if len(loaders) == 1 else GroupedLoader(loaders)

    def _ordered(self, seed: int) -> WindowLoader | SegmentLoader:
        if self.stages is None:
            return self._loader("train", self.span, self.windows_per_epoch, seed, self.emphasis)
        steps = max(1, (self.windows_per_epoch or self.batch_size) // self.batch_size)
        return SegmentLoader(self._stage, steps, seed, self._device)

    def val_dataloader(self) -> WindowLoader | SegmentLoader:
        """Return the validation batches, the same in every epoch."""
        if self.stages is None:
            return self._loader("val", self.window, self.val_windows, None)
        judged = self.measured("val").part(slice(self.val_windows))
        segments = Segments(judged, None, self.instrument)
        return SegmentLoader(lambda _: (segments, len(segments)), 0, 0, self._device)

    @property
    def _device(self) -> torch.device:
        """Device of the batches of measurements."""
        return CPU if self.trainer is None else self.trainer.strategy.root_device

    def whole(self, split: Split) -> Segment:
        """Return all measurements of a split on the CPU, one segment per trajectory."""
        return whole(self.measured(split), self.instrument)

    def _stage(self, epoch: int) -> tuple[Segments, int]:
        """Return the segments of an epoch, and their number per step."""
        assert self.stages is not None
        intervals = self.stages.intervals(epoch, self.epochs)
        if intervals not in self._cut:
            self._cut = {intervals: Segments(self.measured("train"), intervals, self.instrument)}
        segments = self._cut[intervals]
        if intervals is not None and segments.intervals < intervals and intervals not in self._too_long:
            self._too_long.add(intervals)
            what = "loss.stages: no trajectory has %d intervals (at most %d): that stage fits full ones"
            log.info(what, intervals, segments.intervals)
        asked = self.stages.segments_per_step(epoch, self.epochs) or self.batch_size
        return segments, asked if intervals is None else min(asked, segments.covering)

    def transfer_batch_to_device(self, batch: Any, device: torch.device, dataloader_idx: int) -> Any:
        """Return the batch unchanged: loaders gather batches on the device."""
        return batch

    def _loader(
        self, split: Split, span: int, limit: int | None, seed: int | None, emphasis: float = 0.0
    ) -> WindowLoader:
        if (split, span) not in self._windows:
            data = on_clock(self.trajectories(split), self.clock)
            self._windows[split, span] = Windows(data, span, self.dtype, self.window)
        windows = self._windows[split, span]
        size = 16.0 * min(self.batch_size, len(windows)) * (span + 1) * windows.flat.shape[-1]
        require_memory("data.batch_size", "the windows of a batch", size)
        if emphasis:
            require_memory("data.emphasis", "the speeds of all windows", 24.0 * len(windows))
        if self.trainer is None:
            return WindowLoader(windows, self.batch_size, limit, seed, emphasis)
        windows.to(self.trainer.strategy.root_device)
        place = self.trainer.global_rank, self.trainer.world_size
        return WindowLoader(windows, self.batch_size, limit, seed, emphasis, *place)
