"""Many objects at once: each as a filter of its own, whatever the others do, in any order."""

from __future__ import annotations

import numpy as np
import torch
from fleet import NAMES, fleet, mixed, starts, table
from following import SENSORS, STEP, Q, coast
from hypothesis import given, settings
from hypothesis import strategies as st

from ahnn.assimilation import Assimilation, CatalogueEstimates
from ahnn.assimilation.cells import BadLine
from ahnn.assimilation.online import Diverged
from ahnn.estimation import Belief, Gate, Status
from ahnn_plugins.ukf import UnscentedKalmanFilter, online_process

COUNTS = (9, 4, 12, 1, 7, 3, 15)


def alone(name, *, gate=None, flow=coast, **options):
    """The filter of one body."""
    process = online_process(UnscentedKalmanFilter(gate=gate), flow, STEP, Q)
    k, whole = NAMES.index(name), starts(len(NAMES))
    return Assimilation(process, SENSORS, Belief(whole.mean[k : k + 1], whole.chol[k : k + 1]), **options)


def near(one, other):
    """Whether numbers agree to rounding, NaN in the same places."""
    return bool(torch.allclose(one, other, rtol=1e-12, atol=1e-12, equal_nan=True))


def require_solo(pairs, found, **options):
    """Compare each row with what the filter of its object alone gives; return those that are lost."""
    own, lost = {name: alone(name, **options) for name in NAMES}, set()
    for k, (name, reading) in enumerate(pairs):
        if name in lost:  # a session of its own has ended
            assert found.outcomes[k] == "lost"
            continue
        before = own[name].window
        try:
            estimate = own[name].update(reading)
        except (BadLine, Diverged) as error:
            said, failed = str(error), isinstance(error, Diverged)
        else:
            said, failed = "", False
        if said:
            lost |= {name} if failed else set()
            assert found.outcomes[k] == ("lost" if failed else "bad")
            assert found.reasons[k] == said
            assert own[name].window is before
            continue
        assert found.outcomes[k] == estimate.outcome, k
        assert found.times[k] == estimate.time
        assert near(found.means[k], estimate.mean)
        assert near(found.covariances[k], estimate.covariance)
        if estimate.innovation is not None:
            assert found.replayed[k] == estimate.replayed
            width = estimate.innovation.residual.shape[-1]
            assert near(found.residuals[k, :width], estimate.innovation.residual[0])
            assert near(found.deviations[k, :width], estimate.innovation.deviation[0])
            assert near(found.nis[k], estimate.innovation.nis[0])
            assert int(found.measured[k]) == int(estimate.innovation.measured[0])
    return lost


def in_parts(catalogue, pairs, sizes):
    """Updates by tables of some sizes, as one."""
    parts, at = [], 0
    for size in (*sizes, len(pairs)):
        parts.append(catalogue.update(table(pairs[at : at + size])))
        at += size
    begun = np.cumsum([0, *sizes]).tolist()
    reasons = {at + k: why for at, part in zip(begun, parts, strict=True) for k, why in part.reasons.items()}
    join = [torch.cat if isinstance(part, torch.Tensor) else np.concatenate for part in parts[0][:-1]]
    columns = [j([part[k] for part in parts]) for k, j in enumerate(join)]
    return CatalogueEstimates(*columns, reasons)


@settings(max_examples=12)
@given(st.integers(0, 9), st.lists(st.integers(1, 20), max_size=3), st.sampled_from([0.0, 1.5, 100.0]))
def test_each_object_is_as_a_filter_of_its_own(seed, sizes, window):
    pairs, draw = mixed(COUNTS, seed), np.random.default_rng(seed)
    pairs = [pairs[k] for k in np.argsort(np.arange(len(pairs)) + draw.uniform(0, 25, len(pairs)))]
    pairs += [pairs[k] for k in draw.integers(0, len(pairs), 4)]  # they come twice
    options = {"window": window, "lines": 5, "gate": Gate(0.999), "gap": 9.0}
    found = in_parts(fleet(**options), pairs, sizes)
    require_solo(pairs, found, **options)
    assert {"taken", "late" if window < 2 else "taken"} <= {*found.outcomes}


@settings(max_examples=10)
@given(st.integers(0, 9), st.sampled_from([0.0, 2.0]), st.integers(1, 8))
def test_outliers_and_absurd_numbers_harm_nobody_but_their_object(seed, window, every):
    pairs, draw = mixed(COUNTS, seed), np.random.default_rng(seed)
    for k in range(0, len(pairs), every):
        name, reading = pairs[k]
        size = draw.choice([5.0, 1e3, 1e9, 1e120, 1e307])
        pairs[k] = name, reading._replace(values=tuple(size * v for v in reading.values))
    options = {"window": window, "gate": Gate(0.999, patience=3)}
    catalogue = fleet(**options)
    lost = require_solo(pairs, in_parts(catalogue, pairs, [20]), **options)
    assert {*catalogue.lost} == lost
    assert {status.name for status in catalogue.lost.values()} <= {"DIVERGED", "NOT_FINITE", "COLLAPSED"}


def test_a_flow_that_breaks_for_one_object_is_reported_and_the_rest_are_unharmed():
    def breaking(x, dt):
        return torch.where(x[:, :1] > 1.25, torch.nan, 1.0) * coast(x, dt)

    pairs = mixed(COUNTS, 3)
    catalogue = fleet(flow=breaking)
    found = in_parts(catalogue, pairs, [10, 10])
    lost = require_solo(pairs, found, flow=breaking)
    assert lost
    assert {*catalogue.lost.values()} == {Status.NOT_FINITE}
    assert all("received NOT_FINITE at time" in why for why in found.reasons.values())
    assert len(found.reasons) == len(lost)  # each is told once
