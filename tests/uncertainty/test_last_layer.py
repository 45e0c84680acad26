"""The posterior that the benchmark samples, against the training's own equations and the model's paths."""

import importlib.util
import sys
from pathlib import Path

import pytest
import torch
from entry import call
from omegaconf import OmegaConf

import ahnn
from ahnn.cli.parts import build_sensor, build_source
from ahnn.data import SplitData
from ahnn.data.segments import whole

PATH = Path(__file__).parents[2] / "benchmarks" / "last_layer.py"
TINY = ["data.trajectories=20", "data.windows_per_epoch=20", "data.batch_size=10", "data.val_windows=3"]
TINY += ["loss.stages=[[whole,1.0]]", "model.network.width=6", "trainer.max_epochs=2", "loss.closing=8"]
TINY += ["experiment=pendulum_angles", "system.dt=0.05", "system.steps=30", "system.q0=[-0.7,0.7]"]
TINY += ["data.every=2", "data.noise=0.05", "plugins=none", "logger=none", "evaluation=scores"]
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def posterior(tmp_path_factory):
    """The posterior of the last layer of a short training."""
    spec = importlib.util.spec_from_file_location("last_layer", PATH)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    folder = tmp_path_factory.mktemp("runs") / "angles"
    assert call("ahnn.train", *TINY, f"run={folder}") == 0
    run = ahnn.load(folder)
    cfg = OmegaConf.create(run.config)
    source = build_source(cfg)
    data = SplitData(source, list(cfg.data.split), build_sensor(cfg, source))
    return module.LastLayer(run, whole(data.measured("train"), data.instrument()))


@torch.no_grad()
def test_its_matrix_and_optimum_are_those_of_the_training_with_other_layers_fixed(posterior):
    """The training eliminates the starts and uses the variational equation; here they are variables."""
    narrow, known = posterior.run.uncertainty.before
    names = [name for name, p in narrow.named_parameters() for _ in range(p.numel())]
    last = torch.tensor([".output." in name for name in names])
    count = int(last.sum())
    precision = torch.linalg.inv(known.factor @ known.factor.mT)
    scale = precision[last][:, last].diagonal().sqrt()
    own = torch.linalg.inv((posterior.factor @ posterior.factor.mT)[:count, :count])
    assert float(((own - precision[last][:, last]) / scale / scale[:, None]).abs().max()) < 0.01
    move = torch.linalg.solve(precision[last][:, last], (precision @ known.offset)[last])
    gap = torch.linalg.cholesky(own).mT @ (posterior.centre[:count] - move)
    assert known.about["remaining"] > 0.1  # there is a step to compare
    assert float(gap.norm()) < 0.1 * known.about["remaining"] ** 0.5


@torch.no_grad()
def test_its_density_is_that_of_the_paths_of_its_runs(posterior):
    u = torch.randn(3, len(posterior.centre), generator=torch.Generator().manual_seed(0)).double()
    variables = posterior.centre + u @ posterior.factor.mT
    train, count = posterior.train, len(posterior.outputs.places)
    every = round(float(train.times[0, 1] - train.times[0, 0]) / posterior.run.dt)
    for k, run in enumerate(posterior.runs(u)):
        starts = variables[k, count:].view(len(train.values), -1)
        states = run.rollout(starts, every * (train.values.shape[1] - 1), posterior.run.dt)[:, ::every]
        misfit = ((states[..., :1] - train.values) / train.instrument.deviations).square().sum()
        weights = posterior.outputs.values + variables[k, :count]
        prior = (posterior.outputs.strengths * weights.square()).sum()
        assert float(posterior.density(u)[k]) == pytest.approx(-0.5 * float(misfit + prior), rel=1e-8)
