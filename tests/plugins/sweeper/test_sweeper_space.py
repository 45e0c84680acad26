"""The search space in Hydra's grammar."""

from __future__ import annotations

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

from hydra_plugins.ahnn_sweeper._space import SearchSpace, parse
from hydra_plugins.ahnn_sweeper.sweeper import _kept_below


def space(params: dict[str, object], *arguments: str) -> SearchSpace:
    return parse(OverridesParser.create(), params, arguments)


@pytest.mark.parametrize(
    ("sweep", "expected"),
    [
        ("choice(128, 256)", CategoricalDistribution([128, 256])),
        ("128,256", CategoricalDistribution([128, 256])),
        ("choice('a b', 0.5, true)", CategoricalDistribution(["a b", 0.5, True])),
        ("choice([1, 2], [3])", CategoricalDistribution(["[1,2]", "[3]"])),
        ("range(3, 11)", IntDistribution(3, 10)),
        ("range(300, 401, 50)", IntDistribution(300, 400, step=50)),
        ("range(0, 1, 0.25)", FloatDistribution(0.0, 0.75, step=0.25)),
        ("int(interval(1, 5))", IntDistribution(1, 5)),
        ("interval(0.5, 1)", FloatDistribution(0.5, 1.0)),
        ("tag(log, interval(1e-4, 1e-3))", FloatDistribution(1e-4, 1e-3, log=True)),
    ],
)
def test_distributions(sweep: str, expected: object):
    assert space({"model.width": sweep}).distributions == {"model.width": expected}


def test_the_command_line_wins_over_the_configuration():
    found = space({"a": "range(0, 5)", "b": "interval(0.0, 1.0)"}, "a=3", "b=1,2", "model=hnn")
    assert list(found.distributions) == ["b"]
    assert found.distributions["b"] == CategoricalDistribution([1, 2])
    assert found.fixed == ["a=3", "model=hnn"]


def test_parameters_become_overrides_that_mean_the_same():
    found = space({"a": "choice('x, y', 0.5)", "b": "interval(0.0, 1.0)"})
    lines = found.overrides({"a": "x, y", "b": 1e-7})
    values = {o.key_or_group: o.value() for o in OverridesParser.create().parse_overrides(lines)}
    assert values == {"a": "x, y", "b": 1e-7}


@pytest.mark.parametrize(
    "sweep", ["interval(2, 1)", "tag(log, interval(0.0, 1.0))", "range(5, 0, -1)", "tag(log, range(1, 5))"]
)
def test_impossible_sweeps_name_the_key(sweep: str):
    with pytest.raises(ValueError, match="search space of lr: expected"):
        space({"lr": sweep})


def test_an_infimum_above_the_rate_is_lowered():
    below = {"infimum": "lr", "absent": "lr"}
    assert _kept_below({"infimum": 1e-4, "lr": 1e-4}, below) == {"infimum": 5e-5, "lr": 1e-4}
    assert _kept_below({"infimum": 1e-7, "lr": 1e-4}, below) == {"infimum": 1e-7, "lr": 1e-4}
