"""Fields of the saved state of a stream: the same estimates come out of a changed one, or it is refused."""

from __future__ import annotations

import json
import shutil
import tempfile
from functools import partial
from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import save

from .doors import FIXES, answered, assimilating, enter, fixes
from .fields_runs import NAN, ODD, changed

STATE = ["lines", "place", "digest", "size", "header", "counts", "clock"]
"""Notes of the stream."""


def cases(draw, folder):
    """Yield a field and a value."""
    expected = begun(folder)
    while True:
        name, value = draw.choice([*STATES, *STATE]), draw.choice(ODD)
        said = name if name in STATES else f"{name} {value}"
        yield said, partial(saved, Path(tempfile.mkdtemp(dir=folder)), expected, name, value)


def words(place: Path) -> list[str]:
    """Return the words of the stream."""
    return assimilating(place / "fixes.csv", "window=120", f"state={place}/state", f"output={place}/o.csv")


def begun(folder: Path) -> str:
    """Save a state in `folder/saved` after half of the lines, and return the output after all of them."""
    kept = folder / "saved"
    kept.mkdir()
    for name, rows in (("half", FIXES), ("whole", [*FIXES, *((t + 180, *rest) for t, *rest in FIXES)])):
        fixes(kept / "fixes.csv", rows)
        code, said = enter(kept, "assimilate", *words(kept))
        assert code == 0, said[-300:]
        if name == "half":
            shutil.copy(kept / "o.csv", kept / "half.csv")
            shutil.copy(kept / "state", kept / "half")
    return (kept / "o.csv").read_text()


def negated(tensor):
    """Return a tensor with another sign."""
    return -tensor


STATES = {
    "nothing": ("mean", torch.Tensor.clone),
    "mean, negated": ("mean", negated), "mean, NaN": ("mean", lambda t: t * NAN), "mean, single": ("mean", torch.Tensor.float),
    "chol, doubled": ("chol", lambda t: 2 * t), "chol, empty": ("chol", lambda t: t[:0]), "time, NaN": ("time", lambda t: t * NAN),
    "time, later": ("time", lambda t: t + 60), "steps": ("steps", lambda t: t + 1), "status": ("status", lambda t: t + 1),
    "rejections": ("rejections", lambda t: t + 3), "mean, moved": ("mean", lambda t: t + 1.0),
    "readings": ("readings", lambda _: "[]"),
    "of": ("of", lambda _: "0"), "readings, moved": ("readings", lambda text: text.replace("[[120.0", "[[121.0")),
}  # fmt: skip
"""Changes of the tensors and notes of a saved stream."""


def saved(place, expected, name, value) -> None:
    """Go on from a changed state; what comes out is what would have come out, or nothing."""
    kept = place.parent / "saved"
    shutil.copy(kept / "fixes.csv", place / "fixes.csv")
    shutil.copy(kept / "half.csv", place / "o.csv")
    with safe_open(kept / "half", framework="pt") as file:
        parts, beside = {key: file.get_tensor(key) for key in file.keys()}, file.metadata()  # noqa: SIM118
    about = json.loads(beside["ahnn"])
    notes = about["notes"]
    if name in STATES:
        key, act = STATES[name]
        table = parts if key in parts else notes
        table[key] = act(table[key])
    else:
        notes["stream"] = json.dumps(changed(json.loads(notes["stream"]), name, value))
    content = {key: part.contiguous() for key, part in parts.items()}
    (place / "state").write_bytes(save(content, beside | {"ahnn": json.dumps(about)}))
    code, said = enter(place, "assimilate", *words(place))
    answered(code, said)
    assert (place / "o.csv").read_text() == expected, f"other estimates, exit code 0: {said[-200:]}"
