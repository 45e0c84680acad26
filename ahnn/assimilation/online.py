"""Online filter of one object, with methods update, save and load."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import torch
from torch import Tensor

from ahnn.arguments import Count, Finite, Positive, Within, checked
from ahnn.assimilation.cells import BadLine
from ahnn.assimilation.fixed_lag import smoothed_at
from ahnn.assimilation.instrument_reading import Reading
from ahnn.assimilation.late_readings import KeptReading, ReadingWindow
from ahnn.assimilation.reading_runs import FollowedRun, ReadingRuns
from ahnn.assimilation.stream_controls import StreamControls
from ahnn.assimilation.stream_estimate import Estimate, Outcome, covariances
from ahnn.assimilation.stream_identity import refusal
from ahnn.assimilation.stream_models import FURTHEST, StreamModels
from ahnn.assimilation.stream_sensor import StreamSensor
from ahnn.controls import ControlTable
from ahnn.errors import UserError
from ahnn.estimation import Belief, EstimatorState, Innovation, Status, load_notes, load_state, save_state
from ahnn.estimation.gaussian import GaussianFilter
from ahnn.estimation.process_model import Process, StepLaw


class Diverged(RuntimeError):
    """The filter has diverged; the message states the cause."""


class Assimilation:
    """Filter that processes readings as they arrive, and can be saved and resumed after any reading.

    Args:
        process: the estimator and its process model.
        sensors: sensors by name; a reading without a name belongs to the only sensor.
        start: belief about the state, of one member.
        time: time of the belief.
        window: maximum delay of a late reading, which is inserted at its time while later ones are replayed.
        lines: maximum number of readings kept for replay.
        gap: maximum time ahead of an accepted reading; None: 10,000 steps of the flow.
        controls: controls of the process model, known in advance; None: the readings contain them.
        lag: delay of additional estimates, smoothed with all later readings; None: no smoothing.

    Raises:
        UserError: a value beyond its limits, a start of several members, controls of a different model, or a
            lag with a filter that is not Gaussian.
    """

    @checked
    def __init__(
        self,
        process: Process,
        sensors: Mapping[str, StreamSensor],
        start: Belief,
        *,
        time: Finite = 0.0,
        window: Annotated[float, Within(0)] = 0.0,
        lines: Count = 1000,
        gap: Positive | None = None,
        controls: ControlTable | None = None,
        lag: Positive | None = None,
    ) -> None:
        if lag is not None and not isinstance(process.estimator, GaussianFilter):
            message = (
                f"lag: expected a Gaussian filter, such as ukf or ekf; received {process.estimator.name}"
            )
            raise UserError(message)
        if len(start.mean) != 1:
            message = f"start: expected a belief about one state; received {tuple(start.mean.shape)}"
            raise UserError(message)
        self.sensors, self.span, self.lines, self.lag = dict(sensors), window, lines, lag
        self.gap = FURTHEST * process.max_step if gap is None else gap
        self.size, self.spread = start.mean.shape[-1], start.chol
        self.controls = StreamControls.of(process.flow, controls, time)
        with torch.inference_mode():
            self.models = StreamModels(process, sensors)
            self.errors, self.process = self.models.errors, self.models.process
            self._runs = None if lag or self.controls.size else ReadingRuns(self.models, self.gap)
            self._factors = {
                name: sensor.factor(None) for name, sensor in self.sensors.items() if sensor.deviations
            }
            state = self.process.estimator.start(self.process.lifted(start), time)
            self.window = ReadingWindow(state, float(time), self.controls.unknown)
            mean, covariance = start.mean[0].tolist(), start.covariance[0].tolist()
            self.begun = {"start": mean, "start_sd": covariance, "time": float(time)}
            # so that the first line need not wait for the initialisation
            self.process.advanced(state, time, time + process.max_step, self.controls.trial)

    def update(self, reading: Reading) -> Estimate:
        """Process a reading, merging a late one at its time, and return the estimate after it.

        Raises:
            UserError: an unknown sensor, a wrong number of values, or missing or invalid controls.
            BadLine: values that give no finite, precise estimate; the previous state is kept.
            Diverged: the filter has diverged; the state before the reading is kept.
        """
        return self.updates((reading,))[0]

    @torch.inference_mode()
    def updates(self, readings: Sequence[Reading]) -> list[Estimate]:
        """Process the first reading and those after it that need no decision, bit-identically to `update`.

        Returns:
            The estimates after the readings that were processed, at least one.

        Raises:
            UserError, BadLine, Diverged: as in `update`, for the first reading.
        """
        first = self._named(readings[0])
        run = self._runs and self._runs.followed(self.window, (first, *readings[1:]))
        return self._of_run(run) if run else [self._of_one(first)]

    def _of_run(self, run: FollowedRun) -> list[Estimate]:
        """Return the estimates after a sequence of readings, and keep its last readings in the window."""
        self.window = run.window(self.window, self.span, self.lines)
        parts = run.rows.means[:, : self.size], covariances(run.rows.chols)[:, : self.size, : self.size]
        rows = zip(run.readings, *(part.unbind() for part in parts), run.innovations, strict=True)
        return [Estimate("taken", reading.time, *results) for reading, *results in rows]

    def _of_one(self, reading: Reading) -> Estimate:
        """Process one reading; raises the same errors as `update`."""
        now = self.window.time
        if reading.time > now + self.gap:
            return self._estimate("ahead")
        if reading.time < max(now - self.span, self.window.since):
            return self._estimate("late")
        if self.window.holds(reading):
            return self._estimate("repeated")
        after = self.window.before(reading.time)
        later = self.window.entries[len(after.entries) :]
        place = len(after.entries)
        for one in (reading, *(entry.reading for entry in later)):
            after = self._added(after, one)
        innovation, opened = after.entries[place].innovation, after.entries[place].opened
        self.window = after.kept(max(self.span, self.lag or 0.0), self.lines)
        outcome = "rejected" if bool(innovation.rejected) else "predicted" if reading.is_empty else "taken"
        return self._estimate("reopened" if opened else outcome, innovation, len(later))

    @property
    def modes(self) -> tuple[float, ...]:
        """Probabilities of the modes of interacting models; () for other filters."""
        found: Tensor | None = getattr(self.window.state, "probabilities", None)
        return () if found is None else tuple(found[0].tolist())

    @property
    def biases(self) -> dict[str, list[tuple[float, float]]]:
        """Estimated biases of each sensor's columns with standard deviations, 0 for columns without bias."""
        if self.errors is None:
            return {}
        mean, chol = self.window.state.moments
        values, sds = (
            mean[0, -self.errors.added :].tolist(),
            chol[0, -self.errors.added :].norm(dim=-1).tolist(),
        )
        pairs = [*zip(values, sds, strict=True)]
        places = self.errors.places.items()
        return {name: [(0.0, 0.0) if k is None else pairs[k] for k in own] for name, own in places}

    def save(self, path: str | Path, notes: Mapping[str, str] | None = None) -> None:
        """Save the complete state atomically, for resuming.

        Args:
            path: path of the file.
            notes: additional strings saved with the state.
        """
        window = self.window
        readings = json.dumps([entry.reading for entry in window.entries])
        own = {"readings": readings, "of": self.identity, "held": json.dumps(window.held)}
        own["controls"] = self.controls.hash_before(window.time)
        save_state(window.anchor, path, {**(notes or {}), **own})

    @torch.inference_mode()
    def load(self, path: str | Path) -> dict[str, str]:
        """Restore the state written by `save`, and return its notes.

        Raises:
            UserError: a missing or damaged file, or one saved with a different process, sensors or window.
        """
        try:
            state, notes = load_state(path, like=self.window.anchor), load_notes(path)
            window = ReadingWindow(state, float(state.time), tuple(json.loads(notes["held"])))
            found = [Reading.of_plain(*parts) for parts in json.loads(notes["readings"])]
            others = self._others(path, notes, found[-1].time if found else window.time)
            for reading in () if others else found:
                window = self._added(window, self._named(reading))
        except (OSError, ValueError, KeyError, TypeError, RuntimeError) as error:
            message = f"state: expected a file written by save; received {path} ({error})"
            raise UserError(message) from error
        if others:
            raise UserError(others)
        self.window = window
        return notes

    @property
    def identity(self) -> str:
        """Hashes of everything that determines estimates except start and readings."""
        limits = {"window": self.span, "lines": self.lines, "gap": self.gap, "lag": self.lag}
        return self.models.identity({**limits, "step": self.process.max_step})

    def _others(self, path: str | Path, notes: Mapping[str, str], time: float) -> str:
        """Return an error message for a saved state with different settings; "" if they are equal."""
        if notes["of"] != self.identity:
            return refusal(path, notes["of"], self.identity)
        if notes["controls"] != self.controls.hash_before(time):
            return (
                f"controls: expected the controls stored in {path} up to time {time:g}; received different "
                "controls. Use the same controls, with new rows only at the end, or start over with a new "
                "state and output"
            )
        return ""

    def _named(self, reading: Reading) -> Reading:
        """Return the reading with its sensor name filled in, if it has values."""
        self.controls.require_fitting(reading)
        if not math.isfinite(reading.time):
            message = f"reading: expected a finite time; received {reading}"
            raise UserError(message)
        if not (reading.sensor or reading.values):
            return reading
        if not reading.sensor and len(self.sensors) == 1:
            reading = reading._replace(sensor=next(iter(self.sensors)))
        sensor = self.sensors.get(reading.sensor)
        if sensor is None:
            message = f"sensor: expected one of {', '.join(self.sensors)}; received {reading.sensor!r}"
            raise UserError(message)
        if len(reading.values) != len(sensor.columns):
            message = f"reading: expected a time and {', '.join(sensor.columns)}; received {reading}"
            raise UserError(message)
        if reading.deviations is None and sensor.deviations is None:
            message = f"sd: expected standard deviations of {reading.sensor}; received none"
            raise UserError(message)
        return reading

    def _added(self, window: ReadingWindow, reading: Reading) -> ReadingWindow:
        """Return the window with a reading appended."""
        held = window.controls
        controls = self.controls.between(held, window.time, reading.time)
        laws: list[StepLaw] = []
        way_back = None if self.lag is None else laws
        state = self.process.advanced(window.state, window.time, reading.time, controls, way_back)
        innovation, opened = Innovation.of_nothing(state.moments.mean[:, :0]), False
        if reading.values:
            state, innovation, opened = self._updated(state, reading)
        if status := int(state.status):
            raise Diverged(lost_filter(status, reading.time, reading.sensor))
        controls = self.controls.after(held, reading)
        entry = KeptReading(reading.time, reading, state, innovation, controls, opened, tuple(laws))
        return window._replace(entries=(*window.entries, entry))

    def _updated(self, before: EstimatorState, reading: Reading) -> tuple[EstimatorState, Innovation, bool]:
        """Condition the state on a reading; return it, the innovation and `opened`; raises BadLine."""
        own, model = reading.deviations, self.models.seen[reading.sensor]
        factor = self._factors[reading.sensor] if own is None else self.sensors[reading.sensor].factor(own)
        y = torch.tensor([reading.values], dtype=torch.float64)
        state, innovation = self.process.estimator.update(before, y, model, factor)
        opened = False
        if bool(self.models.beyond_patience(state, innovation, y)):
            wide, updated, taken = self.models.reopened(before, y, model, factor, self.spread)
            if opened := bool(taken):
                state, innovation = wide, updated
        if bool(self.models.at_fault(reading.sensor, (before, state), innovation, y, model)):
            columns = self.sensors[reading.sensor].columns
            said = [f"{name} {value:g}" for name, value in zip(columns, reading.values, strict=True)]
            raise BadLine(absurd_numbers(said, reading.deviations or ()))
        return state, innovation, opened

    def _estimate(
        self, outcome: Outcome, innovation: Innovation | None = None, replayed: int = 0
    ) -> Estimate:
        mean, chol = self.window.state.moments
        covariance, time = covariances(chol[0, : self.size, : self.size]), self.window.time
        smoothed = None if self.lag is None else smoothed_at(self.window, time - self.lag)
        details = innovation, replayed, self.modes, smoothed
        return Estimate(outcome, time, mean[0, : self.size], covariance, *details)


def absurd_numbers(said: list[str], deviations: Sequence[float]) -> str:
    """Return the message for values too extreme for a filter, given as text."""
    received = ", ".join([*said, *(f"sd {sd:g}" for sd in deviations)])
    return f"expected values that give a finite, precise estimate; received {received}"


def lost_filter(status: int, time: float, sensor: str) -> str:
    """Return the message for a diverged filter, with time and, if relevant, sensor."""
    by = f", by sensor {sensor}" if sensor else ""
    return (
        f"expected a filter that follows its measurements; received {Status(status).name} at time "
        f"{time:g}{by}"
    )
