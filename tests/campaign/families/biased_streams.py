"""Streams of sensors with biases: what is said of them, and saved streams that go on under other words.

What is accepted gives the estimates of the same biases said in another way, bit for bit.
"""

from __future__ import annotations

import tempfile
from functools import cache, partial
from pathlib import Path

import numpy as np
from safetensors import safe_open
from safetensors.torch import save

from .biases_values import NAN, becomes, drawn, words_of
from .doors import FIXES, answered, assimilating, enter, fixes, taken

NAMED = ["+measurement@sensors.gnss=position", "sensors.gnss.sd=0.1"]
SENSORS = {
    "sensors.gnss.bias_sd=0.5": "same", "+sensors.gnss.bias_sd=0.5": "any", "++sensors.gnss.bias_sd=0.5": "any", "": "none",
    "sensors.gnss.bias_sd=0.5 sensors.gnss.bias_memory=60": "wanders", "sensors.gnss.bias_sd=null": "none", "sensors.gnss.bias_memory=60": "refused",
    "sensors.gns.bias_sd=0.5": "refused", "sensors.bias_sd=0.5": "refused", "sensors.gnss.model.bias_sd=0.5": "refused",
    "sensors.gnss.bias=0.5": "refused", "sensors.gnss.bias_sds=0.5": "refused", "sensors.gnss.bias_sd.x=0.5": "refused",
    "measurement.bias_sd=0.5": "refused", "plugins.ukf.bias_sd=0.5": "refused", "bias_sd=0.5": "refused", "sensors.gnss.bias_sd=": "refused",
    "sensors.gnss.bias_sd=0.5 sensors.gnss.bias_sd=0.6": "any", "sensors.GNSS.bias_sd=0.5": "refused", "~sensors.gnss.bias_sd": "refused",
    "sensors.gnss.bias_sd=[0.5,0.5]": "refused", "sensors.gnss.bias_sd=-1": "refused", "sensors.gnss={bias_sd: 0.5}": "any",
}  # fmt: skip
"""Words behind a sensor of a name of its own, and the estimates that follow."""
AFTER = ["measurement.bias_sd=0.6", "measurement.bias_sd=null", "measurement.bias_sd=[0.5,0.5,0.4]", "measurement.bias_sd=[0.5,0,0.5]",
         "measurement.bias_memory=60", "measurement.bias_sd=[0.5,0.5,0.5]", "measurement.bias_memory=.inf", "measurement.sd=0.2",
         "measurement=state", *NAMED[:1]]  # fmt: skip
"""What may be asked of a saved stream; the two that say the same go on."""
TENSORS = {
    "mean": lambda t: t + 1e-3, "mean, moved": lambda t: t.roll(1, -1), "mean, short": lambda t: t[..., :-1], "mean, NaN": lambda t: t * NAN,
    "chol": lambda t: 2 * t, "chol, short": lambda t: t[..., :-1, :-1], "chol, turned": lambda t: t.mT, "steps": lambda t: t + 1,
}  # fmt: skip
PAIR = [
    *(
        f"+measurement@sensors.{name}=position sensors.{name}.sd=0.1 sensors.{name}.bias_sd=0.5".split()
        for name in "ab"
    )
]


def cases(draw, folder):
    """Yield words of a stream, or what is changed of a saved one."""
    kept = folder / "kept"
    kept.mkdir()
    while True:
        kind, place = (
            draw.choice(["stream"] * 4 + ["sensors"] * 2 + ["word"] * 2 + ["state"]),
            Path(tempfile.mkdtemp(dir=folder)),
        )
        if kind == "stream":
            sd, memory = drawn(draw)
            yield f"{sd} {memory}", partial(came, place, kept, becomes(sd, memory), *words_of(sd, memory))
        elif kind == "sensors":
            text = draw.choice(list(SENSORS))
            words = [text] if "{" in text else text.split()
            yield f"sensors, {text}", partial(came, place, kept, SENSORS[text], *NAMED, *words)
        elif kind == "word":
            text = draw.choice(AFTER)
            yield f"saved, {text}", partial(resumed, place, text)
        else:
            name = draw.choice([*TENSORS, *["other order"] * 4])
            yield f"saved, {name}", partial(altered, place, name)


@cache
def known(kept: Path, what: str) -> str:
    """Return the estimates under biases that are sound."""
    said = {"same": ["bias_sd=0.5"], "wanders": ["bias_sd=0.5", "bias_memory=60"], "none": []}[what]
    words = assimilating(
        fixes(kept / "fixes.csv"), *(f"measurement.{word}" for word in said), f"output={kept}/{what}.csv"
    )
    code, text = enter(kept, "assimilate", *words)
    assert code == 0, text[-300:]
    return numbers(kept / f"{what}.csv")


def numbers(path: Path) -> str:
    """Return an output without the names of sensors."""
    lines = [line.split(",") for line in path.read_text().splitlines()]
    return "\n".join(",".join(cells[:2] + cells[3:]) for cells in lines)


def came(place: Path, kept: Path, expected: str, *words: str) -> None:
    """Hold the estimates of a stream against those that should have come."""
    code, said = enter(
        place, "assimilate", *assimilating(fixes(place / "fixes.csv"), *words, f"output={place}/o.csv")
    )
    with taken(expected not in ("refused", "any")):
        answered(code, said)
    found = numbers(place / "o.csv")
    assert expected != "refused", f"accepted; it says {said[-200:]!r}"
    assert expected == "none" or expected == "any" or "bias of" in said, f"no bias is told: {said[-200:]!r}"
    if expected == "other":
        assert all(found != known(kept, what) for what in ("same", "wanders", "none")), "it has no effect"
    elif expected == "none":
        one, other = (
            np.genfromtxt(text.splitlines(), delimiter=",", skip_header=1)[:, 6:12]
            for text in (found, known(kept, "none"))
        )
        assert np.allclose(one, other, rtol=1e-6, atol=1e-9), "other estimates than without biases"
    elif expected != "any":
        assert found == known(kept, expected), f"other estimates than {expected}"


def stream(place: Path, *words: str) -> tuple[int, str]:
    """Go on with a stream in a place."""
    return enter(
        place,
        "assimilate",
        *assimilating(place / "fixes.csv", *words, f"state={place}/state", f"output={place}/o.csv"),
    )


def begun(place: Path, *words: str, rows=None, head: str = "time [s],x [km],y [km],z [km]") -> str:
    """Assimilate all lines, then half of them into a state, and return the estimates of all."""
    rows, whole = rows or [*FIXES, *((t + 180, *rest) for t, *rest in FIXES)], ""
    for many in (6, 3):
        for name in ("state", "o.csv", "o.yaml"):
            (place / name).unlink(missing_ok=True)
        fixes(place / "fixes.csv", rows[:many], head)
        code, said = stream(place, *words)
        assert code == 0, said[-300:]
        whole = whole or (place / "o.csv").read_text()
    fixes(place / "fixes.csv", rows, head)
    return whole


def resumed(place, text) -> None:
    """Go on with a stream under another word: the same estimates come out, or it is refused."""
    whole = begun(place, "measurement.bias_sd=0.5")
    code, said = stream(place, "measurement.bias_sd=0.5", text)
    answered(code, said)
    assert (place / "o.csv").read_text() == whole, f"other estimates, exit code 0: {said[-200:]}"


def altered(place, name) -> None:
    """Go on with a stream whose state was changed, or whose sensors are named in another order."""
    rows = [(*row, "ab"[k % 2]) for k, row in enumerate([*FIXES, *((t + 180, *rest) for t, *rest in FIXES)])]
    whole = begun(place, *PAIR[0], *PAIR[1], rows=rows, head="time [s],x [km],y [km],z [km],sensor")
    words = (*PAIR[0], *PAIR[1])
    if name == "other order":
        words = (*PAIR[1], *PAIR[0])
    else:
        with safe_open(place / "state", framework="pt") as file:
            parts, beside = {key: file.get_tensor(key) for key in file.keys()}, file.metadata()  # noqa: SIM118
        key = name.partition(",")[0]
        parts[key] = TENSORS[name](parts[key])
        (place / "state").write_bytes(save({key: part.contiguous() for key, part in parts.items()}, beside))
    code, said = stream(place, *words)
    answered(code, said)
    found = (place / "o.csv").read_text()
    one, other = (
        np.genfromtxt(text.splitlines(), delimiter=",", skip_header=1)[:, 6:12] for text in (found, whole)
    )
    assert np.allclose(one, other, rtol=1e-9, atol=1e-9), f"other estimates, exit code 0: {said[-200:]}"
