"""Page of many runs, such as a reproduction or an ablation."""

from __future__ import annotations

from ahnn_plugins.report.answers import claims_html, claims_table, tally, verdicts
from ahnn_plugins.report.collection import Collection
from ahnn_plugins.report.comparisons import ablation_table, order_table
from ahnn_plugins.report.document import Section
from ahnn_plugins.report.grid import Cell, Grid, Head, Line
from ahnn_plugins.report.layout import grid_html
from ahnn_plugins.report.markup import Content, Markup, escaped, tag
from ahnn_plugins.report.overviews import cost_table, ladder_table, score_table
from ahnn_plugins.report.paper_tables import energy_table, is_of_paper, rmse_table
from ahnn_plugins.report.pictures import Picture, figures_html, of_system
from ahnn_plugins.report.remarks import remarks, unfinished
from ahnn_plugins.report.scores import Board, board
from ahnn_plugins.report.verdicts import Verdict


def tables(collection: Collection, confidence: float) -> dict[str, list[Grid]]:
    """Return the tables of each system, in the order of the page."""
    return {system: _tables(board(collection, system), confidence) for system in collection.systems()}


def with_claims(
    collection: Collection, grids: dict[str, list[Grid]], confidence: float
) -> dict[str, list[Grid]]:
    """Return the tables, with a table of the paper's claims added for each of its systems."""
    found = verdicts(collection, confidence)
    return {
        system: [*tables, *([claims_table(system, own, confidence)] if own else [])]
        for system, tables in grids.items()
        for own in [[verdict for verdict in found if verdict.claim.system == system]]
    }


def _tables(scores: Board, confidence: float) -> list[Grid]:
    paper = [rmse_table(scores), energy_table(scores)] if is_of_paper(scores) else []
    found = [
        *paper,
        order_table(scores, confidence),
        ablation_table(scores, confidence),
        ladder_table(scores),
        cost_table(scores),
        score_table(scores),
    ]
    return [grid for grid in found if grid is not None]


def sections(
    collection: Collection, grids: dict[str, list[Grid]], pictures: list[Picture], confidence: float
) -> list[Section]:
    """Return the sections of the page."""
    found = verdicts(collection, confidence)
    placed = of_system(pictures, collection.systems())
    rest = figures_html(placed.get("", []))
    answers = [Section("claims", "Claims of the paper", *_claims(found, confidence))] if found else []
    return [
        Section("summary", "Summary", _summary(collection, found)),
        *answers,
        *(_system(collection, s, grids[s], placed.get(s, []), i) for i, s in enumerate(grids, 1)),
        *([Section("figures", "Further figures", rest)] if rest else []),
        Section("method", "How to read it", _method(confidence)),
        Section("runs", "Runs", grid_html(runs_table(collection))),
    ]


def _summary(collection: Collection, found: list[Verdict]) -> Markup:
    seeds = sorted({entry.seed for entry in collection.entries if entry.seed is not None})
    facts: dict[str, str] = {"runs": str(len(collection.entries))}
    for system in collection.systems():
        facts[f"models on {system}"] = ", ".join(board(collection, system).groups)
    facts["seeds"] = ", ".join(map(str, seeds)) or "not known"
    notes = [
        (f"{system}: " if len(collection.systems()) > 1 else "") + text
        for system in collection.systems()
        for text in remarks(board(collection, system))
    ]
    claims = [tag("p", "Of the paper's claims that these runs bear on:"), tally(found)] if found else []
    return escaped([definitions(facts), *claims, remarks_html([*unfinished(collection.unfinished), *notes])])


def definitions(facts: dict[str, str]) -> Markup:
    """Return a definition list."""
    return tag("dl", [[tag("dt", name), tag("dd", text)] for name, text in facts.items()])


def remarks_html(texts: list[str]) -> Content:
    """Return remarks as a list, or nothing."""
    return tag("ul", [tag("li", text) for text in texts], class_="remarks") if texts else Markup()


def _claims(found: list[Verdict], confidence: float) -> tuple[Markup, tuple[Section, ...]]:
    systems = dict.fromkeys(verdict.claim.system for verdict in found)
    parts = tuple(
        Section(f"claims-{s}", s, claims_html([v for v in found if v.claim.system == s], confidence))
        for s in systems
    )
    text = (
        "Each claim is a set of demands on ratios of scores, judged only by the runs. Open one for its "
        "numbers, and for whether the paper's own tables meet it."
    )
    return tag("p", text), parts


def _system(
    collection: Collection, system: str, grids: list[Grid], pictures: list[Picture], number: int
) -> Section:
    assumed = dict.fromkeys(
        f"{e.model}: {e.results.assumes}" for e in collection.of(system) if e.results.assumes
    )
    known = tag(
        "details",
        tag("summary", "Prior knowledge of each model"),
        tag("ul", [tag("li", t) for t in assumed]),
    )
    parts = [Section(f"system-{number}-tables", "Tables", escaped([grid_html(grid) for grid in grids]))]
    if pictures:
        parts.append(Section(f"system-{number}-figures", "Figures", figures_html(pictures)))
    return Section(f"system-{number}", system, known, tuple(parts))


def _method(confidence: float) -> Markup:
    texts = (
        "RMSE of positions, and of velocities or momenta: for each unseen trajectory the root mean square "
        "over time of the length of the error vector, then the mean over trajectories. The paper does not "
        "say which it uses; this one fits its numbers best.",
        "Floor: score of the exact equations from the same start with the same measurements. From a "
        "perturbed start without measurements the score reflects the perturbation, and hardly the model.",
        "Spread: standard deviation over runs of one model, which differ in their seeds. It includes the "
        "effect of initial weights and of the order of the data, but not of the choice of test "
        "trajectories, which all runs share.",
        f"Ratios: of geometric means, with the {confidence:.0%} interval of Welch's test on logarithms; "
        "three seeds make it wide. A claim holds if the entire interval of each of its ratios lies where "
        "the claim requires it; it does not hold if one interval, widened for the number of ratios "
        "(Bonferroni), lies outside; all else is undecided.",
        "An order of magnitude: a factor of at least √10; two orders: at least 10 √10; comparable: within a "
        "factor of two.",
    )
    return tag("ul", [tag("li", text) for text in texts])


def runs_table(collection: Collection) -> Grid:
    """Build the table of run folders and their provenance."""
    names = ("model", "system", "seed", "verdict", "date", "version", "commit", "command")
    lines = []
    for entry in collection.entries:
        about = entry.results.about
        said = [str(about.get(key) or "–") for key in ("date", "ahnn", "commit", "command")]
        said[2] = said[2][:12] + ("-dirty" if said[2].endswith("-dirty") else "")
        verdict = next(iter(entry.results.verdict), "–").partition(": ")[0]
        seed = str(entry.results.training.get("seed", "–"))
        cells = [entry.model, entry.system, seed, verdict, *said]
        lines.append(Line(str(entry.folder), tuple(Cell(text, "words") for text in cells)))
    head = ((Head("folder"), *map(Head, names)),)
    return Grid(
        "runs-table", "Provenance.", "Versions, commands and machines behind the results.", head, tuple(lines)
    )
