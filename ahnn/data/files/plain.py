"""Plain values in YAML or JSON, whose numbers may have an exponent without a point."""

from __future__ import annotations

import re
from typing import Any

import yaml


class _Loader(yaml.SafeLoader):
    """YAML 1.1 reads 1e5 as a text, JSON and YAML 1.2 as a number."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


def loaded(text: str) -> Any:
    """Return plain values from a text; raises yaml.YAMLError for none."""
    return yaml.load(text, _Loader)
