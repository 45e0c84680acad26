"""Search space in Hydra's sweep grammar, from configuration and command line.

Supported sweeps of a key:

    choice(128, 256, 512)            categorical; 128,256,512 is equivalent
    range(3, 11)                     3, 4, ..., 10: the end is excluded, as everywhere in Hydra
    interval(0.1, 1.0)               any real number
    int(interval(1, 5))              1, 2, ..., 5: the end is included
    tag(log, interval(1e-4, 1e-3))   any real number, on a logarithmic scale

The command line takes precedence over the configuration, key by key.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from hydra.core.override_parser.types import IntervalSweep, QuotedString, RangeSweep, Transformer

from ahnn.errors import UserError

if TYPE_CHECKING:
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.core.override_parser.types import Override
    from optuna.distributions import BaseDistribution


class SearchSpace(NamedTuple):
    """Searched and fixed overrides.

    Attributes:
        distributions: one per searched key.
        texts: for a categorical key, its choices in command line syntax.
        fixed: the other overrides, in order.
    """

    distributions: dict[str, BaseDistribution]
    texts: dict[str, list[str]]
    fixed: list[str]

    def overrides(self, params: Mapping[str, Any]) -> list[str]:
        """Return the overrides of a job with given parameters."""
        return [f"{key}={self._text(key, value)}" for key, value in params.items()]

    def _text(self, key: str, value: Any) -> str:
        if key in self.texts:
            return self.texts[key][int(self.distributions[key].to_internal_repr(value))]
        return repr(value)


def parse(parser: OverridesParser, params: Mapping[str, Any], arguments: Sequence[str]) -> SearchSpace:
    """Sort overrides into searched and fixed ones; the command line takes precedence.

    Args:
        parser: Hydra's parser.
        params: sweeps by key, from `hydra.sweeper.params`.
        arguments: overrides of the command line.

    Raises:
        UserError: for a sweep that cannot be searched.
    """
    lines = [f"{key}={value}" for key, value in params.items()] + list(arguments)
    latest = {override.get_key_element(): override for override in parser.parse_overrides(lines)}
    space = SearchSpace({}, {}, [])
    for key, override in latest.items():
        if not override.is_sweep_override():
            space.fixed.append(override.input_line or f"{key}={override.get_value_element_as_str()}")
            continue
        sweep = override.value()
        if isinstance(sweep, IntervalSweep):
            space.distributions[key] = _interval(key, sweep)
        elif isinstance(sweep, RangeSweep):
            space.distributions[key] = _range(key, sweep)
        else:
            space.distributions[key], space.texts[key] = _choice(override)
    return space


def _interval(key: str, sweep: IntervalSweep) -> BaseDistribution:
    from optuna.distributions import FloatDistribution, IntDistribution

    low, high, log = sweep.start, sweep.end, "log" in sweep.tags
    if low is None or high is None or not low < high or (log and low <= 0):
        message = (
            f"search space of {key}: expected interval(low, high) with low < high, "
            f"and low > 0 with tag(log); received interval({low}, {high})"
        )
        raise UserError(message)
    if isinstance(low, int) and isinstance(high, int):
        return IntDistribution(low, high, log=log)
    return FloatDistribution(low, high, log=log)


def _range(key: str, sweep: RangeSweep) -> BaseDistribution:
    from optuna.distributions import FloatDistribution, IntDistribution

    values = list(sweep.range())
    if len(values) < 2 or values[0] > values[-1] or "log" in sweep.tags:
        message = (
            f"search space of {key}: expected a rising range(start, stop, step) of at least two values, "
            f"without tag(log); received range({sweep.start}, {sweep.stop}, {sweep.step}); "
            "use interval or choice"
        )
        raise UserError(message)
    if all(isinstance(value, int) for value in values):
        return IntDistribution(values[0], values[-1], step=int(sweep.step))
    return FloatDistribution(float(values[0]), float(values[-1]), step=float(sweep.step))


def _choice(override: Override) -> tuple[BaseDistribution, list[str]]:
    """Return a categorical distribution and its choices as text; Optuna gets lists and dicts as text."""
    from optuna.distributions import CategoricalDistribution

    values = list(override.sweep_iterator())
    texts = [Transformer.str(value) for value in values]
    choices: list[bool | int | float | str | None] = []
    for value, text in zip(values, texts, strict=True):
        plain = value.text if isinstance(value, QuotedString) else value
        choices.append(plain if plain is None or isinstance(plain, bool | int | float | str) else text)
    return CategoricalDistribution(choices), texts
