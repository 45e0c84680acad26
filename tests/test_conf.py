"""Every option of every group composes with the defaults, and what it names can be built."""

from __future__ import annotations

from inspect import Parameter, signature
from itertools import product
from pathlib import Path

import pytest
from entry import untouched
from hydra import compose, initialize_config_dir
from hydra.utils import get_object
from omegaconf import DictConfig, ListConfig, OmegaConf

from ahnn.cli.build import build, build_all, plain_config
from ahnn.cli.parts import SENSOR, SIMULATION, build_sensor, build_source
from ahnn.cli.prepare import build_model, factories_of, prepare
from ahnn.data.splits import split_sizes
from ahnn.errors import UserError
from ahnn.integrators import GaussLegendre4
from ahnn.paths import conf_dir

GROUPS = {
    folder.name: sorted(path.stem for path in folder.glob("*.yaml"))
    for folder in sorted(conf_dir().iterdir())
    if folder.is_dir() and folder.name != "hydra"
}
OPTIONS = [(group, option) for group, options in GROUPS.items() for option in options]
GIVEN = {"files": [f"system.path={Path(__file__).parent}/fixtures/swings.csv"]}
ELSEWHERE = {"sightings"}
"""Built from tables of stations in tests/tracking/test_sightings.py."""
BUILT = ["system", "model", "data", "optimizer", "scheduler", "loss", "integrator", "budget"]


def composed(tmp_path, *overrides):
    with untouched(), initialize_config_dir(str(conf_dir()), version_base="1.3"):
        place = [f"folder={tmp_path}", f"run={tmp_path}"]
        return compose("train", [*place, *overrides], return_hydra_config=True)


def job(cfg):
    """What a task takes of a configuration: all but the part of Hydra."""
    return OmegaConf.masked_copy(cfg, [key for key in cfg if key != "hydra"])


def build_parts(cfg):
    cfg = job(cfg)
    made, source = factories_of(cfg), build_source(cfg)
    data = made["data"](source=source, window=cfg.window, sensor=build_sensor(cfg, source))
    return data, build_model(plain_config(cfg), made, data)


def targets(node):
    """Every node with a `_target_`, however deep."""
    if isinstance(node, DictConfig):
        if node.get("_target_") is not None:
            yield node
        for key in node:
            if not OmegaConf.is_missing(node, key) and not OmegaConf.is_interpolation(node, key):
                yield from targets(node[key])
    elif isinstance(node, ListConfig):
        for item in node:
            yield from targets(item)


@pytest.mark.parametrize(("group", "option"), OPTIONS)
@pytest.mark.sampled(6)
def test_every_option_composes_and_its_targets_take_its_keys(tmp_path, group, option):
    cfg = composed(tmp_path, f"{group}={option}")
    nodes = list(targets(cfg))
    assert nodes
    for node in nodes:
        parameters = signature(get_object(node["_target_"])).parameters
        if any(p.kind is Parameter.VAR_KEYWORD for p in parameters.values()):
            continue
        keys = {str(key) for key in node if not str(key).startswith("_")}
        keys -= {*SIMULATION, *SENSOR} if "Window" in node["_target_"] else set()
        assert keys <= set(parameters), node["_target_"]


@pytest.mark.parametrize(
    ("group", "option"), [pair for pair in OPTIONS if pair[0] in BUILT and pair[1] not in ELSEWHERE]
)
@pytest.mark.sampled(6)
def test_every_option_of_the_core_can_be_built(tmp_path, group, option):
    overrides = [f"{group}={option}"]
    overrides += GIVEN.get(option, [])
    if group == "integrator":  # compositions need a separable Hamiltonian
        overrides.append("model.hamiltonian=separable")
    if option.startswith(("shooting", "weak")):  # which learn from measurements
        overrides.append("data.noise=0.01")
    data, model = build_parts(composed(tmp_path, *overrides))
    assert model.dof == data.source.space.dof
    assert model.optimisation is not None


OFTEN = 10
PAIRS = [
    pytest.param(model, system, marks=() if (i + j) % OFTEN == 0 else pytest.mark.slow)
    for (i, model), (j, system) in product(enumerate(GROUPS["model"]), enumerate(GROUPS["system"]))
    if system not in ELSEWHERE
]
"""One in so many pairs is built each time, each model and system in several; the slow suite builds all."""


@pytest.mark.parametrize(("model", "system"), PAIRS)
def test_every_model_is_built_for_every_system(tmp_path, model, system):
    data, built = build_parts(
        composed(tmp_path, f"model={model}", f"system={system}", *GIVEN.get(system, []))
    )
    assert built.dof == data.source.space.dof


def test_defaults_are_those_of_the_paper(tmp_path):
    data, _ = build_parts(composed(tmp_path, "model=hnn", "recipe=paper", "budget=paper"))
    assert split_sizes(data.source.count, data.splits.fractions) == [2000, 375, 125]
    assert data.batch_size == 256
    cfg = composed(tmp_path, "recipe=paper", "budget=paper")
    assert cfg.trainer.max_epochs == 250
    assert cfg.data.windows_per_epoch is None
    optimizer = OmegaConf.to_container(cfg.optimizer)
    assert (optimizer["betas"], optimizer["eps"], optimizer["weight_decay"]) == ([0.9, 0.999], 1e-8, 0.01)
    assert cfg.integrator.name == "rk4"


def test_callbacks_and_loggers_can_be_built(tmp_path):
    cfg = composed(tmp_path)
    assert set(build_all(cfg.callbacks, "callbacks")) == set(cfg.callbacks)
    assert set(build_all(cfg.logger, "logger")) == {"tensorboard"}


def test_an_entry_set_to_null_is_left_out(tmp_path):
    cfg = composed(tmp_path, "callbacks.rollout=null")
    assert "rollout" not in build_all(cfg.callbacks, "callbacks")


def test_build_offers_only_what_a_target_takes():
    node = OmegaConf.create({"_target_": "ahnn.integrators.GaussLegendre4", "tolerance": 1e-9})
    assert build(node, "x", max_iterations=9, unknown=3) == GaussLegendre4(1e-9, 9)


@pytest.mark.parametrize(
    ("overrides", "loss"),
    [
        (["sensor=spring_states"], "weak"),
        (["system=molniya", "sensor=orbit_positions"], "shooting"),
        (["sensor=orbit_states", "system=molniya"], "weak_dense"),
        (["sensor=spring_states", "recipe=second_order"], "derivative_first"),
        (["system=molniya"], "derivative_first"),
    ],
)
def test_a_sensor_brings_its_recipe_unless_another_is_named(tmp_path, overrides, loss):
    assert composed(tmp_path, *overrides).hydra.runtime.choices.loss == loss


def test_measurements_are_learned_from_on_the_cpu_where_there_is_a_gpu(tmp_path, monkeypatch):
    """Everything else would be trained on the GPU, which this machine has not."""
    for part in ("fabric", "pytorch"):
        accelerator = f"lightning.{part}.accelerators.CUDAAccelerator"
        monkeypatch.setattr(f"{accelerator}.is_available", staticmethod(lambda: True))
    parts = ["logger=none"]
    trainer = prepare(job(composed(tmp_path, "experiment=pendulum_angles", *parts))).trainer
    assert trainer.strategy.root_device.type == "cpu"
    with pytest.raises(UserError, match=r"^trainer: .*(gpu|cuda|GPU|CUDA)"):
        prepare(job(composed(tmp_path, *parts)))
