"""Damage to bytes: flips, cuts, swaps, insertions."""

from __future__ import annotations


def damaged(draw, content: bytes) -> tuple[str, bytes]:
    """Return content with one damage, and its name; never the content itself."""
    kind = draw.choice(["flip", "cut", "zero", "insert", "swap", "double"])
    place = draw.randrange(len(content))
    length = min(draw.choice([1, 8, 64, 1024]), len(content) - place)
    part = content[place : place + length]
    changed = {
        "flip": content[:place] + bytes([content[place] ^ (1 << draw.randrange(8))]) + content[place + 1 :],
        "cut": content[:place],
        "zero": content[:place] + bytes(length) + content[place + length :],
        "insert": content[:place] + draw.randbytes(length) + content[place:],
        "swap": content[:place] + part[::-1] + content[place + length :],
        "double": content + part,
    }[kind]
    return f"{kind} of {length} at {place} of {len(content)}", changed if changed != content else content[:-1]
