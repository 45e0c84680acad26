"""What is said of a filter whose members were lost or measured in part, by hand-made results."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from cases import KEPLER, make_case
from scipy.stats import chi2

from ahnn.estimation import Belief, Problem, Setting, Status
from ahnn.estimation.consistency import independent_count
from ahnn.estimation.results import FilterResult
from ahnn.estimation.state import initial_state
from ahnn.evaluation import Who
from ahnn.evaluation.estimators.outcome import Outcome, filtered, numbers, rows
from ahnn.measurements import Position
from ahnn.metrics import Scores

F64 = torch.float64
MEMBERS, STEPS, SIZE, WIDTH = 3, 80, 4, 2
WHO = Who("model", "perturbed", "ukf")


def limits(degrees: float, count: float) -> list[float]:
    """Where the mean of chi-square variables lies with 95 %."""
    return [float(chi2.ppf(p, count * degrees)) / count for p in (0.025, 0.975)]


class Made:
    """A case, and the outcome of a filter on it whose numbers are drawn: NEES and NIS follow their laws.

    Args:
        folder: of the case.
        lost: members whose status is not OK, NaN from the middle on.
        spread: of the errors, in standard deviations that the filter believes in.
    """

    def __init__(self, folder: Path, lost: int = 0, spread: float = 1.0) -> None:
        self.case = make_case(folder, KEPLER, None)
        truth = self.case.test.states
        rng = torch.Generator().manual_seed(5)
        self.sd = torch.tensor([0.1, 0.2, 0.05, 0.3], dtype=F64)
        shape = (MEMBERS, STEPS, SIZE)
        means = truth[:, 1:] + spread * self.sd * torch.randn(shape, generator=rng, dtype=F64)
        due = torch.arange(1, STEPS + 1) % 8 == 0
        innovations = torch.randn(MEMBERS, STEPS, WIDTH, generator=rng, dtype=F64)
        innovations[:, ~due] = torch.nan
        innovations[:, 15, 1] = torch.nan
        measured = innovations.isfinite().sum(-1)
        nis = innovations.nan_to_num().square().sum(-1).masked_fill(measured == 0, torch.nan)
        rejected = torch.zeros(MEMBERS, STEPS, dtype=torch.bool)
        rejected[0, 23] = True
        nis[0, 23] = 1e6
        status = torch.zeros(MEMBERS, dtype=torch.int64)
        failed = torch.full_like(status, -1)
        for b in range(lost):
            status[b], failed[b] = Status.COLLAPSED, 40 + b
            means[b, 40 + b :], nis[b, 40 + b :] = torch.nan, torch.nan
        initial = Belief(truth[:, 0] + 0.1, torch.diag(self.sd).expand(MEMBERS, SIZE, SIZE))
        chols = torch.diag(self.sd).expand(MEMBERS, STEPS, SIZE, SIZE)
        self.result = FilterResult(
            initial=initial,
            means=means,
            chols=chols,
            predicted_means=means,
            predicted_chols=chols,
            innovations=innovations,
            nis=nis,
            measured=measured,
            rejected=rejected,
            log_likelihood=torch.tensor([1.0, 2.0, 6.0], dtype=F64),
            status=status,
            failed_step=failed,
            repairs=torch.tensor([0, 2, 3]),
            backward=None,
            state=initial_state(initial),
        )
        setting = Setting(Position(WIDTH, "m"), torch.ones(WIDTH, dtype=F64), self.sd, (4, 8))
        problem = Problem(truth, initial.mean, torch.zeros(MEMBERS, STEPS, WIDTH, dtype=F64), KEPLER.dt)
        self.outcome: Outcome = filtered(WHO, setting, problem, self.result)
        self.setting, self.problem = setting, problem
        self.error = torch.cat((initial.mean[:, None], means), 1) - truth


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_bands_count_the_members_that_are_left(tmp_path, lost):
    made = Made(tmp_path, lost)
    told = numbers(made.outcome, made.case)
    left = MEMBERS - lost
    nees = (made.error / made.sd).square().sum(-1)
    settled = nees[:, 8:]
    assert made.outcome.first == 8
    assert told["nees"]["mean"] == pytest.approx(float(settled[settled.isfinite()].mean()), rel=1e-12)
    assert told["nees"]["one_time_band_95"] == pytest.approx(limits(SIZE, left), rel=1e-12)
    assert told["nees"]["band_95"] == pytest.approx(limits(SIZE, independent_count(settled)), rel=1e-12)
    at_times = made.result.nis.masked_fill(made.result.rejected, torch.nan)[:, 7::8]
    means = at_times.nanmean(0)
    bands = [limits(WIDTH, int(n)) for n in at_times.isfinite().sum(0)]
    held = [low <= mean <= high for mean, (low, high) in zip(means.tolist(), bands, strict=True)]
    assert told["nis"]["in_band"] == pytest.approx(sum(held) / len(held))
    low, high = limits(SIZE, left)
    series = settled.nanmean(0)
    expected = float(((series >= low) & (series <= high)).double().mean())
    assert told["nees"]["in_band"] == pytest.approx(expected)
    assert 0 < expected < 1
    assert told["status"]["OK"] == left
    assert told["status"]["COLLAPSED"] == lost == made.outcome.lost
    assert told["failed_steps"] == [40, 41][:lost]


@pytest.mark.parametrize("lost", [0, 2])
def test_each_phase_is_judged_by_the_values_in_it(tmp_path, lost):
    made = Made(tmp_path, lost)
    told = numbers(made.outcome, made.case)["nees_of_phases"]
    force = made.case.truth.force(made.case.test.states[..., :2]).norm(dim=-1)
    third = force > force.quantile(2 / 3)
    nees = (made.error / made.sd).square().sum(-1)
    strong = nees.masked_fill(~third, torch.nan)[:, 8:]
    assert set(told) == {"weak force", "medium force", "strong force"}
    assert told["strong force"]["mean"] == pytest.approx(float(strong[strong.isfinite()].mean()), rel=1e-12)
    assert told["strong force"]["band_95"] == pytest.approx(
        limits(SIZE, independent_count(strong)), rel=1e-12
    )


def test_a_remark_names_the_phases_in_which_a_filter_is_overconfident(tmp_path):
    made = Made(tmp_path)
    strong = made.case.truth.phases(made.case.test.states)["strong force"]
    spoiled = made.outcome._replace(nees=torch.where(strong, 9.0, 4.0 + 0.1 * made.outcome.nees))
    (_, settled) = rows(spoiled, made.case, None)
    assert "NEES strong force 9 not in" in settled.note
    assert "NEES weak force" not in settled.note


@pytest.mark.parametrize("lost", [0, 2])
def test_the_band_of_the_nis_has_a_degree_of_freedom_for_each_accepted_number(tmp_path, lost):
    made = Made(tmp_path, lost)
    told = numbers(made.outcome, made.case)["nis"]
    values, degrees = [], 0
    for b in range(MEMBERS):
        for k in range(7, STEPS, 8):
            value = float(made.result.nis[b, k])
            if value == value and not bool(made.result.rejected[b, k]):
                values.append(value)
                degrees += int(made.result.measured[b, k])
    assert degrees < 2 * len(values)
    assert told["mean"] == pytest.approx(sum(values) / len(values), rel=1e-12)
    low, high = (float(chi2.ppf(p, degrees)) / len(values) for p in (0.025, 0.975))
    assert told["band_95"] == pytest.approx([low, high], rel=1e-9)
    assert numbers(made.outcome, made.case)["rejected_measurements"] == 1


def test_coverage_and_sums_are_over_what_comes_after_the_first_update(tmp_path):
    made = Made(tmp_path, 1)
    told = numbers(made.outcome, made.case)
    ratio = (made.error / made.sd).abs()[:, 8:]
    ratio = ratio[ratio.isfinite()]
    for k in (1, 2, 3):
        fraction = told["coverage"][f"{k}_sigma"]["fraction"]
        assert fraction == pytest.approx(float((ratio <= k).double().mean()), rel=1e-12)
    assert told["repairs"] == 5
    assert told["log_likelihood"] == pytest.approx(3.0)
    assert told["whole_arc"]["position"] == float("inf")
    whole = numbers(Made(tmp_path).outcome, made.case)
    assert whole["from_first_update"] != whole["whole_arc"]


def verdict(made: Made) -> str:
    return rows(made.outcome, made.case, None)[1].note


def test_the_settled_row_says_how_the_means_lie_to_their_bands(tmp_path):
    assert verdict(Made(tmp_path)).count(" in ") == 2
    assert "not in" not in verdict(Made(tmp_path))
    for spread in (0.5, 2.0):
        note = verdict(Made(tmp_path, spread=spread))
        assert note.startswith("NEES ")
        assert " not in " in note.split(", NIS")[0]
        assert " not in " not in note.split(", NIS")[1].split(", NEES")[0]
    assert verdict(Made(tmp_path, lost=3)) == ""
    assert "NEES" in verdict(Made(tmp_path, lost=2))


def remark(made: Made, position: float, velocity: float, **who: str) -> str:
    """The remark on the whole arc beside scores without a filter."""
    without = Scores(position, velocity, position, velocity, None, ())
    return rows(made.outcome._replace(who=WHO._replace(**who)), made.case, without)[0].note


def test_why_a_filter_is_worse_than_none(tmp_path):
    fine, lost = Made(tmp_path), Made(tmp_path, lost=2)
    assert remark(fine, 1e9, 1e9) == ""
    assert remark(fine, 0.0, 0.0) == "worse than no filter: measurement noise"
    assert remark(fine, 0.0, 1e9) == "worse than no filter in position: measurement noise"
    assert remark(fine, 1e9, 0.0) == "worse than no filter in velocity: measurement noise"
    assert remark(fine, 0.0, 0.0, start="true").endswith("the start is exact, measurements are not")
    assert remark(Made(tmp_path, spread=2.0), 0.0, 0.0).endswith(": overconfident")
    assert remark(Made(tmp_path, spread=2.0), 0.0, 0.0, start="true").endswith(": overconfident")
    assert remark(Made(tmp_path, spread=0.5), 0.0, 0.0).endswith(": cautious")
    assert remark(lost, 0.0, 0.0) == "2 of 3 lost (collapsed); worse than no filter: lost members"
    same = fine.case.score(fine.outcome.estimate)
    assert remark(fine, same.position, same.velocity) == ""


def test_noise_is_blamed_only_if_the_filter_of_the_exact_flow_is_worse_too(tmp_path):
    made = Made(tmp_path)

    def reason(position: float, velocity: float) -> str:
        floor = Scores(position, velocity, position, velocity, None, ())
        without = Scores(0.0, 0.0, 0.0, 0.0, None, ())
        return rows(made.outcome._replace(who=WHO), made.case, without, floor)[0].note

    assert reason(1.0, 1.0) == "worse than no filter: measurement noise"
    assert reason(0.0, 1.0) == "worse than no filter: measurement noise"
    assert reason(0.0, 0.0) == "worse than no filter: the model or its process noise"


def test_members_without_any_measurement_are_counted(tmp_path):
    made = Made(tmp_path)
    measured = made.result.measured.clone()
    measured[1] = 0
    some = filtered(WHO, made.setting, made.problem, made.result._replace(measured=measured))
    assert rows(some, made.case, None)[0].note == "1 of 3 without any measurement"
    one = torch.zeros_like(measured)
    one[2, 30] = 1
    late = filtered(WHO, made.setting, made.problem, made.result._replace(measured=one))
    assert late.first == 31
    single = late._replace(result=made.result._replace(measured=made.result.measured.clamp(max=1)))
    assert rows(single, made.case, None)[1].note.startswith("NEES ")  # one number a time is a measurement
    nothing = made.result._replace(measured=torch.zeros_like(measured), nis=made.result.nis * torch.nan)
    none = filtered(WHO, made.setting, made.problem, nothing)
    assert none.first == 4
    assert rows(none, made.case, None)[1].note == "nothing was measured"
