"""Identity of a stream's settings: a hash of each, so that a refused saved state names those that differ."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

DIGITS = 16
"""Number of hexadecimal digits of each hash."""


def identity(settings: Mapping[str, Any]) -> str:
    """Return a text that identifies settings, plain values by name."""
    return json.dumps({name: _hash(value) for name, value in sorted(settings.items())})


def differences(saved: str, own: str) -> str:
    """Return the names of the settings that differ between two identities, such as "gate, window"."""
    try:
        known = json.loads(saved)
    except ValueError:
        known = None
    if not isinstance(known, dict):  # an earlier version saved one hash of all settings
        return "settings (it is of an earlier version)"
    mine = json.loads(own)
    return ", ".join(sorted(name for name in {*known, *mine} if known.get(name) != mine.get(name)))


def refusal(path: Any, saved: str, own: str) -> str:
    """Return the message that refuses a saved state whose settings differ."""
    return (
        f"state: expected a state with the settings of this command; received {path}, saved with different "
        f"values of {differences(saved, own)}. Repeat the original command, or remove the state and its "
        "output to start over"
    )


def _hash(value: Any) -> str:
    text = json.dumps(value, sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=DIGITS // 2).hexdigest()
