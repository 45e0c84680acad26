"""The extended filter through its YAML: one table with the unscented one, every option, streams, trust."""

from __future__ import annotations

import copy
from dataclasses import replace

import pytest
import torch
from entry import call
from evaluating import composed
from omegaconf import OmegaConf

import ahnn
from ahnn.cli.build import build_all
from ahnn.cli.trust import is_trusted
from ahnn.data.generate import generate
from ahnn.errors import UserError
from ahnn.evaluation import Case, EvaluationPlugin, evaluate
from ahnn.evaluation.case import perturbations
from ahnn.integrators import INTEGRATORS
from ahnn.systems import Molniya, exact_flow

ORBITS = Molniya(name="orbits", dt=60.0, steps=60)
FILTERED = {"cadence": 5, "process_noise": [1e-4, 1e-7]}


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """Orbits that those of a weaker oblateness stand for."""
    seeds = {"test": 0, "validation": 1, "train": 2}
    split = {name: generate(ORBITS, 6, seed=seed) for name, seed in seeds.items()}
    flow, method = exact_flow(replace(ORBITS, j2=1e-3)), INTEGRATORS["rk4"]
    parts = {"space": ORBITS.space, "truth": ORBITS, "flow": flow, "energy": None, "integrator": method}
    where = {"folder": tmp_path_factory.mktemp("case"), "perturbation": perturbations(ORBITS, 6, seed=0)}
    return Case(label="mine", assumes="nothing", dt=ORBITS.dt, **parts, **split, **where)


def plugins(group="ekf", **options):
    cfg = copy.deepcopy(composed(group, "position"))
    for name in cfg.plugins:
        for key, value in (FILTERED | options).items():
            OmegaConf.update(cfg, f"plugins.{name}.{key}", value, force_add=True)
    return build_all(cfg.plugins, "plugins", EvaluationPlugin)


def test_both_filters_stand_in_one_table_with_floors_figures_and_the_same_measurements(case):
    findings = evaluate(case, plugins("[ukf,ekf]"))
    for name in ("ukf", "ekf"):
        rows = [row for row in findings.rows if row.who.estimator == name]
        assert len(rows) == 8
        assert sum(row.who.floor for row in rows) == 4
        told = findings.numbers[name]["filters"][name]["floor"]["perturbed"]
        assert 0.5 < told["nees"]["mean"] / 6 < 2.0
        assert {f"{name}/error_band", f"{name}/consistency"} <= findings.figures.keys()
        assert f"{name}/perturbed_sawtooth_mean" in findings.arrays
    ours, theirs = (findings.arrays[f"{name}/true_start"] for name in ("ekf", "ukf"))
    assert float((ours - theirs).abs().max()) < 1e-3 * float(theirs.abs().max())


@pytest.mark.parametrize(
    "options",
    [
        {"process_noise": "fitted", "smoother": True},
        {"process_noise": "force_error", "gate": 0.9999},
        {"process_noise": {"size": 1e-3, "memory": 600.0}, "least_squares": True},
    ],
)
@pytest.mark.sampled(3)
def test_every_option_of_a_filter_is_one_of_it(case, options):
    (plugin,) = plugins(**options).values()
    names = {row.who.estimator for row in plugin(case).rows}
    more = {"smoother": "ekf_smoothed", "least_squares": "batch_least_squares"}
    assert names == {"ekf", *(name for key, name in more.items() if key in options)}


def test_what_it_has_not_is_refused():
    with pytest.raises(UserError, match="smoother: expected true, false or one of smoothed; rec"):
        plugins(smoother="iterated")
    with pytest.raises(UserError, match="unknown key 'alpha'"):
        plugins(alpha=1.0)


def test_a_stream_is_filtered_by_it_and_goes_on_where_it_was(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    start = [0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0]
    orbit = ahnn.load("molniya_mechanical").rollout(start, 20, 15.0)[0]
    noise = 0.05 * torch.randn(21, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    fixes = (orbit[:, :3] + noise).tolist()
    lines = ["time,x,y,z", *(f"{15.0 * k},{x},{y},{z}" for k, (x, y, z) in enumerate(fixes))]
    common = ["pretrained=molniya_mechanical", "plugins=ekf", "plugins.ekf.process_noise=[1e-3,1e-5]"]
    common += [f"start={start}", "start_sd=[0.1,1e-4]", "measurement.sd=0.05", "measurements=fixes.csv"]
    (tmp_path / "fixes.csv").write_text("\n".join(lines) + "\n")
    assert call("ahnn.assimilate", *common, "output=whole.csv") == 0
    (tmp_path / "fixes.csv").write_text("\n".join(lines[:9]) + "\n")
    parted = [*common, "output=parted.csv", "state=a.state"]
    assert call("ahnn.assimilate", *parted) == 0
    (tmp_path / "fixes.csv").write_text("\n".join(lines) + "\n")
    assert call("ahnn.assimilate", *parted) == 0
    assert (tmp_path / "parted.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()
    assert call("ahnn.assimilate", *parted, "plugins.ekf.gate=0.99") == 2  # a state of another filter


def test_its_class_may_be_built_from_a_run_of_somebody_else():
    assert is_trusted("ahnn_plugins.ekf.ExtendedKalmanFilter", "plugins")
    assert is_trusted("ahnn.evaluation.estimators.EstimatorEvaluation", "plugins")
