"""Generation of HTML, with all external text escaped."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable


class Markup(str):
    """Safe HTML, in which all external text is escaped."""

    __slots__ = ()


Content = str | Iterable["Content"]
"""Content: texts, which are escaped, markup, which is not, and nested sequences of both."""

UNSAFE = re.compile(r"[^A-Za-z0-9_-]+")

VOID = ("meta", "br", "col", "img")


def escaped(content: Content) -> Markup:
    """Convert content to markup."""
    if isinstance(content, Markup):
        return content
    if isinstance(content, str):
        return Markup(html.escape(content).replace("\x00", "�"))
    return Markup("".join(escaped(item) for item in content))


def tag(name: str, /, *content: Content, **attributes: str | int | None) -> Markup:
    """Build an element.

    Args:
        name: name of the element.
        content: content of the element.
        attributes: attribute values, which are escaped; None omits an attribute. `class_` means class, and
            `_` means `-`.
    """
    pairs = {key.rstrip("_").replace("_", "-"): value for key, value in attributes.items()}
    given = "".join(f' {k}="{html.escape(str(v))}"' for k, v in pairs.items() if v is not None)
    return Markup(f"<{name}{given}>" + ("" if name in VOID else f"{escaped(content)}</{name}>"))


def safe_name(name: str) -> str:
    """Return a safe name for a file or an anchor from untrusted text."""
    return UNSAFE.sub("_", name)[:100] or "_"
