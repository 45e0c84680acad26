"""Estimator with process model, for measurements at arbitrary times."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple, cast

import torch
from torch import Tensor

from ahnn.controls import ControlTable
from ahnn.dynamics.flow_at_time import steered
from ahnn.estimation.belief import Belief
from ahnn.estimation.covariances import Covariance, Factor, covariance_factor
from ahnn.estimation.estimator import RecursiveEstimator, S
from ahnn.estimation.gaussian import GaussianFilter
from ahnn.estimation.member_steps import MemberFlow, member_rows, put_rows
from ahnn.estimation.results import Backward
from ahnn.estimation.state import FilterState
from ahnn.estimation.step_noise import process_factor
from ahnn.measurements import Measurement
from ahnn.substeps import substeps, substeps_of_each
from ahnn.types import Flow


def same(value: Any) -> Any:
    """Return the argument unchanged."""
    return value


class StepLaw(NamedTuple):
    """Data of a backward step: means (B, D) before the step and predicted after it, and the backward law."""

    before: Tensor
    predicted: Tensor
    backward: Backward


class Process(NamedTuple):
    """Estimator with its process model.

    Attributes:
        estimator: recursive estimator.
        flow: the process model.
        noise: Q of a step as a function of its length; an optional method `each` returns factors (B, D, D)
            for lengths (B,).
        max_step: longest step of the flow; longer gaps are divided into equal steps.
        lifted: map from a belief about the state to the augmented belief, whose first components are the
            state.
        seen: map from a measurement model of the state to one of the augmented state.
        about: plain values that identify the process.
    """

    estimator: RecursiveEstimator[Any]
    flow: Flow
    noise: Callable[[float], Covariance]
    max_step: float
    lifted: Callable[[Belief], Belief] = same
    seen: Callable[[Measurement], Measurement] = same
    about: dict[str, Any] = {}  # noqa: RUF012 - never written to

    def with_estimator(self, estimator: RecursiveEstimator[Any]) -> Process:
        """Return a copy with a different estimator, for example with a different gate."""
        about = getattr(estimator, "about", {})
        return self._replace(estimator=estimator, about={**self.about, **about})

    def advanced(
        self,
        state: S,
        since: float,
        time: float,
        controls: ControlTable | None = None,
        laws: list[StepLaw] | None = None,
    ) -> S:
        """Propagate an estimator state to a later time; an equal or earlier time leaves it unchanged.

        Args:
            state: estimator state.
            since: time of the state.
            time: later time.
            controls: controls of the flow after `since`, or None; no step crosses one of their jumps.
            laws: list to which the backward laws of a Gaussian filter are appended, or None.
        """
        if not time > since:
            return state
        flow, ends = self.flow, [since, time]
        if controls is not None:
            known = controls.over(torch.tensor(ends, dtype=torch.float64))
            flow, ends = steered(flow, known.times, known.values, linear=known.linear), known.times.tolist()
        for begin, end in pairwise(ends):
            count = substeps(end - begin, self.max_step)
            length = (end - begin) / count
            for _ in range(count):
                if laws is None:
                    state = self.estimator.predict(state, flow, length, self.noise(length))
                else:
                    state = self._with_law(state, flow, length, laws)
            state = state._replace(time=torch.tensor(end, dtype=torch.float64))
        return state

    def _with_law(self, state: S, flow: Flow, length: float, laws: list[StepLaw]) -> S:
        """Return the state after a step, and append the backward law of the step."""
        before, filtering = cast(FilterState, state), cast("GaussianFilter", self.estimator)
        chol_q = process_factor(self.noise(length), before.belief)(length)
        given = before, flow, length, before.time + length, chol_q
        after, law = filtering.predicted(*given, smoothing=True)
        assert law is not None
        laws.append(StepLaw(before.belief.mean, after.belief.mean, law))
        return cast(S, after)

    def members_advanced(self, state: S, since: Tensor, times: Tensor) -> S:
        """Propagate B members, each from its own time to a later time, like `advanced`.

        The time of the result is meaningless.

        Args:
            state: estimator state.
            since: (B,) current times.
            times: (B,) target times; an equal or earlier time leaves a member unchanged.
        """
        gaps = times - since
        counts = substeps_of_each(gaps, self.max_step) * (gaps > 0)
        lengths = gaps / counts
        for k in range(int(counts.max())):
            moving = counts > k
            whole = bool(moving.all())
            part, own = (state, lengths) if whole else (member_rows(state, moving), lengths[moving])
            begun = since + k * lengths
            flow = MemberFlow(self.flow, begun if whole else begun[moving], own)
            part = self.estimator.predict(part, flow, 1.0, self.noises(own))
            if whole:
                state = part
            else:
                state = member_rows(state, torch.arange(len(gaps)))  # a copy
                put_rows(state, moving, part)
        return state

    def noises(self, lengths: Tensor) -> Factor:
        """Return the factors of Q, (B, D, D), for steps of lengths (B,)."""
        each = getattr(self.noise, "each", None)
        if each is not None:
            return each(lengths)
        known, which = lengths.unique(return_inverse=True)
        return Factor(torch.stack([factored(self.noise(dt)) for dt in known.tolist()])[which])


def factored(covariance: Covariance) -> Tensor:
    """Return the lower factor (D, D) of a covariance Q (D, D); raises ValueError for other matrices."""
    if isinstance(covariance, Factor):
        return covariance.chol
    size = len(torch.as_tensor(covariance))
    return covariance_factor(covariance, "Q", batch=1, size=size, definite=False)
