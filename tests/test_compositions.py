"""The compositions that the tests share are those that Hydra makes anew."""

from __future__ import annotations

from typing import Any

import pytest
from compositions import anew
from omegaconf import OmegaConf

from ahnn.cli.commandline import compose, config_loader
from ahnn.cli.compose import composed
from ahnn.errors import UserError

LINES = [
    [],
    ["seed=3", "system=kepler"],
    ["seed=4", "system=kepler", "+model.network.more=1", "trainer.max_epochs=7"],
    ["plugins=ukf", "sensor=orbit_positions", "hamiltonian=central_body"],
    ["experiment=molniya_mechanical", "~logger"],
    ["hydra/launcher=joblib", "hydra.sweep.dir=7"],
]
WRONG = [
    ["system=nowhere"],
    ["system.nowhere=1"],
    ["model=mlp", "hamiltonian=mechanical"],
    ["seed=[1"],
    ["hydra.job.no=1"],
]


def plain(line: list[str]) -> Any:
    """The configuration of a command line before interpolation, or the message it is refused with."""
    try:
        return OmegaConf.to_container(compose(config_loader(), "train", line), resolve=False)
    except UserError as error:
        return str(error)


@pytest.mark.parametrize("line", [*LINES, *WRONG], ids=" ".join)
def test_a_shared_composition_is_that_of_hydra(line):
    with anew():
        expected = plain(line)
    assert isinstance(expected, str) == (line in WRONG)
    assert plain(line) == plain(line) == expected


def test_a_change_of_a_composition_does_not_reach_the_next():
    first = compose(config_loader(), "train", [])
    expected = OmegaConf.to_container(first, resolve=False)
    OmegaConf.set_struct(first, False)
    first.model.network.width, first.data.more = 77, {"key": 1}
    assert plain([]) == expected


def test_a_folder_of_options_is_read_anew(tmp_path):
    (tmp_path / "system").mkdir()
    for dt in (0.25, 0.5):
        (tmp_path / "system" / "own.yaml").write_text(f"_target_: ahnn.systems.Pendulum\ndt: {dt}\n")
        cfg = compose(config_loader(str(tmp_path)), "train", ["system=own"])
        assert cfg.system.dt == dt


def test_a_list_without_brackets_is_refused_with_them():
    with pytest.raises(UserError, match=r"A list has brackets: start_sd=\[1,0\.001\]"):
        composed("assimilate", ["start_sd=1,0.001"])
