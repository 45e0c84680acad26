"""Values of a sweep, checked before its first job runs."""

from __future__ import annotations

from collections.abc import Iterable
from inspect import signature

from hydra.core.override_parser.types import ChoiceSweep, Override, QuotedString

from ahnn.arguments import check_values
from ahnn.cli.settings import SCHEMAS


def check_swept_values(overrides: Iterable[Override]) -> None:
    """Check the listed values of settings outside objects; raises UserError for the first invalid one."""
    for override in overrides:
        parent, _, name = override.key_or_group.rpartition(".")
        schema, value = SCHEMAS.get(parent), override.value()
        if schema is None or name not in signature(schema).parameters or not isinstance(value, ChoiceSweep):
            continue
        for given in value.list:
            one = given.text if isinstance(given, QuotedString) else given
            if "${" not in str(one):  # the value of an interpolation is not known yet
                check_values(parent, schema, {name: one})
