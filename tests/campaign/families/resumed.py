"""Intact checkpoints of which one thing is another: refused before it is loaded, or a training that goes on."""

from __future__ import annotations

import copy
from functools import partial

import torch

from ahnn.cli.compose import compose_job
from ahnn.cli.prepare import prepare

from .children import TRAINING, plain, trained

ODD = [None, "x", [], {}, -1, 10**12, float("nan"), torch.zeros(3), torch.zeros(10_000), torch.zeros((), dtype=torch.int64),
       torch.zeros(0), torch.full((), torch.nan), [torch.zeros(2)], {"x": torch.zeros(2)}, True, 1j, b"x"]  # fmt: skip


def cases(draw, folder):
    """Yield checkpoints with one value changed, removed or added; one in twenty is trained on."""
    run = folder / "run"
    child = trained(run)
    assert child.code() == 0, child.said()
    whole = torch.load(run / "checkpoints" / "last.ckpt", weights_only=True)
    while True:
        content = copy.deepcopy(whole)
        what = changed(draw, content)
        path = folder / "odd.ckpt"
        yield what, partial(attempt, folder, content, path, draw.random() < 0.05)


def changed(draw, content) -> str:
    """Change one value somewhere and return which."""
    node, names = content, []
    while True:
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        key = draw.choice(keys)
        names.append(str(key))
        inner = node[key]
        if isinstance(inner, dict | list) and inner and draw.random() < 0.9:
            node = inner
            continue
        kind = draw.choice(["change", "change", "remove", "add"])
        if kind == "remove":
            del node[key]
        elif kind == "add":
            node.update({"odd": draw.choice(ODD)}) if isinstance(node, dict) else node.append(
                draw.choice(ODD)
            )
        else:
            node[key] = draw.choice(ODD)
        value = node[key] if kind == "change" else ""
        return f"{kind} {'.'.join(names)} {str(value)[:30]!r}"


def attempt(folder, content, path, goes_on) -> None:
    """Resume from it, up to the fit or with it."""
    torch.save(content, path)
    if not goes_on:
        prepare(compose_job([*TRAINING, f"ckpt={path}"], folder / "other"))
        return
    child = trained(folder / "other", f"ckpt={path}", cache=folder / "cache", name="odd")
    code, said = child.code(), child.said()
    plain(said)
    assert code in (0, 2, 3), f"exit code {code}: {said[-300:]}"
    for old in (folder / "other").rglob("*.ckpt"):
        old.unlink()
