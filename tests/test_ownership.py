"""What the command line names, holds: every key has one owner, and bundles choose options of other groups."""

from __future__ import annotations

from functools import cache
from itertools import product

import pytest
from entry import untouched
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

import ahnn.cli.build  # noqa: F401 - registers the resolvers of conf/
from ahnn.paths import conf_dir

GROUPS = {
    folder.name: sorted(path.stem for path in folder.glob("*.yaml"))
    for folder in sorted(conf_dir().iterdir())
    if folder.is_dir() and folder.name != "hydra"
}
Path = tuple[str, ...]
OPTIONS = [(group, option) for group, options in GROUPS.items() for option in options]
CHOOSING = ("recipe", "model", "system", "sweep", "experiment")
"""Groups whose options choose options of others."""

BUNDLES = [{group: option} for group, option in OPTIONS if group in CHOOSING]
LEAVES = {group: options for group, options in GROUPS.items() if group not in (*CHOOSING, "budget")}
ROUNDS = [
    {group: options[k % len(options)] for group, options in LEAVES.items()}
    for k in range(max(map(len, LEAVES.values())))
]
"""An option of every other group at once, so that each of them is in one of the rounds."""

ALWAYS = ("smoke",)
BUDGETS = [pytest.param(b, marks=() if b in ALWAYS else pytest.mark.slow) for b in GROUPS["budget"]]
PAIRS = [("system", "recipe"), ("experiment", "budget"), ("sweep", "model")]
OFTEN = 5
"""One in so many pairs is tried each time, every option in several of them; the slow suite tries all."""
CROSSED = [
    pytest.param((a, x), (b, y), marks=() if (i + j) % OFTEN == 0 else pytest.mark.slow)
    for a, b in PAIRS
    for (i, x), (j, y) in product(enumerate(GROUPS[a]), enumerate(GROUPS[b]))
    if y not in ALWAYS
]
"""Without the budgets that every experiment meets as one of `BUNDLES`."""


@cache
def text(group: str, option: str) -> str:
    return (conf_dir() / group / f"{option}.yaml").read_text()


def plain(cfg) -> dict:
    return OmegaConf.to_container(cfg, resolve=False)  # pyright: ignore


def flat(content: dict, path: Path = ()) -> dict[Path, object]:
    """Path and unresolved value of every leaf; hydra. is Hydra's own, which a sweep configures."""
    found: dict[Path, object] = {}
    for key, value in content.items():
        if (*path, key) != ("hydra",):
            found |= flat(value, (*path, key)) if isinstance(value, dict) else {(*path, key): value}
    return found


@cache
def own_keys(group: str, option: str) -> dict[Path, object]:
    """All that an option sets itself, options it is built on included."""
    content = plain(OmegaConf.create(text(group, option)))
    keys: dict[Path, object] = {}
    for entry in content.pop("defaults", []):
        if isinstance(entry, str) and entry != "_self_":
            keys |= own_keys(group, entry)
    head = [line for line in text(group, option).splitlines() if line.startswith("# @package")]
    package = head[0].split()[-1] if head else group
    keys |= flat(content, () if package == "_global_" else tuple(package.split(".")))
    inner = {key[:k] for key in keys for k in range(len(key))}
    return {key: value for key, value in keys.items() if key not in inner}


def chosen(group: str, option: str) -> dict[str, str]:
    """Group and option of what an option chooses of other groups."""
    found: dict[str, str] = {}
    for entry in plain(OmegaConf.create(text(group, option))).get("defaults", []):
        if isinstance(entry, str) and entry != "_self_":
            found |= chosen(group, entry)
        elif isinstance(entry, dict):
            ((key, value),) = entry.items()
            found[key.removeprefix("override ").lstrip("/").split("@")[0]] = value
    return found


def composed(*overrides: str):
    with untouched(), initialize_config_dir(str(conf_dir()), version_base="1.3"):
        return compose("train", ["folder=.", *overrides], return_hydra_config=True)


def require(cfg, group: str, option: str) -> None:
    found = flat(plain(cfg))
    for key, value in own_keys(group, option).items():
        assert found.get(key, "nothing") == value, f"{group}={option}: {'.'.join(key)}"


def test_no_key_has_two_owners():
    owners: dict[Path, set[str]] = {}
    for group, option in OPTIONS:
        for key in own_keys(group, option):
            owners.setdefault(key, set()).add(group)
    top = plain(OmegaConf.load(conf_dir() / "train.yaml"))
    del top["defaults"]
    for key in flat(top):
        owners.setdefault(key, set()).add("train.yaml")
    assert not {".".join(key): groups for key, groups in owners.items() if len(groups) > 1}
    for key in owners:
        for k in range(1, len(key)):
            assert owners.get(key[:k], owners[key]) == owners[key], f"{key[:k]} holds {key}"


ON_MEASUREMENTS = (
    "shooting",
    "shooting_bodies",
    "weak",
    "weak_dense",
    "weak_positions",
)
"""Losses that compare measurements: their keys are others than those of windows of states."""


def test_alternatives_of_a_choice_set_the_same_keys():
    """Otherwise one option would leave keys behind that only another one explains."""
    for group in ("budget", "recipe", "network", "hamiltonian", "inputs", "scaling", "loss", "evaluation"):
        keys = {
            option: own_keys(group, option).keys()
            for option in GROUPS[group]
            if option not in ON_MEASUREMENTS
        }
        assert all(found == keys[GROUPS[group][0]] for found in keys.values()), group
    first, *others = (own_keys("loss", option).keys() for option in ON_MEASUREMENTS)
    assert all(other == first for other in others)
    assert not first & own_keys("loss", "recursive").keys()


@pytest.mark.parametrize("budget", BUDGETS)
@pytest.mark.parametrize(
    "named", [*BUNDLES, *ROUNDS], ids=lambda named: ",".join(map("=".join, named.items()))
)
@pytest.mark.sampled(3)
def test_every_key_and_choice_of_every_option_holds_with_every_budget(named, budget):
    named = {"budget": budget} | named
    cfg = composed(*(f"{name}={value}" for name, value in named.items()))
    choices = {key.split("@")[0]: value for key, value in cfg.hydra.runtime.choices.items()}
    for name, value in named.items():
        require(cfg, name, value)
        for other, option in chosen(name, value).items():
            if other not in named and isinstance(option, str):
                assert choices[other] == option


@pytest.mark.parametrize(("one", "other"), CROSSED)
@pytest.mark.sampled(2)
def test_two_options_hold_together(one, other):
    cfg = composed("=".join(one), "=".join(other))
    require(cfg, *one)
    require(cfg, *other)


def test_a_key_that_is_named_wins_over_every_option():
    cfg = composed(
        "experiment=molniya_mechanical", "budget=smoke", "trainer.max_epochs=3", "loss.balance=0.1"
    )
    assert (cfg.trainer.max_epochs, cfg.loss.balance, cfg.data.emphasis) == (3, 0.1, 0.5)
    assert composed("loss=derivative").loss.derivative == 1.0
    assert composed("model=mlp", "loss.derivative=1").model.loss.derivative == 1


def test_the_experiment_of_the_spring_is_the_default():
    one, other = plain(composed()), plain(composed("experiment=spring"))
    del one["hydra"], other["hydra"]
    assert one == other


def test_options_of_ones_own_are_found_anywhere(tmp_path):
    (tmp_path / "system").mkdir()
    (tmp_path / "experiment").mkdir()
    (tmp_path / "system" / "quartic.yaml").write_text("_target_: my_systems.Quartic\nname: quartic\n")
    (tmp_path / "experiment" / "mine.yaml").write_text(
        "# @package _global_\ndefaults:\n  - _self_\n  - override /system: quartic\n"
        "experiment:\n  label: mine\n"
    )
    cfg = composed("experiment=mine", f"hydra.searchpath=[file://{tmp_path}]")
    assert (cfg.system.name, cfg.label) == ("quartic", "mine")


def test_a_search_is_written_where_the_same_command_finds_it_again():
    folder = "runs/sweeps/${hydra.sweeper.study_name}"
    assert select_text(composed("sweep=quick", "model=hnn")) == folder
    assert select_text(composed()).startswith("runs/sweeps/${now:")


def select_text(cfg) -> str:
    return plain(cfg)["hydra"]["sweep"]["dir"]
