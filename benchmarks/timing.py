"""Works measured in turn, A B A B, so that a slow spell of the machine meets all of them alike."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from statistics import median
from typing import NamedTuple

import torch

Work = Callable[[], object]


class Row(NamedTuple):
    """One piece of work: its name, CPU seconds of each repeat by who did it, and seconds of the floor."""

    name: str
    times: dict[str, list[float]]
    floor: list[float] | None


def in_turn(
    name: str,
    works: dict[str, Work],
    repeats: int,
    floor: Work | None = None,
    clock: Callable[[], float] = time.process_time,
) -> Row:
    """Return the seconds of all works and of the floor, in turn, after one call each to warm up.

    By default CPU seconds: all threads of the process count, so that a pool of threads gains nothing.
    """
    everything = works if floor is None else {**works, "floor": floor}
    times: dict[str, list[float]] = {key: [] for key in everything}
    for work in everything.values():
        work()
    for _ in range(repeats):
        for key, work in everything.items():
            begin = clock()
            work()
            times[key].append(clock() - begin)
    return Row(name, times, times.pop("floor", None))


def ratio(above: list[float], below: list[float]) -> float:
    """Return the median of the ratios of each repeat."""
    return median(a / b for a, b in zip(above, below, strict=True))


def has(parts: Sequence[str]) -> bool:
    """Return whether all packages that a peer is made of are installed."""
    return all(find_spec(part) for part in parts)


def left_out(needs: Mapping[str, Sequence[str]]) -> list[str]:
    """Report and return the omitted peers, each with the packages that are not installed."""
    found = [
        f"{peer} ({', '.join(part for part in parts if find_spec(part) is None)})"
        for peer, parts in needs.items()
        if not has(parts)
    ]
    for name in found:
        print(f"benchmarks: left out {name}, not installed; pip install -e '.[bench]' brings it", flush=True)
    return found


def shown(value: float) -> str:
    """Return a number as tables have it, about three digits of it."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def markdown(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table, numbers to the right."""
    lines = ["| " + " | ".join(heads) + " |", "|---" + "|--:" * (len(heads) - 1) + "|"]
    return "\n".join([*lines, *("| " + " | ".join(cells) + " |" for cells in rows)]) + "\n"


def table(rows: Sequence[Row], what: str, unit: float = 1e3) -> str:
    """Return rows as a table: ahnn in a unit, the floor, and ahnn relative to each peer."""
    others = [*dict.fromkeys(who for row in rows for who in row.times if who != "ahnn")]
    floor = rows[0].floor is not None
    heads = [what, "ahnn", *(("floor", "ahnn / floor") if floor else ())]
    heads += [f"ahnn / {who}" for who in others]
    lines = []
    for name, times, base in rows:
        own = times["ahnn"]
        cells = [name, shown(unit * median(own))]
        cells += [shown(unit * median(base)), shown(ratio(own, base))] if base else []
        cells += [shown(ratio(own, times[who])) if who in times else "" for who in others]
        lines.append(cells)
    return markdown(heads, lines)


def products(batch: int, width: int, multiply_adds: float, dtype: torch.dtype) -> Work:
    """Return a floor: so many multiply-adds as products (batch, width) @ (width, width)."""
    left, right = torch.randn(batch, width, dtype=dtype), torch.randn(width, width, dtype=dtype)
    out = torch.empty_like(left)
    count = max(1, round(multiply_adds / (batch * width * width)))

    def work() -> None:
        for _ in range(count):
            torch.mm(left, right, out=out)

    return work


def settle() -> None:
    """Let the allocator keep the memory of small tensors, as it does once a data set was loaded."""
    large = torch.ones(8_000_000)
    del large
    torch.set_num_threads(1)
