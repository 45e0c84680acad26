"""What a command line sets has an effect, or is refused with the reason: no key is dropped."""

from __future__ import annotations

import sys

import pytest
import yaml
from entry import SMALL, call
from omegaconf import OmegaConf

from ahnn.cli.commandline import compose, config_loader
from ahnn.cli.unreferenced_keys import BY_REFERENCE, keys_of, unreferenced
from ahnn.cli.unused_keys import BIAS, EVALUATED, SIMULATED, unread_online

NONE = "no chosen option uses it"
UNREAD = {
    "scheduler=cosine": ("scheduler", "second-order steps have no learning rate"),
    "scheduler=exp_hyperbolic scheduler.infimum_lr=1e-5": ("scheduler", "second-order steps"),
    "recipe=first_order loss.order=6": ("loss.order", "with loss.derivative=0 no derivatives are formed"),
    "recipe.laptop_epochs=3": ("recipe.laptop_epochs", NONE),
    "recipe.laptop_windows=3": ("recipe.laptop_windows", NONE),
    "recipe=first_order model=mlp integrator=dopri5": ("integrator", NONE),
    "measurement=state": ("measurement", NONE),
    "measurement.sd=0.1": ("measurement.sd", NONE),
    "label=mine model_label=other": ("model_label", NONE),
    "seeds=[1,2] seed=4": ("seed", "seeds= replaces it"),
    "callbacks.rollout.count=0 callbacks.rollout.every=2 callbacks.best.monitor=val/loss": (
        "callbacks.rollout.every",
        "callbacks.rollout.count=0 disables rollouts",
    ),
    "sensor=spring_states callbacks.rollout.count=3": ("callbacks.rollout.count", "measurements have no"),
    "sensor=spring_states optimizer.tolerance=0.1": ("optimizer.tolerance", "steps on measurements use"),
    "+trainer.gradient_clip_algorithm=norm": ("trainer.gradient_clip_algorithm", "trainer.gradient_clip_val"),
    "plugins=ukf plugins.ukf.patience=3": ("plugins.ukf.patience", "gate=null rejects nothing"),
    "plugins=ukf plugins.ukf.times=[0.3] plugins.ukf.cadence=7": (
        "plugins.ukf.cadence",
        "times sets the measurement times",
    ),
    "system=molniya system.periods=2.0 system.steps=9": ("system.steps", "system.periods sets"),
}


def command(given):
    """A small training with these overrides in the place of its own."""
    own = {text.partition("=")[0] for text in given}
    kept = [text for text in ("budget=smoke", *SMALL) if text.partition("=")[0] not in own]
    if "system=molniya" in given:
        kept.remove("system.steps=60") if "system.steps=60" in kept else None
    return [*kept, *given]


@pytest.mark.parametrize("given", UNREAD)
@pytest.mark.sampled(2)
def test_a_key_without_effect_is_refused_with_the_reason(given, tmp_path, capfd):
    assert call("ahnn.train", *command(given.split()), f"run={tmp_path / 'run'}") == 2
    err = capfd.readouterr().err
    key, reason = UNREAD[given]
    assert err.startswith(f"ahnn: {key}: expected a key with an effect; received one without: {reason}")
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_weights_beside_a_resumed_training_are_refused_and_the_way_to_go_on_takes_them_back(tmp_path, capfd):
    asked = ["budget=smoke", *SMALL[:-1], "logger=none", "trainer.max_epochs=1", f"run={tmp_path}"]
    assert call("ahnn.train", *asked, "evaluation=scores") == 0
    again = [*asked, "evaluation=scores", "weights=nowhere", "ckpt=last"]
    capfd.readouterr()
    assert call("ahnn.train", *again) == 2
    assert "weights: expected a key with an effect" in capfd.readouterr().err
    assert call("ahnn.train", *again, "weights=null") == 0


@pytest.mark.parametrize("chosen", [[], ["budget=smoke"], ["model=mlp"], ["plugins=none"], ["label=a"]])
def test_a_key_is_referred_to_where_its_value_reaches_what_is_built(chosen):
    """Oracle: another value under the key changes what the nodes that are built resolve to."""
    loader = config_loader()
    cfg = compose(loader, "train", [*chosen, "folder=."])
    keys = [
        f"{node}.{key}"
        for node in BY_REFERENCE
        if node in cfg and OmegaConf.is_dict(cfg[node])
        for key in cfg[node]
    ]
    keys = [key for key in (*keys, "model_label") if OmegaConf.select(cfg, key) is not None]
    told = {*unreferenced(cfg, keys)}
    for key in keys:
        changed = cfg.copy()
        OmegaConf.set_struct(changed, False)
        OmegaConf.update(changed, key, "another", merge=False)
        assert (built(changed) == built(cfg)) == (key in told), key


def built(cfg):
    """The nodes that are built, resolved."""
    kept = {key: cfg[key] for key in cfg if key not in (*BY_REFERENCE, "hydra", "run")}
    whole = OmegaConf.create({**{key: cfg[key] for key in BY_REFERENCE if key in cfg}, **kept})
    plain = OmegaConf.to_container(whole, resolve=True)
    return {key: value for key, value in plain.items() if key in kept}


def test_keys_are_those_that_are_set():
    texts = ["a.b=1", "+c=2", "~d", "++e.f=3", "g@h.i=j", "~k=l"]
    assert keys_of(texts) == ["a.b", "c", "e.f", "h.i"]


@pytest.mark.parametrize(
    ("noise", "covariance", "fitted"),
    [
        ("fitted", True, True),
        ("force_error", False, True),
        ({"size": 1e-5, "memory": None}, False, True),
        ({"size": 1e-5, "memory": 60.0}, False, False),
        ([1e-6, 1e-6], False, False),
        ("parameter_error", True, False),
        ("parameter_error", False, True),
    ],
)
def test_a_stream_reads_keys_of_simulated_measurements_where_a_process_noise_is_fitted(
    noise, covariance, fitted
):
    nodes = OmegaConf.create({"ukf": {"process_noise": noise, "gate": 0.9, "times": None}})
    keys = {key.rpartition(".")[2] for key, _ in unread_online(nodes, covariance=covariance)}
    assert keys == {*EVALUATED, *BIAS, *(() if fitted else SIMULATED)}


PLAIN = """
from ahnn.dynamics import make_dynamics
from ahnn.models import AbstractModel

KEYS = {"scaling": "block", "residual": True}

class Plain(AbstractModel):
    def __init__(self, dof, *, window, loss):
        network = {"width": 4, "depth": 1, "activation": "tanh"}
        super().__init__(make_dynamics("map", dof=dof, network=network, **KEYS), dof, window, loss)
        self.save_hyperparameters()
"""


def test_a_model_without_network_does_not_receive_the_one_of_the_recipe(tmp_path, monkeypatch, capfd):
    (tmp_path / "plain_model.py").write_text(PLAIN)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    small = [text for text in SMALL if not text.startswith("model.network")]
    chosen = ["model=mlp", "model._target_=plain_model.Plain", "~model.scaling", "~model.residual"]
    words = ["budget=smoke", *small, "trainer.max_epochs=1", "evaluation=scores", *chosen]
    for several in ([], ["members=2"]):
        folder = tmp_path / f"run{len(several)}"
        assert call("ahnn.train", *words, *several, f"run={folder}") == 0, capfd.readouterr().err
        assert "network" not in yaml.safe_load((folder / "config.yaml").read_text())["model"]
    capfd.readouterr()
    for given in ("network=tanh_16", "model.network.width=8"):
        assert call("ahnn.train", *words, given, f"run={tmp_path / 'no'}") == 2
        assert "received one without: the model takes no network" in capfd.readouterr().err
