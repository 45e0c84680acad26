"""Ensembles, particles, mixtures through their YAML: one table with the others, options, streams, trust."""

from __future__ import annotations

import copy
import dataclasses

import pytest
import torch
from cases import STIFFER
from entry import call
from evaluating import case_of, composed, run
from omegaconf import OmegaConf

import ahnn
from ahnn.cli.build import build_all
from ahnn.cli.trust import is_trusted
from ahnn.errors import UserError
from ahnn.evaluation import EvaluationPlugin, evaluate
from ahnn.evaluation.case import perturbations
from ahnn.evaluation.open_loop import Integrated
from ahnn.integrators import INTEGRATORS
from ahnn.systems import MassSpring

SPRING = MassSpring(name="spring", dt=0.04, steps=40, mass=2.0)
ALL = ("ukf", "ckf", "ghkf", "ekf", "enkf", "particle", "imm")
SMALL = {"enkf": ["estimator.ensemble=40"], "particle": ["estimator.particles=200"], "imm": []}
CHANGED = {"enkf": "seed=1", "particle": "seed=1", "imm": "dwell=500"}
FILTERED = {"cadence": 4, "process_noise": [1e-4, 1e-4]}


@pytest.fixture
def case(tmp_path, monkeypatch):
    """A spring that a stiffer one stands for; pictures are those of every filter, and take seconds."""
    monkeypatch.setattr("ahnn.evaluation.estimators.plugin.filter_figures", lambda *_: ({}, {}))
    flow = Integrated(dataclasses.replace(SPRING, stiffness=STIFFER.stiffness), INTEGRATORS["rk4"])
    return case_of(SPRING, flow, perturbations(SPRING, 20, seed=0), tmp_path)


def plugins(group, **options):
    cfg = copy.deepcopy(composed(group, "position"))
    for name in cfg.plugins:
        for key, value in (FILTERED | options).items():
            OmegaConf.update(cfg, f"plugins.{name}.{key}", value, force_add=True)
        if name == "particle":
            cfg.plugins.particle.estimator.particles = 300
    return build_all(cfg.plugins, "plugins", EvaluationPlugin)


def test_all_stand_in_one_table_with_floors_and_the_same_measurements(case):
    findings = evaluate(case, plugins(f"[{','.join(ALL)}]"))
    at_best = {}
    for name in ALL:
        rows = [row for row in findings.rows if row.who.estimator == name]
        assert len(rows) == 8
        told = findings.numbers[name]["filters"][name]
        assert told["model"]["perturbed"]["status"]["OK"] == 20
        assert 0.6 < told["floor"]["perturbed"]["nees"]["mean"] / 2 < 1.6
        (row,) = (r for r in rows if r.who.floor and (r.who.start, r.who.span) == ("perturbed", "settled"))
        at_best[name] = row.scores.position
    for name in ("ckf", "ghkf", "ekf", "enkf", "imm"):
        assert at_best[name] == pytest.approx(at_best["ukf"], rel=1e-4)  # a linear motion
    assert at_best["particle"] == pytest.approx(at_best["ukf"], rel=0.15)


@pytest.mark.parametrize("name", SMALL)
@pytest.mark.parametrize(
    "options",
    [
        ["process_noise=fitted", "gate=0.9999"],
        ["process_noise={size: 1e-2, memory: 0.5}", "least_squares=true"],
        ["process_noise=[1e-4,1e-4]", "bias_sd=0.01"],
    ],
)
@pytest.mark.sampled(4)
def test_every_option_of_a_filter_is_one_of_theirs(case, name, options):
    findings = run(case, "cadence=10", *SMALL[name], *options, group=name)
    told = findings.numbers["filters"][name]["floor"]["perturbed"]
    assert told["status"]["OK"] == 20
    assert 0.5 < told["nees"]["mean"] / 2 < 2


@pytest.mark.parametrize("name", SMALL)
@pytest.mark.sampled(3)
def test_figures_are_those_of_every_filter(tmp_path, name):
    flow = Integrated(SPRING, INTEGRATORS["rk4"])
    few = case_of(SPRING, flow, perturbations(SPRING, 2, seed=0), tmp_path)
    findings = run(few, "cadence=20", "process_noise=[1e-4,1e-4]", *SMALL[name], group=name)
    assert {"error_band", "error", "moving_average", "consistency", "state"} == findings.figures.keys()
    assert "perturbed_sawtooth_mean" in findings.arrays


@pytest.mark.parametrize("form", ["square_root", "stochastic"])
def test_an_ensemble_is_smoothed(case, form):
    options = ["smoother=true", "cadence=10", "process_noise=[1e-4,1e-4]", f"estimator.form={form}"]
    findings = run(case, *options, group="enkf")
    whole = {r.who.estimator: r.scores for r in findings.rows if r.who.floor and r.who.span == "whole"}
    assert whole.keys() == {"enkf", "enkf_smoothed"}
    assert whole["enkf_smoothed"].position < whole["enkf"].position


def test_what_they_have_not_is_refused(case):
    with pytest.raises(UserError, match="smoother: expected false, since particle has none; received True"):
        run(case, "smoother=true", group="particle")
    with pytest.raises(UserError, match="smoother: expected false, since imm has none"):
        run(case, "smoother=true", group="imm")
    with pytest.raises(UserError, match="smoother: expected true, false or one of smoothed; received it"):
        run(case, "smoother=iterated", group="enkf")
    few = ["cadence=9", "estimator.ensemble=4", "bias_sd=[0.1]"]
    with pytest.raises(UserError, match="ensemble: expected more members than the 4 estimated components"):
        run(case, *few, "process_noise=force_error", group="enkf")
    (plugin,) = plugins("enkf", process_noise="parameter_error").values()
    plugin.estimator = dataclasses.replace(plugin.estimator, ensemble=40)
    with pytest.raises(UserError, match="ensemble: expected more members than the 52 estimated components"):
        plugin.check(SPRING, SPRING.space, 40)


@pytest.mark.parametrize(
    "options", [["plugins=enkf"], ["plugins=particle", "plugins.particle.gate=0.9999"], ["plugins=imm"]]
)
@pytest.mark.sampled(2)
def test_a_stream_is_filtered_and_goes_on_where_it_was(tmp_path, monkeypatch, options):
    monkeypatch.chdir(tmp_path)
    start = [0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0]
    orbit = ahnn.load("molniya_mechanical").rollout(start, 20, 15.0)[0]
    noise = 0.05 * torch.randn(21, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    fixes = (orbit[:, :3] + noise).tolist()
    lines = ["time,x,y,z", *(f"{15.0 * k},{x},{y},{z}" for k, (x, y, z) in enumerate(fixes))]
    name = options[0].removeprefix("plugins=")
    common = ["pretrained=molniya_mechanical", *options, f"plugins.{name}.process_noise=[1e-3,1e-5]"]
    common += [f"start={start}", "start_sd=[0.1,1e-4]", "measurement.sd=0.05", "measurements=fixes.csv"]
    (tmp_path / "fixes.csv").write_text("\n".join(lines) + "\n")
    assert call("ahnn.assimilate", *common, "output=whole.csv") == 0
    (tmp_path / "fixes.csv").write_text("\n".join(lines[:9]) + "\n")
    parted = [*common, "output=parted.csv", "state=a.state"]
    assert call("ahnn.assimilate", *parted) == 0
    (tmp_path / "fixes.csv").write_text("\n".join(lines) + "\n")
    assert call("ahnn.assimilate", *parted) == 0
    assert (tmp_path / "parted.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()
    assert (
        call("ahnn.assimilate", *parted, f"plugins.{name}.estimator.{CHANGED[name]}") == 2
    )  # a state of another one


def test_their_classes_may_be_built_from_a_run_of_somebody_else():
    assert is_trusted("ahnn_plugins.enkf.EnsembleKalmanFilter", "plugins")
    assert is_trusted("ahnn_plugins.particle.ParticleFilter", "plugins")
    assert is_trusted("ahnn_plugins.imm.InteractingModels", "plugins")
    assert is_trusted("ahnn_plugins.ukf.UnscentedKalmanFilter", "plugins")
    assert not is_trusted("ahnn_plugins.enkf.Localisation", "plugins")
