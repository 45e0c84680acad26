"""Training, validation and test splits by trajectory, common to all models."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, Literal

from torch import Tensor

from ahnn.data.files.samples import cut_for_splits
from ahnn.data.fingerprints import recognised, remembered
from ahnn.data.noise_floor import differences_level, looked_at
from ahnn.data.sensor import Sensor
from ahnn.data.sources import Observed, Source
from ahnn.errors import UserError
from ahnn.measurements import Instrument, Observations
from ahnn.measurements.smoothing import momenta_are_sparse
from ahnn.statistics import sampling_interval
from ahnn.types import Trajectories

Split = Literal["train", "val", "test"]
SPLITS: tuple[Split, ...] = ("train", "val", "test")
SAME, OTHERS = "the test split of the run's data", "trajectories other than the training data"


class SplitData:
    """Trajectories of a source in three splits, read on first access.

    Args:
        source: source of the trajectories.
        split: fractions of train, val and test.
        sensor: sensor of the training data; None for exact states.
    """

    def __init__(self, source: Source, split: list[float], sensor: Sensor | None = None) -> None:
        self.source, self.sensor = source, sensor
        self.fractions = split
        check_fractions(split)
        self._parts: dict[Split, Trajectories] = {}
        self._rows: dict[Split, slice] = {}
        self._measured: dict[Split, Observations] = {}

    def __getitem__(self, split: Split) -> Trajectories:
        """Return the trajectories of a split."""
        if not self._parts:
            data = self.source.read()
            begin = 0
            sizes = split_sizes(len(data.states), self.fractions, samples=data.states.shape[1])
            for name, size in zip(SPLITS, sizes, strict=True):
                self._rows[name] = slice(begin, begin + size)
                self._parts[name] = data.part(self._rows[name])
                begin += size
        return self._parts[split]

    def seen(self) -> list[int]:
        """Return fingerprints of the training and validation trajectories, for `beside`."""
        return remembered(self["train"]) + remembered(self["val"])

    def beside(self, known: dict[str, Any] | None, seen: Sequence[int] = ()) -> str:
        """Return the relation of the test trajectories to the data of a training run; SAME if unchanged.

        Args:
            known: `recipe` and `split` of the training; None if not recorded.
            seen: fingerprints of the training data, as returned by `seen`; not recorded by earlier versions.

        Raises:
            UserError: some test trajectories are, or may be, identical to training trajectories.
        """
        if known is None:
            return "unknown training data"
        recipe = self.source.recipe()
        if known["recipe"] != recipe:
            if "files" in recipe and recipe["files"] == known["recipe"].get("files"):
                message = (
                    f"system: expected the training files with their settings, {known['recipe']}; "
                    f"received {recipe}, whose test trajectories may be part of the training data"
                )
                raise UserError(message)
            return self._others(_difference(known["recipe"], recipe), seen)
        if known["split"] == list(self.fractions):
            return SAME
        count = len(self.source.read().states)
        then, now = (split_sizes(count, fractions) for fractions in (known["split"], self.fractions))
        if (part := then[0] + then[1] - now[0] - now[1]) > 0:
            message = (
                "data.split: expected test trajectories not used in training; received "
                f"{self.fractions}, and {part} of {now[2]} were used. Keep the split of the run, "
                f"{known['split']}, or use another seed"
            )
            raise UserError(message)
        return "a part of the test split of the run's data"

    def _others(self, what: str, seen: Sequence[int]) -> str:
        """Return how the data differ, `what`; raises UserError for a test trajectory used in training."""
        count = len(self["test"].states)
        if known := recognised(self["test"], seen):
            message = (
                "test data: expected trajectories not used in training; received "
                f"{count}, {known} of them with samples of the training or validation data. Keep the data "
                "and the split of the run, or use other data"
            )
            raise UserError(message)
        return what + ("; none was used in training" if seen else "")

    def measured(self, split: Split) -> Observations:
        """Return the measurements of a split."""
        assert self.sensor is not None
        if split not in self._measured:
            truth = self[split]
            if isinstance(self.source, Observed):
                self._measured[split] = self.source.observations().part(self._rows[split])
            else:
                self._measured[split] = self.sensor.measure(truth, SPLITS.index(split))
        return self._measured[split]

    def instrument(self) -> Instrument:
        """Return the instrument, with the maximum integrator step between its measurements."""
        assert self.sensor is not None
        spacing = sampling_interval(self["test"])
        found = self.sensor.instrument(float(spacing.nanmedian()) if isinstance(spacing, Tensor) else spacing)
        found = found._replace(sparse_momenta=self.momenta_are_sparse)
        return found._replace(deviations=self.level_of_noise) if self.sensor.unknown.sizes else found

    @cached_property
    def momenta_are_sparse(self) -> bool:
        """Whether the training measurements have too few momenta to estimate states from them."""
        assert self.sensor is not None
        return momenta_are_sparse(self.sensor.instrument(1.0), *self.measured("train"))

    @cached_property
    def level_of_noise(self) -> Tensor:
        """Standard deviations (M,) of the noise, estimated from differences of the training measurements.

        Raises:
            UserError: differences of several orders disagree.
        """
        assert self.sensor is not None
        level = differences_level(*looked_at(*self.measured("train")))
        if not bool((level > 0).all()):
            names = zip(self.sensor.measurement.names, level.tolist(), strict=True)
            message = (
                "data.noise: expected samples dense enough for a first estimate of the noise from their "
                f"differences; received sparser ones: {', '.join(name for name, sd in names if not sd > 0)}. "
                "Give standard deviations"
            )
            raise UserError(message)
        return level


def _difference(known: dict[str, Any], recipe: dict[str, Any]) -> str:
    """Return how the data of a recipe differ from those of the training."""
    if "files" in recipe and "files" in known:
        return "files other than the training data"
    if {**known, "code": None} == {**recipe, "code": None}:
        then, now = (set(dict(each.get("code", {})).items()) for each in (known, recipe))
        modules = ", ".join(sorted({name for name, _ in then ^ now}))
        return f"the test split of the run's data; the code of its system ({modules}) has changed since then"
    return OTHERS


def check_fractions(fractions: list[float]) -> None:
    """Raise UserError for fractions that are not three positive numbers with sum 1."""
    if not (len(fractions) == 3 and all(s > 0 for s in fractions) and abs(sum(fractions) - 1) <= 1e-9):
        expected = "three positive fractions that sum to 1 (train, val, test)"
        message = f"data.split: expected {expected}; received {fractions}"
        raise UserError(message)


def split_sizes(count: int, fractions: list[float], samples: int = 0) -> list[int]:
    """Return the number of trajectories per split; the first takes the remainder of rounding.

    A split that would be empty by rounding gets a trajectory of the largest one. `samples` is the number of
    samples of a trajectory, for the remedy of an error.

    Raises:
        UserError: fractions that are not three positive numbers with sum 1, or fewer than three trajectories.
    """
    check_fractions(fractions)
    rest = [round(fraction * count) for fraction in fractions[1:]]
    sizes = [count - sum(rest), *rest]
    if count < len(SPLITS):
        option = cut_for_splits(samples * count)
        example = f", for example {option}" if option else ""
        message = (
            f"data.split: expected at least one trajectory in each of {', '.join(SPLITS)}; received {count} "
            f"{'trajectory' if count == 1 else 'trajectories'}. Use more, or cut trajectories of files with "
            f"system.cut{example}"
        )
        raise UserError(message)
    while min(sizes) < 1:
        sizes[sizes.index(max(sizes))] -= 1
        sizes[sizes.index(min(sizes))] += 1
    return sizes
