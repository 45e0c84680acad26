"""Mistakes in a configuration: each is one message with the remedy, exit code 2, and no file is left."""

from __future__ import annotations

import pytest
from entry import SMALL, call
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.hydra import Hydra
from hydra.core.global_hydra import GlobalHydra

from ahnn.cli.commandline import compose, config_loader, flags_last, in_one_folder

GL4 = "integrator=gl4"
COSINE = "scheduler=cosine"
ADAMW = ["optimizer=adamw", "scheduler=none"]
MISTAKES = {
    # options of groups
    "--config-name nope": "--config-name: unknown option 'nope'; it takes assimilate, report, train",
    "experiment=sprng": "experiment: unknown option 'sprng'; did you mean 'spring'?",
    "sweep=quik": "sweep: unknown option 'quik'; did you mean 'quick'?",
    "model=anhn": "model: unknown option 'anhn'; did you mean 'ahnn'?",
    "system=null": "system: expected one of cart_pole, charged_particle, double_pendulum, duffing,",
    "model=null": "model: expected one of ahnn,",
    "optimizer=null": "optimizer: expected one of adamw,",
    "callbacks=null": "callbacks: expected one of default,",
    "integrator=null": "integrator: expected one of dopri5,",
    "loss=3": "shooting_bodies, weak, weak_dense, weak_positions; received 'loss=3'",
    "budget=null": "budget: expected one of laptop,",
    "=3": "'=3': expected KEY=VALUE, for example seed=7",
    # names
    "system=molniya system.inclinatoin=[1,2]": "did you mean 'system.inclination'?",
    "lr=0.1": "did you mean 'optimizer.lr'?",
    "optimizer=adamw optimizer.learning_rate=0.1": "did you mean 'optimizer.lr'?",
    "optimizer=adamw optimiser.lr=0.1": "did you mean 'optimizer.lr'?",
    "optimizer=levenberg_marquardt optimizer.learning_rate=1e-3": "Use recipe=first_order optimizer.lr=VALUE",
    "optimizer=levenberg_marquardt optimizer.lr=1e-3": "this optimiser has no learning rate. Use recipe=fir",
    "network.width=32": "unknown key 'network.width'; did you mean 'model.network.width'?",
    "~seed": "expected key 'seed'",
    "--run=runs/mine": "--run takes no value; a setting has no dashes: run=runs/mine",
    "optimizer=adamw optimizer.betas=[0.9,": "expected a closed list, but the shell splits at blanks",
    "~scheduler": "configuration: Key 'scheduler' is not in struct",
    "+seed=3": "configuration: Could not append to config. An item is already at 'seed'",
    "model.loss.derivative=1": "did you mean 'loss.derivative'?",
    "model=mlp hamiltonian=generic": "a model with a Hamiltonian; received model=mlp, which has none.",
    "model=node inputs=radial": "model=node, which has none. Use model=ahnn, or leave inputs=radial out",
    "nokey=3": "configuration: unknown key 'nokey'; it takes",
    "trainer.limit_train_batches=2": "trainer takes accelerator, deterministic, devices",
    "trainer.limit_val_batches=2": "Pass another argument as +trainer.limit_val_batches=VALUE",
    "model=mlp experiment=molniya_mechanical": "these options are incompatible; In 'experiment/",
    "data.noise=-1": "data.noise: expected a standard deviation > 0 for each of q [m], p [",
    "data.noise=10mm": "data.noise: expected a number in m, a list of numbers, or estimate; received '10mm'",
    "data.every=4": "data.noise: expected standard deviations with {'every': 4}; received null",
    "data.gaps=1": "data.noise: expected standard deviations with {'gaps': 1}; received null",
    "data.measured=position data.noise=0.01": "expected measured states for a loss on windows; received q.",
    "recipe=measurements": "loss.stages: expected measurements; received exact states",
    "recipe=measurements data.measured=position data.noise=0.01": "Use hamiltonian=mechanical",
    "recipe=measurements data.noise=0.01 loss.stages=[[4,0.5]]": "loss.stages: expected intervals >= 3",
    "recipe=measurements data.noise=0.01 loss.stages=[[all,1.0]]": "received [['all', 1.0]]",
    "recipe=measurements data.noise=0.01 window=3": "window: expected none, since loss.stages sets the",
    "recipe=measurements data.noise=0.01 data.emphasis=0.5": "data.emphasis: expected 0, since all segments",
    "recipe=measurements data.noise=0.01 callbacks.best.monitor=val/rollout": "expected val/loss or val/lost",
    "recipe=measurements data.noise=0.01 loss.robust=cauchy": "loss.robust: expected one of none, huber",
    "model=mlp loss.derivative=1": "model: expected loss=recursive, since a map has no field",
    "model=hnn_derivative loss.derivative=0": "loss.derivative: expected 1.0 with model hnn_derivative",
    "hydra/launcher=nope": "hydra/launcher: unknown option 'nope'; it takes ahnn_process, ahnn_ray, basic",
    "seed=1,2": "'seed=1,2': expected one value; received several. Add -m to run them all",
    "-m --cfg=hydra": "expected one of --multirun and --cfg; received both",
    "--foo": "command line: unrecognized arguments: --foo; see --help",
    "--config-dir=nope": "--config-dir: expected a folder; received 'nope'",
    # what the grammar of overrides cannot read
    "label=a=b": "'label=a=b': special characters in a value need quotes. Type 'label=\"a=b\"'",
    "label=über": "Type 'label=\"über\"'",
    'label=a"b': 'Type \'label="a\\"b"\'',
    "foo": "'foo': expected KEY=VALUE, for example seed=7",
    "optimizer=adamw +optimizer.foo=3": "optimizer: unknown key 'foo'; it takes lr, betas",
    "+trainer.max_epoch=3": "trainer: unknown key 'max_epoch'; did you mean 'max_epochs'?",
    "+trainer.callbacks=3": "trainer: unknown key 'callbacks'",
    "+evaluation.foo=3": "evaluation: unknown key 'foo'; it takes seed, save_predictions, figures",
    "~data.seed": "data: expected key 'seed'; received",
    "~model.network": "model: expected key 'network'",
    "+callbacks.x._target_=ahnn.systems.Kepler": "callbacks.x: expected key 'name'",
    "+callbacks.x._target_=torch.nn.Identity": "callbacks.x: expected Callback; received Identity",
    "+callbacks.x=3": "callbacks.x: expected a node with _target_; received 3",
    "evaluation=3": "evaluation: expected one of full, scores; received 'evaluation=3'",
    # values that other libraries judge
    "optimizer=adamw optimizer.lr=-1": "optimizer: Invalid learning rate: -1",
    "optimizer=adamw optimizer.lr=foo": "optimizer.lr: expected float or Tensor; received 'foo'",
    "optimizer=adamw optimizer.lr=null": "optimizer.lr: expected float or Tensor; received None",
    "optimizer=adamw optimizer.betas=3": "optimizer.betas: expected a list of 2",
    "optimizer=adamw optimizer.betas=[0.9]": "optimizer.betas: expected a list of 2",
    "trainer.accelerator=foo": "trainer: You selected an invalid accelerator",
    "trainer.accelerator=null": "trainer.accelerator: expected Accelerator or str",
    "trainer.devices=x": "trainer: `devices`",
    "trainer.gradient_clip_val=abc": "trainer.gradient_clip_val: expected float or int or None",
    "+trainer.precision=foo": "trainer.precision: expected one of",
    "optimizer=levenberg_marquardt trainer.gradient_clip_val=1.0": "or choose recipe=first_order",
    "+trainer.accumulate_grad_batches=0": "trainer.accumulate_grad_batches: expected int >= 1; received 0",
    f"optimizer=adamw {COSINE} scheduler.T_max=x": "scheduler.T_max: expected int; received 'x'",
    f"optimizer=adamw {COSINE} scheduler.T_max=0": "scheduler: expected settings that allow a step",
    f"{GL4} integrator.tolerance=x": "integrator gl4.tolerance: expected float > 0 and < 1; received 'x'",
    f"{GL4} integrator.tolerance=null": "integrator gl4.tolerance: expected float > 0 and < 1; received None",
    f"{GL4} integrator.max_iterations=x": "integrator gl4.max_iterations: expected int",
    f"{GL4} integrator.max_iterations=2.7": "integrator gl4.max_iterations: expected int from 1 to 1000",
    # values that we judge
    "data.split=[0.9,0.3,0.1]": "ahnn: data.split: expected three positive fractions",
    "data.trajectories=1": "ahnn: data.split: expected at least one trajectory in each of train, val, test",
    "system=three_body system.masses=[1.0,2.0]": "ahnn: system.masses: expected one number for each of 3",
    **{f"trainer.max_epochs={n}": "trainer.max_epochs: expected" for n in ("two", "2.5", "null", "-1", "0")},
    "seed=4294967296": "seed: expected int from 0 to 4294967295; received 4294967296",
    "data.seed=9e22": "data.seed: expected int from 0 to 4294967295",
    "data.order_seed=99999999999999": "data.order_seed: expected int from 0",
    "threads=100000": "threads: expected int from 1 to 1024; received 100000",
    "seeds=7": "seeds: expected a list of int from 0 to 4294967295 or None; received 7",
    "seeds=[7,x]": "seeds: expected a list of int from 0",
    "seeds=[7,7]": "seeds: expected different seeds",
    "evaluation.seed=x": "evaluation.seed: expected int from 0 to 4294967295; received 'x'",
    "model.window=7": "unknown key 'model.window'; did you mean 'window'?",
    "data.window=3": "unknown key 'data.window'; did you mean 'window'?",
    "loss.order=2000 loss.derivative=1": "loss.order: expected windows of 1 to 60 steps",
    "system=quartic": "toda. For your own options add --config-dir FOLDER",
    "model=mechanical": "model: unknown option 'mechanical'; it is an option of hamiltonian: ham",
    "system=pendulum system=duffing": "system: expected one option; received system=pendulum and",
    "trainer.accelerator=gpu": "trainer.accelerator: expected a GPU; received none. Use trainer.accel",
    "loss.derivative=1 system.steps=8": "loss.order: expected windows of 1 to 8 steps",
}


@pytest.mark.sampled(3)
@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_message_and_leaves_nothing(mistake, tmp_path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = mistake.split()
    kept = [o for o in SMALL if not any(g.startswith(o.split("=")[0] + "=") for g in given)]
    smoke = [] if mistake.startswith("budget") else ["budget=smoke"]
    first = [] if "loss" in mistake or "recipe" in mistake else ["recipe=first_order"]
    assert call("ahnn.train", *smoke, *first, *kept, f"run={tmp_path / 'run'}", *given) == 2
    out, err = capfd.readouterr()
    assert err.startswith("ahnn: ")
    assert err.count("\n") == 1
    assert MISTAKES[mistake] in err
    assert "Traceback" not in out + err
    assert "pkg://" not in err
    assert list(tmp_path.iterdir()) == []
    assert not GlobalHydra.instance().is_initialized()


@pytest.mark.parametrize("run", ["/proc/x", "plain/x"])
def test_a_run_folder_that_cannot_be_created_is_named(run, tmp_path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plain").touch()
    assert call("ahnn.train", "system=pendulum", "budget=smoke", f"run={run}") == 2
    assert capfd.readouterr().err.startswith(f"ahnn: run: cannot create the folder {run}: N")


@pytest.mark.parametrize("named", [[], ["run=a/b/c"], ["run=runs/mine"]])
@pytest.mark.parametrize("there", [False, True])
def test_a_refusal_leaves_none_of_the_folders_above_that_it_made(named, there, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if there:
        (tmp_path / "runs").mkdir()
    assert call("ahnn.train", "trainer.max_epochs=-5", *named) == 2
    assert [path.name for path in tmp_path.rglob("*")] == ["runs"] * there


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["data.noise=0.01"], "data.noise: expected a recipe for noisy measurements"),
        (["experiment=molniya_mechanical", "data.noise=0.1"], "data.noise: expected a recipe for"),
        (["system=molniya", "sensor=orbit_states", "recipe=eccentric"], "loss.balance: expected 0 with"),
        (["data.noise=0.1", "recipe=second_order", "loss.balance=0.5"], "loss.balance: expected 0 with"),
        (["system=molniya", "sensor=orbit_positions", "hamiltonian=mechanical"], "recipe: expected a recipe"),
        (["experiment=molniya_positions", "hamiltonian=mechanical"], "recipe: expected a recipe"),
    ],
)
def test_no_recipe_learns_noise_unless_it_is_named(given, said, tmp_path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert call("ahnn.train", *given, "budget=smoke", "plugins=none", "run=run") == 2
    out, err = capfd.readouterr()
    assert err.startswith(f"ahnn: {said}")
    assert err.count("\n") == 1
    assert not out
    assert list(tmp_path.iterdir()) == []


def test_a_potential_is_not_asked_for_where_there_is_a_beginning_or_another_objective():
    asked = ["system=molniya", "sensor=orbit_positions", "hamiltonian=mechanical"]
    for named in ("recipe=noisy_positions", "ckpt=last", "weights=other", "loss.stages=[[weak,1.0]]"):
        assert compose(config_loader(), "train", [*asked, named]).model.hamiltonian == "mechanical"


def test_a_command_line_is_composed_twice_and_no_more(tmp_path, monkeypatch):
    compose, names = ConfigLoaderImpl.load_configuration, []

    def counted(self, config_name, *arguments, **options):
        names.append(config_name)
        return compose(self, config_name, *arguments, **options)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(ConfigLoaderImpl, "load_configuration", counted)
    look_up = Hydra.get_mode
    assert call("ahnn.train", "trainer.max_epochs=-5") == 2
    assert names == ["train", "train"]
    assert Hydra.get_mode is look_up


def test_a_key_like_no_other_lists_the_top_level_alone(tmp_path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert call("ahnn.train", "foo=1") == 2
    err = capfd.readouterr().err
    assert "unknown key 'foo'; it takes budget, callbacks, ckpt" in err
    assert len(err) < 400


@pytest.fixture
def no_evaluation(monkeypatch):
    """The evaluation after a training has tests of its own."""
    monkeypatch.setattr("ahnn.jobs.closing.judge", lambda *_, **__: 0.0)


@pytest.mark.usefixtures("no_evaluation")
def test_no_experiment_and_no_recipe_of_a_system_are_no_mistake(tmp_path):
    for name, options in {"a": ["experiment=null", "sweep=null"], "b": ["system=pendulum"]}.items():
        assert (
            call("ahnn.train", *SMALL, *ADAMW, "trainer.max_epochs=1", *options, f"run={tmp_path / name}")
            == 0
        )


def test_a_sweep_checks_all_values_of_settings_before_its_first_job(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    assert call("ahnn.train", "-m", "seed=1,a", "budget=smoke", f"hydra.sweep.dir={tmp_path / 'sweep'}") == 2
    assert capfd.readouterr().err.endswith("seed: expected int from 0 to 4294967295; received 'a' (str)\n")
    assert call("ahnn.train", "run=", "budget=smoke") == 2
    assert "run: expected a folder; received none" in capfd.readouterr().err
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_jobs_of_a_sweep_keep_the_line_that_names_them(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    wrong = ["model.network.width=x,y", f"hydra.sweep.dir={tmp_path / 'sweep'}"]
    assert call("ahnn.train", "-m", *wrong) == 2
    err = capfd.readouterr().err
    assert "Error executing job with overrides: ['model.network.width=x']" in err
    assert "width: expected int >= 1; received 'x' (str)" in err.splitlines()[-1]


def test_a_sweep_runs_in_the_folder_of_its_run_or_says_that_it_cannot(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    assert in_one_folder(["-m", "run=runs/all", "seed=1,2"]) == ["-m", "hydra.sweep.dir=runs/all", "seed=1,2"]
    assert in_one_folder(["run=runs/all", "seed=1"]) == ["run=runs/all", "seed=1"]
    for several in ("run=a,b", "run=runs/${seed}"):
        assert call("ahnn.train", "-m", "seed=1,2", "budget=smoke", several) == 2
        assert "run: expected one folder for all jobs of a sweep" in capfd.readouterr().err
    assert not [*tmp_path.iterdir()]


def test_flags_may_stand_anywhere():
    given = ["seed=7", "--config-dir", "mine", "-m", "system=my", "-i", "config", "~logger", "--info", "a=1"]
    flags = ["--config-dir", "mine", "-m", "-i", "config", "--info"]
    assert flags_last(given) == ["seed=7", "system=my", "~logger", "a=1", *flags]
