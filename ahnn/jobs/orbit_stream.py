"""Orbit determination continued line by line, by a filter with the same forces, stations and biases."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ahnn.assimilation import Assimilation, StreamSensor
from ahnn.assimilation.start import begin, belief_of
from ahnn.assimilation.stream_clock import StreamClock
from ahnn.data.files import epochs
from ahnn.data.files.object_name import ObjectName
from ahnn.data.reference import Reference
from ahnn.data.starts import starts
from ahnn.deviations import state_deviations
from ahnn.errors import UserError
from ahnn.estimation import RecursiveEstimator, initial_belief
from ahnn.estimation.online import WhiteNoise
from ahnn.estimation.process_model import Process
from ahnn.jobs.assimilation_request import AssimilationRequest, Stream
from ahnn.jobs.determining import compared, headline, totals
from ahnn.jobs.followed_measurements import FollowedMeasurements
from ahnn.tracking.orbit_belief import OrbitBelief, fitted_belief, prior_belief
from ahnn.tracking.orbit_fit import OrbitProblem, orbit_fit
from ahnn.tracking.orbit_problem import PreparedOrbit, measured, prepared_orbit
from ahnn.tracking.orbit_setup import OrbitSetup, StartChoice
from ahnn.tracking.satellite_arc import satellite_arc
from ahnn.tracking.satellite_flow import SIZE, SatelliteFlow
from ahnn.tracking.station_measurement import StationMeasurement
from ahnn.tracking.tracking_data import KINDS, Kind, joined
from ahnn.types import Space, Units

log = logging.getLogger("ahnn")

SPACE = Space("orbit", ("x", "y", "z", "px", "py", "pz"), Units("s", "km", "km/s", "km²/s²"))
"""Space of the states; velocities are momenta of mass 1, so that learned models can start from the tracks."""
LONGEST = 3600.0
"""Longest step of the filter, s; the flow takes shorter steps."""
MINUTE = 60.0
"""Time over which the given process noise is added, s."""
Mask = NDArray[np.bool_]


class OrbitFollowing(NamedTuple):
    """Parts of an online orbit determination.

    Attributes:
        setup: setup of the determination.
        folder: base folder of the file names in the setup.
        estimator: estimator that filters the measurements.
        noise: standard deviations [position, velocity] added per minute, km and km/s.
        other: file of the measurements to filter; None: the measurements of the setup.
    """

    setup: OrbitSetup
    folder: Path
    estimator: RecursiveEstimator[Any]
    noise: tuple[float, float]
    other: Path | None = None


def orbit_stream(asked: AssimilationRequest, orbit: OrbitFollowing) -> Stream:
    """Return the stream of measurements that continues from a fitted or given orbit.

    Raises:
        UserError: an invalid file or option.
        TrainingError: the fit fails.
    """
    ready, belief, rows = fitted_start(asked, orbit) if asked.start == "fit" else given_start(asked, orbit)
    problem, data = ready.problem, ready.problem.model.data
    flow = flow_of(problem)

    def beside(mean: NDArray[np.float64], time: float) -> list[str]:
        if orbit.setup.compare is None:
            return []
        arc = satellite_arc(problem.forces, mean[:SIZE], flow.parameters(mean), time, belief.time, time)
        return compared(ready, arc, orbit.folder / orbit.setup.compare)

    followed = FollowedMeasurements(data, rows, belief.names, beside)
    start = initial_belief(belief.mean[None, :SIZE], belief.covariance[:SIZE, :SIZE])
    filtering = Assimilation(
        process_of(flow, belief, orbit),
        sensors_of(problem, belief, followed),
        start,
        time=belief.time,
        window=asked.window,
        lag=asked.lag,
        lines=asked.lines,
        gap=asked.gap,
    )
    reference = Reference("GCRF", "EARTH", "UTC", data.epoch)
    name = data.object or asked.object or "SATELLITE"
    objects = {name: ObjectName(name, asked.object or "")}
    clock = StreamClock("s", data.epoch, "UTC")
    return Stream(asked, SPACE, filtering, clock, reference, objects, followed=followed)


def flow_of(problem: OrbitProblem) -> SatelliteFlow:
    """Return the flow under the forces of a problem, for states of its estimated unknowns."""
    unknowns, forces = problem.unknowns, slice(SIZE, SIZE + problem.unknowns.forces)
    return SatelliteFlow(problem.forces, unknowns.mean[forces], unknowns.free[forces])


def process_of(flow: SatelliteFlow, belief: OrbitBelief, orbit: OrbitFollowing) -> Process:
    """Return the estimator with the forces of an orbit, started from a belief about all unknowns."""
    size = len(belief.mean)
    whole = initial_belief(belief.mean[None], 0.5 * (belief.covariance + belief.covariance.T))
    noise = torch.zeros(size, size, dtype=torch.float64)
    noise[:SIZE, :SIZE] = torch.tensor(orbit.noise, dtype=torch.float64).repeat_interleave(3).diag()
    about = {**orbit.estimator.about, "orbit": repr(orbit.setup), "noise": list(orbit.noise)}
    return Process(orbit.estimator, flow, WhiteNoise(noise, MINUTE), LONGEST, lambda _: whole, about=about)


def sensors_of(
    problem: OrbitProblem, belief: OrbitBelief, followed: FollowedMeasurements
) -> dict[str, StreamSensor]:
    """Return each station as a sensor, with the noise of the fit; biases are components of the state."""
    places, unknowns, found = {name: k for k, name in enumerate(belief.names)}, problem.unknowns, {}
    kept = {
        pair: float(unknowns.mean[k])
        for k, pair in enumerate(unknowns.bias, SIZE + unknowns.forces)
        if not unknowns.free[k]
    }
    for s, name in enumerate(problem.model.data.stations):
        chosen = followed.kinds(s)
        kinds: tuple[Kind, ...] = tuple(KINDS[k] for k in chosen)
        biases = tuple(places.get(f"bias {name} {kind}") for kind in kinds)
        known = tuple(kept.get((s, k), 0.0) for k in chosen)
        model = StationMeasurement(problem.model, s, kinds, biases, known)
        found[name] = StreamSensor(model, tuple(belief.noise[s, chosen].tolist()), kinds)
    return found


def fitted_start(
    asked: AssimilationRequest, orbit: OrbitFollowing
) -> tuple[PreparedOrbit, OrbitBelief, Mask]:
    """Fit the first measurements; return the problem, the belief at the last one, and a mask of the rest.

    Raises:
        UserError: the number of measurements to fit is not given.
        TrainingError: the fit fails.
    """
    setup, folder = orbit.setup, orbit.folder
    data = measured(setup, folder)
    own = np.ones(len(data.times), dtype=bool)
    count = fitted_count(asked.fitted, setup.held_out, len(own), whole=orbit.other is not None)
    if orbit.other is not None:
        data, own = joined(data, measured(replace(setup, measurements=str(orbit.other)), folder))
    used = own & (np.cumsum(own) <= count)
    ready = prepared_orbit(setup, folder, data)
    fit = orbit_fit(replace(ready.problem, used=used))
    log.info("%s", "\n".join([*headline("start", fit), *totals(fit)]))
    belief = fitted_belief(fit, float(data.times[used][-1]))
    return ready, belief, ~used if orbit.other is None else ~own


def fitted_count(wanted: float | None, held_out: float, count: int, *, whole: bool) -> int:
    """Return the number of measurements to fit.

    Args:
        wanted: number, or a fraction below 1; None: all that are not held out.
        held_out: fraction held out.
        count: number of all measurements.
        whole: whether all of them may be fitted.

    Raises:
        UserError: the number is undetermined.
    """
    if wanted is None and not (held_out or whole):
        message = (
            "fitted: expected the number or fraction of measurements to fit before the rest are filtered; "
            "received none, and no orbit.held_out"
        )
        raise UserError(message)
    chosen = 1 - held_out * (not whole) if wanted is None else wanted
    return min(count, round(chosen if wanted is not None and wanted >= 1 else chosen * count))


def given_start(asked: AssimilationRequest, orbit: OrbitFollowing) -> tuple[PreparedOrbit, OrbitBelief, Mask]:
    """Return the problem with a given start, the belief at the start, and a mask of all measurements.

    Raises:
        UserError: a start without covariance, or an unknown without prior.
    """
    setup = orbit.setup
    if orbit.other is not None:
        setup = replace(setup, measurements=str(orbit.other))
    data = measured(setup, orbit.folder)
    if asked.start is None:
        covariance = state_deviations(asked.start_sd, SPACE, "start_sd").square().diag()
    else:
        ours = Reference("GCRF", "EARTH", "UTC", data.epoch)
        found = starts(asked.start, SPACE, ours, sd=asked.start_sd, last=True)
        clock, time, _ = begin(found, ours, asked.time, "s")
        belief = belief_of(found, None, SPACE, no_carry)
        epoch = epochs.spelled(clock.after(clock.zero, time), utc=True)
        position, velocity = belief.mean[0].reshape(2, 3).tolist()
        setup = replace(setup, start=StartChoice(epoch=epoch, position=position, velocity=velocity))
        covariance = belief.chol[0] @ belief.chol[0].T
    ready = prepared_orbit(setup, orbit.folder, data)
    return ready, prior_belief(ready.problem, covariance.numpy()), np.ones(len(data.times), dtype=bool)


def no_carry(states: Tensor, times: Tensor, covariances: Tensor) -> Tensor:
    """Raise UserError, since the covariance of an earlier state is not propagated."""
    del states, times, covariances
    message = (
        "start: expected the covariance of its last state; received the covariance of an earlier state. Add "
        "start_sd="
    )
    raise UserError(message)
