"""HTML from values: every text is escaped unless it was made here."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable


class Markup(str):
    """HTML that is safe to stand in a page: all that came from outside is escaped in it."""

    __slots__ = ()


Content = str | Iterable["Content"]
"""Texts, which are escaped, markup, which is not, and nested sequences of both."""

UNSAFE = re.compile(r"[^A-Za-z0-9_-]+")

VOID = ("meta", "br", "col", "img")


def escaped(content: Content) -> Markup:
    """Return content as markup."""
    if isinstance(content, Markup):
        return content
    if isinstance(content, str):
        return Markup(html.escape(content).replace("\x00", "�"))
    return Markup("".join(escaped(item) for item in content))


def tag(name: str, /, *content: Content, **attributes: str | int | None) -> Markup:
    """Return an element.

    Args:
        name: of the element.
        content: what it holds.
        attributes: their values are escaped; None leaves one out; `class_` is class, `_` stands for `-`.
    """
    pairs = {key.rstrip("_").replace("_", "-"): value for key, value in attributes.items()}
    given = "".join(f' {k}="{html.escape(str(v))}"' for k, v in pairs.items() if v is not None)
    return Markup(f"<{name}{given}>" + ("" if name in VOID else f"{escaped(content)}</{name}>"))


def safe_name(name: str) -> str:
    """Return a name for a file or an anchor: what came from a run folder leads nowhere else."""
    return UNSAFE.sub("_", name)[:100] or "_"
