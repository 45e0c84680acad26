"""Evaluation of a case: open-loop predictions and plugins, merged into findings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, cast

from torch import nn

from ahnn.evaluation.bands import band_figure, banded
from ahnn.evaluation.baselines import Worth, worth
from ahnn.evaluation.case import Case, EvaluationPlugin, Findings, Row
from ahnn.evaluation.conservation import energy_trend, time_test
from ahnn.evaluation.constant_units import constant_unit
from ahnn.evaluation.force_bound import force_bound
from ahnn.evaluation.forecast import HALF, Forecast, forecast
from ahnn.evaluation.friction_test import friction_test
from ahnn.evaluation.goodness_of_fit import explain
from ahnn.evaluation.open_loop import open_loop
from ahnn.evaluation.residual_diagnosis import diagnosis, invisible, sufficient
from ahnn.evaluation.textbook_orbit import remedy, textbook_forecasts, textbook_row
from ahnn.evaluation.titles import described
from ahnn.evaluation.trajectory_figures import open_loop_figures
from ahnn.evaluation.verdict import verdict
from ahnn.measurements import Segment
from ahnn.progress import note as show
from ahnn.progress import stage
from ahnn.rollouts import clock_of, rollout
from ahnn.uncertainty import Uncertainty, learned_constants

UNJUDGED = (
    "the noise is not judged, since the model does not fit all trajectories: train longer, "
    "on more measurements, or choose another model"
)


def evaluate(case: Case, plugins: Mapping[str, EvaluationPlugin], *, figures: bool = True) -> Findings:
    """Return the merged findings of the open loop and of each plugin.

    Numbers of a plugin are stored under its name, arrays and figures under NAME/KEY, so that plugins do not
    overwrite one another. Rows of equal identity are distinguished by the name of the second plugin.

    Args:
        case: case to evaluate.
        plugins: additional evaluations, by name.
        figures: whether to draw and keep figures.
    """
    findings = open_loop(case)
    findings.faults += [row.note for row in findings.rows if row.note]
    findings.tell(case.remark, findings.highlights)
    with stage("evaluation"):
        value = add_tests(case, findings, figures=figures)
    seen = "truth" if case.fitted is None else "measurements"
    findings.arrays |= {seen: case.test.states, "times": case.test.times}
    for name, plugin in plugins.items():
        add_plugin(case, name, plugin, findings, figures=figures)
    noisy = case.fitted is not None
    sentences = verdict(value, findings.faults, findings.highlights, noisy=noisy, caveat=case.caveat)
    if case.caveat in sentences:
        findings.tell(case.caveat)
    findings.numbers["verdict"] = {"findings": sentences}
    findings.numbers["unseen"] = {"trajectories": len(case.test.states)}
    return findings


def add_tests(case: Case, findings: Findings, *, figures: bool) -> Worth:
    """Add the tests of the model without filters, and return the comparison with baselines."""
    show("baselines")
    value = add_worth(case, findings)
    add_textbook(case, findings)
    add_constants(case, findings)
    if case.uncertainty is not None:  # first, since it may explain a poor fit
        findings.tell(case.uncertainty.unfinished, findings.faults)
    if case.measured is not None:
        add_noise(case, case.measured, findings)
        decays = add_friction(case, case.measured, findings)
        add_goodness(case, case.measured, findings, decays=decays)
    if figures:
        findings.figures |= open_loop_figures(case, findings.arrays)
    if (known := case.uncertainty) is not None:
        findings.numbers["uncertainty"] = {"inflation": known.inflation, **known.about}
        if case.fitted is None:  # bands exist for states only, not for measurements
            show("bands of the prediction")
            add_band(case, known, findings, figures=figures)
        if case.measured is not None:
            show("forecasts")
            add_forecast(case, known, case.measured, findings)
    if case.measured is not None and case.fitted is None:
        show("bound of the true force")
        add_force_bound(case, findings)
    return value


def band_tests(case: Case, fitted: float, samples: int) -> dict[str, Any]:
    """Return the entries `uncertainty` and `forecast` of an evaluation, without the other tests.

    Args:
        case: case to evaluate.
        fitted: fraction of the measurements of an unseen trajectory to which its start is fitted.
        samples: number of sampled paths of each forecast; 0: none.
    """
    known, states = case.uncertainty, case.test.states
    if known is None or case.measured is None:
        return {}
    clock = case.test.clock(clock_of(case.flow))
    with stage("evaluation"):
        prediction = rollout(
            case.flow, states[:, 0], case.dt, states.shape[1], longest=case.longest, clock=clock
        )
        band = banded(case, known, prediction)
        ahead = forecast_of(case, known, case.measured, fitted, samples)
    found = {"uncertainty": {"inflation": known.inflation, **known.about, **band.numbers()}}
    return found if ahead is None else {**found, "forecast": ahead.numbers()}


def add_friction(case: Case, measured: Segment, findings: Findings) -> bool:
    """Add the test for friction that a model lacks, and return whether it finds any."""
    beside = friction_test(case.flow, sufficient(measured, case.learned_from))
    if beside is None:
        return False
    findings.tell(beside.sentence(case.space.units.time), findings.faults)
    findings.numbers["friction_test"] = beside._asdict()
    return beside.found


def add_goodness(case: Case, measured: Segment, findings: Findings, *, decays: bool) -> None:
    """Add the goodness of fit to unseen measurements, with remedies if it is poor.

    A training that ended early is the first cause, and its remedy the first fault; what else the residuals
    show may be only its consequence, or that of momenta that decay without friction in the model.
    """
    show("goodness of fit")
    flow = cast(Any, case.flow)
    explained = explain(flow, measured, case.robust)
    if explained.consistent:
        findings.tell(explained.sentence())
    else:
        findings.tell(case.shortfall)
        findings.faults[:0] = filter(None, [case.shortfall])
        findings.tell(explained.sentence(), findings.faults)
        show("tests of the residuals")
        poor = explained.is_partial and case.robust != "none"  # and without one, outliers may be the cause
        if poor:
            said = UNJUDGED
        elif explained.is_coarse:
            said = ""
        else:
            said = diagnosis(flow, measured, case.learned_from, case.robust)
        first = "after a longer training" if case.shortfall else "with this force" if decays else ""
        findings.tell(f"if it remains {first}: {said}" if said and first else said, findings.faults)
    findings.tell(invisible(flow, measured, case.noise), findings.highlights)
    findings.numbers["measurements"] = explained.numbers()


def add_plugin(case: Case, name: str, plugin: EvaluationPlugin, findings: Findings, *, figures: bool) -> None:
    """Add the findings of a plugin; remarks on its filters from perturbed starts count as faults."""
    more = plugin(case)
    findings.rows += distinct(more.rows, findings.rows, name)
    findings.numbers[name] = more.numbers
    for who, _, note, _ in more.rows:
        if note and who.estimator and (who.start, who.span, who.floor) == ("perturbed", "whole", False):
            findings.faults.append(f"{described(who, case.label)}: {note}")
    for note in more.notes:
        findings.tell(note, findings.highlights)
    findings.arrays |= {f"{name}/{key}": value for key, value in more.arrays.items()}
    findings.figures |= {f"{name}/{key}": drawn for key, drawn in more.figures.items() if figures}


def add_worth(case: Case, findings: Findings) -> Worth:
    """Add the comparison of the prediction with baselines, and the conservation tests."""
    arrays = findings.arrays
    found = worth(case, arrays[f"{case.start}_start"], arrays.get(f"floor_{case.start}_start"))
    findings.tell(found.sentence())
    findings.numbers["worth"] = found.numbers()
    if case.measured is not None:
        return found
    if (trend := energy_trend(case)) is not None:
        said = trend.sentence(case.space.units.time)
        doubtful = "if it remains with a better model: " if said and found.worthless else ""
        findings.tell(doubtful + said, findings.faults)
        findings.numbers["energy_trend"] = trend._asdict()
    if (timed := time_test(case)) is not None:
        findings.tell(timed.sentence(), findings.faults)
        findings.numbers["time_test"] = timed._asdict()
    return found


def add_textbook(case: Case, findings: Findings) -> None:
    """Add the errors of textbook physics for recorded orbits about the Earth."""
    show("textbook physics")
    if (there := textbook_row(case)) is not None:
        row, findings.arrays["textbook_true_start"] = there
        findings.rows.append(row)
        model = findings.rows[0].scores.position
        findings.tell(remedy(case, model, row.scores.position), findings.faults)
    if (beside := textbook_forecasts(case)) is not None:
        findings.tell(beside.sentence())
        findings.tell(remedy(case, beside.model, beside.textbook), findings.faults)
        findings.numbers["textbook_forecasts"] = beside._asdict()


def add_constants(case: Case, findings: Findings) -> None:
    """Add learned physical constants, with standard deviations if available, and units where known."""
    spread = None if case.uncertainty is None else case.uncertainty.spread
    flow: Any = case.flow
    if isinstance(flow, nn.Module) and (found := learned_constants(cast(Any, flow), spread)):
        units = {one.name: constant_unit(one.name, case.space) for one in found}
        values = (" ".join(filter(None, (str(one), units[one.name]))) for one in found)
        findings.tell(f"learned: {', '.join(values)}", findings.highlights)
        findings.numbers["constants"] = {one.name: one.numbers() for one in found}
        if known := {name: unit for name, unit in units.items() if unit}:
            findings.numbers["constant_units"] = known


def add_noise(case: Case, measured: Segment, findings: Findings) -> None:
    """Add the noise of the measurements that the training estimated."""
    if case.noise is not None:
        seen = measured.instrument.measurement
        for sentence in case.noise.sentences(seen.names, seen.units):
            findings.tell(sentence, findings.highlights)
        findings.numbers["noise"] = case.noise.about()


def add_band(case: Case, uncertainty: Uncertainty, findings: Findings, *, figures: bool) -> None:
    """Add the band of the prediction from the true start to the findings of the open loop."""
    prediction = findings.arrays["true_start"]
    band = banded(case, uncertainty, prediction)
    findings.tell(band.sentence(case.space))
    findings.numbers["uncertainty"] |= band.numbers()
    findings.arrays["true_start_deviations"] = band.deviations
    if figures:
        findings.figures["band"] = band_figure(case, prediction, band.deviations)
    findings.highlights += filter(None, [band.verdict()])


def add_forecast(case: Case, uncertainty: Uncertainty, measured: Segment, findings: Findings) -> None:
    """Add the coverage of forecasts from the first half of unseen measurements."""
    found = forecast_of(case, uncertainty, measured, HALF)
    if found is not None:
        findings.tell(found.sentence())
        findings.numbers["forecast"] = found.numbers()
        findings.highlights.append(found.verdict())


def forecast_of(
    case: Case, uncertainty: Uncertainty, measured: Segment, fitted: float, samples: int = 0
) -> Forecast | None:
    """Return the coverage of forecasts from the first part of unseen measurements, if any can be fitted."""
    truth = case.test if case.fitted is None and len(case.test.states) == len(measured.values) else None
    return forecast(cast(Any, case.flow), measured, uncertainty.spread, case.robust, truth, fitted, samples)


def add_force_bound(case: Case, findings: Findings) -> None:
    """Add the bound of the true force to the row of the prediction from the true start, if available."""
    bound = force_bound(case, findings.arrays["true_start"])
    if bound is not None:
        findings.tell(bound.sentence(case.space))
        row = findings.rows[0]
        findings.rows[0] = row._replace(extra={**row.extra, "force_bound": bound.numbers()})


def distinct(rows: Iterable[Row], taken: Iterable[Row], name: str) -> list[Row]:
    """Return the rows of a plugin, with identities made unique."""
    known = {row.who for row in taken}
    return [
        row
        if row.who not in known
        else row._replace(who=row.who._replace(estimator=f"{row.who.estimator or 'none'}_{name}"))
        for row in rows
    ]
