"""Papers for the methods that a run used: `ahnn.citations`.

`papers.bib` contains the entries; the table here assigns them to methods.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from ahnn.loading import load
from ahnn.runs import Run

PAPERS: dict[str, tuple[str, ...]] = {
    "ahnn": ("kim2025",),
    # model
    "hamiltonian": ("greydanus2019",),
    "recursive loss": ("kim2025",),
    "srnn": ("chen2020",),
    "lagrangian": ("cranmer2020",),
    "node": ("chen2018",),
    "map": (),
    "sympnet": ("jin2020",),
    "henon_net": ("burby2021",),
    "generalised_hnn": ("horn2025",),
    "gaussian process": ("rahimi2007", "tanaka2022", "ross2023"),
    "forces": ("vanderschaft2014",),
    # integrator
    "euler": (),
    "midpoint": (),
    "rk4": ("kutta1901",),
    "dopri5": ("dormand1980",),
    "dopri8": ("prince1981",),
    "gl4": ("hairer2006",),
    "leapfrog": ("hairer2006",),
    "yoshida4": ("yoshida1990",),
    "yoshida6": ("yoshida1990",),
    "yoshida8": ("yoshida1990",),
    "kahan_li6": ("kahan1997",),
    "kahan_li8": ("kahan1997",),
    # objective
    "shooting": ("golub1973",),
    "weak form": ("messenger2021", "bortz2023"),
    "Student's noise": ("lange1989",),
    # optimiser, schedule, callbacks
    "AdamW": ("loshchilov2019",),
    "LevenbergMarquardt": ("marquardt1963",),
    "geodesic acceleration": ("transtrum2012",),
    "SOAP": ("vyas2024",),
    "ExpHyperbolicLR": ("kim2024",),
    "mean of steps": ("polyak1992",),
    "PFLCallback": ("kim2025",),
    # uncertainty
    "covariance of parameters": ("mackay1992",),
    # estimators and other plugins
    "ukf": ("wan2000", "vandermerwe2001"),
    "ckf": ("arasaratnam2009",),
    "ExtendedKalmanFilter": ("barshalom2001",),
    "iterated update": ("bell1993",),
    "GaussHermiteFilter": ("ito2000", "arasaratnam2007"),
    "EnsembleKalmanFilter": ("evensen1994",),
    "square_root ensemble": ("whitaker2002",),
    "stochastic ensemble": ("burgers1998",),
    "localisation": ("gaspari1999",),
    "ParticleFilter": ("gordon1993",),
    "stages of particles": ("oudjane2000",),
    "unscented proposal": ("vandermerwe2000",),
    "InteractingModels": ("blom1988",),
    "smoother": ("sarkka2008",),
    "iterated smoother": ("garcia2017",),
    "least squares": ("tapley2004",),
    "Chaos": ("pathak2018",),
    "Attraction": ("folkner2009",),
    "Horizon": (),
}
"""Keys of `papers.bib` for each method, by its name or its class; an empty tuple for textbook methods."""


class Paper(NamedTuple):
    """An entry of `papers.bib`.

    Attributes:
        key: its key.
        bibtex: its text.
        fields: its fields, without braces.
    """

    key: str
    bibtex: str
    fields: dict[str, str]

    def __str__(self) -> str:
        names = ("journal", "booktitle", "publisher", "institution", "volume", "pages", "number")
        where = [self.fields[name] for name in names[:-1] if name in self.fields]
        where += [f"arXiv:{self.fields['eprint']}"] if "eprint" in self.fields else []
        authors = self.fields["author"].replace(" and ", "; ")
        ending = ", ".join(where) + "." if where else ""
        return f"{authors} ({self.fields['year']}). {self.fields['title']}. {ending}".strip().replace(
            "--", "–"
        )


class Citations(NamedTuple):
    """Papers to cite, each with the methods that it describes. Printing shows them as text.

    Attributes:
        methods: methods by key of a paper.
        papers: papers in alphabetical order of their keys.
    """

    methods: dict[str, list[str]]
    papers: list[Paper]

    @property
    def bibtex(self) -> str:
        """The entries as BibTeX."""
        return "\n".join(paper.bibtex for paper in self.papers) + "\n"

    def __str__(self) -> str:
        return "\n".join(f"[{', '.join(self.methods[paper.key])}] {paper}" for paper in self.papers)


def citations(run: Run | str | Path) -> Citations:
    """Return the papers for the methods of a run: its model, training, uncertainty and filters.

    Args:
        run: a run, its folder, or the name of a shipped model.

    Raises:
        UserError: a missing or damaged run.
    """
    run = run if isinstance(run, Run) else load(run)
    trained = (run.folder / "config.yaml").is_file()
    config = run.config if trained else {}
    known = ["covariance of parameters"] if run.uncertainty is not None else []
    return cited([*methods(run.about["dynamics"], config), *known])


def cited(used: list[str]) -> Citations:
    """Return the papers for some methods; methods of other packages have none."""
    found: dict[str, list[str]] = {}
    for method in dict.fromkeys(used):
        for key in PAPERS.get(method, ()):
            found.setdefault(key, []).append(method)
    return Citations(found, [entries()[key] for key in sorted(found)])


def methods(dynamics: Mapping[str, Any], config: Mapping[str, Any]) -> list[str]:
    """Return the names of the methods of a run, see `PAPERS`.

    Args:
        dynamics: description of the dynamics, as in their weights.
        config: configuration of the training; empty for dynamics trained elsewhere.
    """
    return ["ahnn", *_of_dynamics(dynamics), *_of_training(dynamics, config), *_of_plugins(config)]


def _of_dynamics(dynamics: Mapping[str, Any]) -> Iterator[str]:
    yield dynamics["kind"]
    if dynamics.get("network", {}).get("activation") == "fourier":
        yield "gaussian process"
    if dynamics.get("forces"):
        yield "forces"
    if "integrator" in dynamics:
        yield dynamics["integrator"]["name"]


def _of_training(dynamics: Mapping[str, Any], config: Mapping[str, Any]) -> Iterator[str]:
    loss, optimizer = config.get("loss", {}), config.get("optimizer", {})
    stages = [stage[0] for stage in loss.get("stages", ())]
    if {"weak", "relative"} & {*stages}:
        yield "weak form"
    if any(isinstance(stage, int) or stage == "whole" for stage in stages):
        yield "shooting"
    if loss.get("robust") == "student" or (config.get("data") or {}).get("tails"):
        yield "Student's noise"
    if config.get("window", 1) > 1 and config and not stages and loss.get("derivative", 0.0) < 1:
        separable = dynamics.get("hamiltonian") == "separable"
        leaps = dynamics.get("integrator", {}).get("name") == "leapfrog"
        yield "srnn" if separable and leaps else "recursive loss"
    yield from _classes(optimizer, config.get("scheduler", {}))
    if optimizer.get("acceleration"):
        yield "geodesic acceleration"
    callbacks = {name: one for name, one in config.get("callbacks", {}).items() if one}
    if callbacks.get("mean", {}).get("fraction"):
        yield "mean of steps"
    yield from (name for name in _classes(*callbacks.values()) if name in PAPERS)


def _of_plugins(config: Mapping[str, Any]) -> Iterator[str]:
    for label, plugin in (config.get("plugins") or {}).items():
        if not plugin:
            continue
        options = plugin.get("estimator", {})
        (name,) = _classes(options or plugin)
        yield ("ckf" if label == "ckf" else "ukf") if name == "UKFEvaluation" else name
        smoother, form = plugin.get("smoother"), options.get("form")
        marks = {
            "smoother": smoother,
            "iterated smoother": smoother == "iterated",
            "least squares": plugin.get("least_squares"),
            "iterated update": options.get("iterations", 1) > 1,
            f"{form} ensemble": form,
            "localisation": options.get("localisation"),
            "stages of particles": options.get("stages", 1) > 1 and options.get("proposal") != "ukf",
            "unscented proposal": options.get("proposal") == "ukf",
        }
        yield from (mark for mark, present in marks.items() if present)


def _classes(*options: Mapping[str, Any]) -> list[str]:
    """Return the names of the classes named by options."""
    return [one["_target_"].rpartition(".")[2] for one in options if "_target_" in one]


@cache
def entries() -> dict[str, Paper]:
    """Return the entries of `papers.bib` by key."""
    text = (Path(__file__).parent / "papers.bib").read_text(encoding="utf-8")
    found = {}
    for entry in re.findall(r"^@.*?^}", text, re.MULTILINE | re.DOTALL):
        key = entry[entry.index("{") + 1 : entry.index(",")]
        fields = re.findall(r"(\w+) = \{((?:[^{}]|\{[^{}]*\})*)\}", entry)
        plain = {name: re.sub(r"[{}\\]", "", value) for name, value in fields}
        found[key] = Paper(key, entry, plain)
    return found
