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
    while True:
        name, value = draw.choice([*STATES, *STATE]), draw.choice(ODD)
        said = name if name in STATES else f"{name} {value}"
        yield said, partial(saved, Path(tempfile.mkdtemp(dir=folder)), name, value)


def negated(tensor):
    """Return a tensor with another sign."""
    return -tensor


STATES = {
    "mean, negated": ("mean", negated), "mean, NaN": ("mean", lambda t: t * NAN), "mean, single": ("mean", torch.Tensor.float),
    "chol, doubled": ("chol", lambda t: 2 * t), "chol, empty": ("chol", lambda t: t[:0]), "time, NaN": ("time", lambda t: t * NAN),
    "time, later": ("time", lambda t: t + 60), "steps": ("steps", lambda t: t + 1), "status": ("status", lambda t: t + 1),
    "rejections": ("rejections", lambda t: t + 3), "mean, moved": ("mean", lambda t: t + 1.0),
    "readings": ("readings", lambda _: "[]"), "since": ("since", lambda _: "nan"), "since, earlier": ("since", lambda _: "0.0"),
    "of": ("of", lambda _: "0"), "readings, moved": ("readings", lambda text: text.replace("[[120.0", "[[121.0")),
}  # fmt: skip
"""Changes of the tensors and notes of a saved stream."""


def saved(place, name, value) -> None:
    """Go on from a changed state; what comes out is what would have come out, or nothing."""
    measurements, state = place / "fixes.csv", place / "s"
    words = assimilating(measurements, "window=120", f"state={state}", f"output={place}/o.csv")
    more = [(t + 180, *rest) for t, *rest in FIXES]
    fixes(measurements)
    code, said = enter(place, "assimilate", *words)
    assert code == 0, said[-300:]
    fixes(measurements, [*FIXES, *more])
    shutil.copy(place / "o.csv", place / "kept.csv")
    shutil.copy(state, place / "kept")
    code, said = enter(place, "assimilate", *words)
    assert code == 0, said[-300:]
    expected = (place / "o.csv").read_text()
    shutil.copy(place / "kept.csv", place / "o.csv")
    with safe_open(place / "kept", framework="pt") as file:
        parts, notes = {key: file.get_tensor(key) for key in file.keys()}, file.metadata()  # noqa: SIM118
    if name in STATES:
        key, act = STATES[name]
        table = parts if key in parts else notes
        table[key] = act(table[key])
    else:
        notes["stream"] = json.dumps(changed(json.loads(notes["stream"]), name, value))
    state.write_bytes(save({key: part.contiguous() for key, part in parts.items()}, notes))
    code, said = enter(place, "assimilate", *words)
    answered(code, said)
    assert (place / "o.csv").read_text() == expected, f"other estimates, exit code 0: {said[-200:]}"
