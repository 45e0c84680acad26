"""The page of the benchmarks: sections that are replaced one by one, and a picture of all ratios."""

from __future__ import annotations

import os
import platform
import re
from pathlib import Path

import torch

PATH = Path(__file__).parent.parent / "docs" / "benchmarks.md"
RATIO = "ahnn / "


def cpu() -> str:
    """Return the name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def machine(load: float) -> str:
    """Return the machine, with its mean load before."""
    shared = f"mean load {load:.1f}" if load > 0.5 else "idle before"
    versions = f"Python {platform.python_version()}, PyTorch {torch.__version__}"
    return f"{cpu()}, {os.cpu_count()} cores, {versions}; {shared}"


def sections(text: str) -> dict[str, str]:
    """Return the text below each heading of a page."""
    parts = re.split(r"^## (.*)\n", text, flags=re.MULTILINE)
    return dict(zip(parts[1::2], (part.strip() for part in parts[2::2]), strict=True))


def write(opening: str, titles: list[str], found: dict[str, str]) -> None:
    """Write the page: new sections replace old ones of the same title, all other sections stay."""
    old = sections(PATH.read_text()) if PATH.exists() else {}
    have = {title: text for title in titles if (text := found.get(title) or old.get(title))}
    parts = [opening.strip(), *(f"## {title}\n\n{text.strip()}" for title, text in have.items())]
    new = PATH.with_suffix(".new")  # not the writer of ahnn: the page is kept by git, and people edit it too
    new.write_text("\n\n".join(parts) + "\n")
    new.replace(PATH)
    picture({title: ratios(text) for title, text in have.items()}, PATH.with_suffix(".png"))


def ratios(text: str) -> list[tuple[str, dict[str, float]]]:
    """Return name and ratios of each row of the tables in a section, bounds as if they were reached."""
    rows: list[tuple[str, dict[str, float]]] = []
    heads: list[str] = []
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if not line.startswith("|"):
            heads = []
        elif not heads:
            heads = cells
        elif not line.startswith("|--"):
            own = {
                head.removeprefix(RATIO): float(cell.strip("<> ").replace(",", ""))
                for head, cell in zip(heads, cells, strict=True)
                if head.startswith(RATIO) and cell
            }
            rows.append((cells[0].replace("`", ""), own))
    return [row for row in rows if row[1]]


def picture(found: dict[str, list[tuple[str, dict[str, float]]]], path: Path) -> None:
    """Draw the ratios of each section, on one axis."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    drawn = {title: rows for title, rows in found.items() if rows}
    heights = [len(rows) + 1.2 for rows in drawn.values()]
    size = 10.0, 0.28 * sum(heights) + 1.0
    figure, panels = plt.subplots(
        len(drawn), sharex=True, squeeze=False, figsize=size, height_ratios=heights, layout="constrained"
    )
    for axes, (title, rows) in zip(panels[:, 0], drawn.items(), strict=True):
        for k, who in enumerate(dict.fromkeys(who for _, values in rows for who in values)):
            places = [(values[who], i) for i, (_, values) in enumerate(rows) if who in values]
            axes.plot(*zip(*places, strict=True), "os^DvPX*"[k % 8], label=who)
        axes.axvline(1.0, color="black", linewidth=1, linestyle="--")
        axes.set(xscale="log", ylim=(len(rows) - 0.4, -0.6), yticks=range(len(rows)))
        axes.set_yticklabels([name for name, _ in rows], fontsize=8)
        axes.set_title(title, fontsize=9, loc="left")
        axes.grid(axis="x", alpha=0.3)
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)
    panels[-1, 0].set_xlabel("time of ahnn / time of the other: ahnn is faster on the left of the line")
    figure.savefig(path, dpi=110)
    plt.close(figure)
