"""Output to standard output, with 80 columns for files and pipes, in any encoding."""

from __future__ import annotations

import sys

from rich.console import Console, RenderableType

WIDTH = 80
"""Width of output that is not written to a terminal."""

ASCII = {
    "²": "^2",
    "³": "^3",
    "·": "*",
    "±": "+/-",
    "–": "-",
    "…": "...",
    "⁻": "^-",
    "¹": "1",
    "⁺": "+",
    "°": " deg",
    "σ": "sigma",
    "µ": "u",
    "μ": "mu",
    "α": "alpha",
    "Δ": "Delta",
    "θ": "theta",
}
"""Replacements of characters missing in an encoding."""


def show(content: RenderableType) -> None:
    """Write a text or table to standard output, in the width of the terminal or `WIDTH` columns."""
    stream = sys.stdout
    console = Console(file=stream, width=None if stream.isatty() else WIDTH)
    with console.capture() as capture:
        console.print(content, markup=False, highlight=False, soft_wrap=isinstance(content, str))
    stream.write(writable(capture.get(), stream.encoding))


def writable(text: str, encoding: str | None) -> str:
    """Replace characters of a text that are missing in an encoding."""
    encoding = encoding or "ascii"
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        pass
    else:
        return text
    known = "".join(sign if _has(encoding, sign) else ASCII.get(sign, sign) for sign in text)
    return known.encode(encoding, "replace").decode(encoding)


def _has(encoding: str, sign: str) -> bool:
    try:
        sign.encode(encoding)
    except UnicodeEncodeError:
        return False
    return True
