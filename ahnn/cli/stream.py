"""Assimilation command: options of conf/assimilate.yaml and construction of the stream."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import torch
from omegaconf import DictConfig, ListConfig, OmegaConf
from torch import Tensor

from ahnn.arguments import check_arguments
from ahnn.assimilation import Assimilation, Catalogue, Process, StreamSensor
from ahnn.assimilation.object_shard import ObjectShard
from ahnn.assimilation.start import begin, begin_fitted, belief_of
from ahnn.cli.build import blaming, build, build_all, plain_config
from ahnn.cli.compose import composed
from ahnn.cli.orbit_following import read_following
from ahnn.cli.pairs import require_input, require_known
from ahnn.cli.parts import build_sensor, build_source, known_system
from ahnn.cli.reevaluation import GROUPS, KEYS, NODES, OWN, Request
from ahnn.cli.saved_module import filter_config, is_saved
from ahnn.cli.stream_gate import AskedGate, with_gate
from ahnn.cli.unused_keys import refuse, unread_online
from ahnn.data import SplitData
from ahnn.data.files.frame_names import known
from ahnn.data.files.object_name import ObjectName
from ahnn.data.reference import Reference
from ahnn.data.starts import Starts, of_one_state, starts
from ahnn.errors import UserError
from ahnn.evaluation import Case, EvaluationPlugin
from ahnn.evaluation.make_case import make_case
from ahnn.jobs.assimilation_request import STATED, AssimilationRequest, Stream, require_places
from ahnn.jobs.control_times import control_names, known_controls
from ahnn.jobs.fitted_start import fitted_start
from ahnn.loading import judged_training, load, warn_once
from ahnn.measurements import reading
from ahnn.measurements.station_file import StationsOfFile, read_stations
from ahnn.prediction.ephemeris_message import require_orbit
from ahnn.runs import Run
from ahnn.systems import System
from ahnn.tracking.earth_axes import earth_axes
from ahnn.types import Space

log = logging.getLogger("ahnn")

BIAS = re.compile(r"^(?=sensors\.[^.=]+\.bias_(sd|memory)=)")
"""Keys of a sensor that options of the group measurement do not set."""
AXES = "ahnn.tracking.earth_axes.earth_axes"
"""Factory of the axes of ground stations in configurations."""
FILTER, OF_MEASUREMENTS = "plugins=ukf", "plugins=ukf_parameter_error"
"""Default filters of a run without a plugin; the second if it saved its least observable parameters."""


def read_stream(arguments: list[str]) -> Stream:
    """Build the stream requested on the command line.

    Raises:
        UserError: a missing run, occupied output paths, or incompatible options.
    """
    if any(text.startswith("orbit=") for text in arguments):
        return read_following(arguments)
    options, nodes, request = asked(arguments)
    require_own_keys(options, nodes)
    run = load(request.source, request.ckpt)
    if remark := judged_training(run.folder):
        warn_once(remark)
    cfg = filter_config(run.folder, with_filter(request, run))
    known, named = run.uncertainty is not None, bool(nodes) or options.stations is not None
    refuse(unread_online(cfg.plugins, covariance=known, named=named), request.overrides)
    torch.set_num_threads(cfg.threads)
    require_places(options)
    return build_assimilation(options, nodes, cfg, run)


def require_own_keys(options: AssimilationRequest, nodes: DictConfig) -> None:
    """Raise UserError for keys that contradict `start` or the run, and for sensors defined twice."""
    if options.folder is not None:
        message = f"folder: expected orbit=FILE.yaml with folder={options.folder}; received a run"
        raise UserError(message)
    if options.start != "fit" and options.fitted is not None:
        message = f"fitted: expected start=fit with fitted={options.fitted}; received start={options.start}"
        raise UserError(message)
    for key in ("start_sd", "time", "objects", "controls") if options.start == "fit" else ():
        if (value := getattr(options, key)) is not None:
            message = f"{key}: expected none with start=fit; received {value}"
            raise UserError(message)
    if options.stations is not None and nodes:
        message = f"stations: expected no other sensors; received {', '.join(map(str, nodes))}"
        raise UserError(message)


def asked(arguments: list[str]) -> tuple[AssimilationRequest, DictConfig, Request]:
    """Return the options of a command line, the nodes of its sensors, and its request for the run.

    Raises:
        UserError: no run, an unknown key, or a value of the wrong type.
    """
    given = ["watch=true" if argument == "--watch" else argument for argument in arguments]
    own = composed("assimilate", [])
    known = {*own, *OWN, *GROUPS, *NODES, *KEYS}
    require_known((_key(text) for text in given if "=" in text), sorted(known))
    mine = [BIAS.sub("++", text, count=1) for text in given if _key(text) in own]
    request = Request.of([text for text in given if _key(text) not in own])
    cfg = composed("assimilate", mine)
    options = plain_config(cfg)
    require_input(options, given)
    check_arguments("", AssimilationRequest, options)
    return AssimilationRequest(**options), cfg.sensors, request


def with_filter(request: Request, run: Run) -> Request:
    """Add a default filter to a request if neither it nor the run names one."""
    has_own = not is_saved(run.folder) and run.config.get("plugins")
    if has_own or any(text.startswith("plugins=") for text in request.overrides):
        return request
    given = any(text.startswith("plugins.ukf.process_noise=") for text in request.overrides)
    measured = run.uncertainty is not None and run.uncertainty.least_observable is not None and not given
    return request._replace(overrides=[OF_MEASUREMENTS if measured else FILTER, *request.overrides])


def _key(text: str) -> str:
    """Return the top level of a key, or the target of a group that `@` relocates."""
    key = text.partition("=")[0].lstrip("+~")
    return (key.partition("@")[2] or key).partition(".")[0]


def build_sensors(
    nodes: DictConfig, cfg: DictConfig, run: Run, truth: Callable[[], System | None]
) -> dict[str, StreamSensor]:
    """Build the sensors of a stream; by default the sensor of the run's group `measurement`.

    Raises:
        UserError: no model, or incompatible standard deviations.
    """
    made = {}
    for name, node in (nodes or OmegaConf.create({"": cfg.measurement})).items():
        who, named = f"sensors.{name}" if name else "measurement", node.get("model")
        with blaming(who):
            model = reading(named, run.space) if isinstance(named, str) else build(named, f"{who}.model")
            if (mass := getattr(model, "mass", run.space.inertia)) != run.space.inertia:
                message = f"expected mass={run.space.mass:g}, as in the run; received mass={mass:g}"
                raise ValueError(message)
            sd, *bias = (_numbers(node.get(key)) for key in ("sd", "bias_sd", "bias_memory"))
            known = truth() if sd is None and named == "position" else None
            called = str(name) or (named if isinstance(named, str) else type(model).__name__)
            try:
                if known is not None:
                    sd, unit = known.noise.measurement, run.space.units.position
                    log.info("%s.sd: not set; %g %s is used, as in %s", who, sd, unit, run.space.name)
                made[called] = StreamSensor.of(model, sd, run.space, bias_sd=bias[0], bias_memory=bias[1])
            except UserError as error:
                message = f"{who}.{error}"
                raise UserError(message) from None
    return made


def stations_of_file(file: str, space: Space, reference: Reference) -> dict[str, StreamSensor]:
    """Return the stations of a file that measure, as sensors on the Earth from an epoch of time zero.

    Raises:
        UserError: the file does not exist, or no station measures.
    """
    measuring = [name for name, entry in read_stations(file).items() if entry.noise]
    found = StationsOfFile(file, earth_axes(reference), space.mass, measuring or None).stations
    biases = {name: one.bias_sd if any(one.bias_sd) else None for name, one in found.items()}
    return {n: StreamSensor.of(one, one.deviations, space, bias_sd=biases[n]) for n, one in found.items()}


def _numbers(given: Any) -> Any:
    """Return the content of a node, with Python lists."""
    return OmegaConf.to_container(given) if isinstance(given, ListConfig | DictConfig) else given


def build_process(cfg: DictConfig, run: Run, case: Callable[[], Case], gate: AskedGate) -> Process:
    """Build the online process of the only plugin that filters online, with a gate that reopens.

    Raises:
        UserError: no plugin or several plugins filter online.
    """
    plugins = build_all(cfg.plugins, "plugins", EvaluationPlugin)
    online = {name: plugin for name, plugin in plugins.items() if hasattr(plugin, "online")}
    if len(online) != 1:
        received = ", ".join(plugins) or "none"
        message = f"plugins: expected one that filters online, such as {FILTER}; received {received}"
        raise UserError(message)
    ((name, plugin),) = online.items()
    with blaming(f"plugins.{name}"):
        novelty = None if run.domain is None else run.novelty
        process = plugin.online(run.dynamics, run.dt, run.space, case, novelty, run.uncertainty)
    return process.with_estimator(with_gate(process.estimator, plugin, gate))


def build_assimilation(asked: AssimilationRequest, nodes: DictConfig, cfg: DictConfig, run: Run) -> Stream:
    """Build the filter of a stream; data are generated only for fits of process noise.

    Raises:
        UserError: options incompatible with the run.
    """
    source = cache(lambda: build_source(cfg))
    named = Reference(asked.frame or "", asked.center or "", (asked.time_system or "").upper())
    ours = Reference.of(run.space.frame).chosen(named).since(asked.epoch)
    fit, unit = asked.start == "fit", run.space.units.time
    if fit:
        clock, time, reference = begin_fitted(ours, asked.measurements, unit)
        found = Starts((), torch.empty(0), torch.empty(0))
    else:
        found = starts(asked.start, run.space, ours, sd=asked.start_sd, last=True)
        clock, time, reference = begin(found, ours, asked.time, unit)
    reference = reference.centred(run.space.units.position)
    if asked.oem:
        require_orbit(run.space, reference, "oem", STATED)
    if asked.stations is None:
        turn_stations(nodes or {"measurement": cfg.measurement}, reference)
        sensors = build_sensors(nodes, cfg, run, lambda: known_system(cfg))
    else:
        sensors = stations_of_file(asked.stations, run.space, reference)
    line = 0
    if fit:
        found, line = fitted_start(run, sensors, asked.measurements, clock, asked.fitted)
        time = float(found.times)
    exact = found.covariances is None and not isinstance(asked.start, str)
    truth = known_system(cfg) if exact else None
    deviations = None if truth is None else truth.deviations().tolist()
    controls = None if asked.controls is None else known_controls(asked.controls, time, run)

    def case() -> Case:
        splits = SplitData(source(), list(cfg.data.split), build_sensor(cfg, source()))
        about = {"label": cfg.label, "seed": cfg.evaluation.seed, "folder": run.folder}
        return make_case(run.dynamics, splits, **about, uncertainty=run.uncertainty, domain=run.domain)

    belief = belief_of(found, deviations, run.space, carrier(run), many=asked.objects is not None)
    limits = {"window": asked.window, "lines": asked.lines, "gap": asked.gap}
    process = build_process(cfg, run, case, asked.gate)
    if asked.objects is None:
        filtering = Assimilation(
            process, sensors, belief, time=time, controls=controls, lag=asked.lag, **limits
        )
    else:
        names = None if of_one_state(asked.start) else found.names
        times, shard = time + found.times - found.times[0], ObjectShard.of(asked.shard)
        if names is not None:
            names, belief, times = shard.starts(names, belief, times)
        filtering = Catalogue(process, sensors, belief, names, times=times, **limits)
        filtering.begun |= {} if asked.shard is None else {"shard": asked.shard}
    far = None if run.domain is None else run.novelty
    objects = {} if asked.objects is not None and of_one_state(asked.start) else found.known()
    if asked.object is not None:
        one = next(iter(objects.values()), ObjectName(asked.object))
        objects = {one.id: one._replace(name=asked.object)}
    about = asked, run.space, filtering, clock, reference, objects, control_names(run), None, line, far
    return Stream(*about)


def carrier(run: Run) -> Callable[[Tensor, Tensor, Tensor], Tensor]:
    """Return a function that propagates the covariance of the first of several states to the last."""

    def carry(states: Tensor, times: Tensor, covariances: Tensor) -> Tensor:
        if names := control_names(run):
            message = (
                "start: expected the covariance of its last state, since the controls before it "
                f"({', '.join(names)}) are unknown; received the covariance of an earlier state. Add "
                "start_sd="
            )
            raise UserError(message)
        predicted = run.predict(states, times, start_covariance=covariances).covariances
        assert predicted is not None
        return predicted[:, -1]

    return carry


def turn_stations(nodes: Any, reference: Reference) -> None:
    """Set `earth_angle` of ground stations without one, if time zero has an epoch."""
    if reference.epoch is None:
        return
    for name, node in nodes.items():
        for key, found in models_of(node.get("model"), f"{name}.model"):
            if not str(found.get("_target_", "")).endswith((".GroundStation", ".StationsOfFile")):
                continue
            if found.get("earth_angle") is None:
                found["earth_angle"] = {"_target_": AXES, "reference": str(reference)}
            elif known(reference.frame) not in ("", "CIRS") and not isinstance(found.earth_angle, ListConfig):
                said = (
                    "%s.earth_angle turns the Earth about the z axis of %s, without precession and nutation"
                )
                log.warning(said + ". Leave it out", key, reference.frame)


def models_of(node: Any, key: str) -> Iterator[tuple[str, Any]]:
    """Yield the nodes of measurement models, including nested ones, with their keys."""
    if isinstance(node, DictConfig):
        yield key, node
        for k, one in enumerate(node.get("models") or ()):
            yield from models_of(one, f"{key}.models.{k}")
