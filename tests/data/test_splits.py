"""How test trajectories relate to a training, and where each split lies."""

from __future__ import annotations

import pytest
import torch
from helpers import SPRING

from ahnn.data.fingerprints import NONE, fingerprints, remembered
from ahnn.data.sensor import Sensor
from ahnn.data.splits import SplitData, check_fractions, split_sizes
from ahnn.errors import UserError
from ahnn.types import Trajectories

THEN = [0.6, 0.2, 0.2]


class Twenty:
    """Trajectories whose states are their number, at times of their own."""

    space, truth = SPRING.space, None

    def __init__(self, times=None, **recipe):
        self.asked = recipe or {"seed": 0}
        self.times = torch.arange(5.0).double().expand(20, -1) if times is None else times

    def recipe(self):
        return self.asked

    def read(self):
        return Trajectories(torch.arange(20.0).double().view(20, 1, 1).expand(20, 5, 2).clone(), self.times)


def known(**recipe):
    return {"recipe": recipe or {"seed": 0}, "split": THEN}


def test_splits_follow_each_other():
    data = SplitData(Twenty(), THEN)
    found = {split: data[split].states[:, 0, 0].tolist() for split in ("train", "val", "test")}
    assert found == {
        "train": [*range(12)],
        "val": [*range(12, 16)],
        "test": [*range(16, 20)],
    }


@pytest.mark.parametrize(
    ("now", "said"),
    [
        (THEN, "the test split of the run's data"),
        ([0.5, 0.3, 0.2], "a part of the test split of the run's data"),
        ([0.7, 0.2, 0.1], "a part of the test split of the run's data"),
        ([0.1, 0.8, 0.1], "a part of the test split of the run's data"),
    ],
)
def test_a_later_beginning_of_the_test_split_is_no_leak(now, said):
    assert SplitData(Twenty(), now).beside(known()) == said


@pytest.mark.parametrize(("now", "seen", "of"), [([0.6, 0.1, 0.3], 2, 6), ([0.2, 0.2, 0.6], 8, 12)])
def test_an_earlier_beginning_of_the_test_split_is_refused(now, seen, of):
    with pytest.raises(UserError, match=f"{seen} of {of} were used"):
        SplitData(Twenty(), now).beside(known())


def test_other_data_are_other_trajectories_unless_they_are_the_same_files():
    assert SplitData(Twenty(), THEN).beside(None) == "unknown training data"
    others = "trajectories other than the training data"
    assert SplitData(Twenty(seed=1), THEN).beside(known()) == others
    edited = SplitData(Twenty(code={"mine": "2", "base": "1"}), THEN).beside(
        known(code={"mine": "1", "base": "1"})
    )
    assert edited == "the test split of the run's data; the code of its system (mine) has changed since then"
    changed = "files other than the training data"
    assert SplitData(Twenty(files="a"), THEN).beside(known(files="b")) == changed
    assert SplitData(Twenty(files="a"), THEN).beside(known()) == others
    with pytest.raises(UserError, match="expected the training files with their settings"):
        SplitData(Twenty(files="a", cut=3), THEN).beside(known(files="a"))


class Walks(Twenty):
    """Twenty random walks of 50 samples, in an order, from a sample on."""

    def __init__(self, order=range(20), first=0, **recipe):
        super().__init__(torch.arange(50.0 - first).double().expand(20, -1), **(recipe or {"files": "b"}))
        steps = torch.randn(20, 50, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
        self.states = steps.cumsum(1)[[*order], first:]

    def read(self):
        return Trajectories(self.states, self.times)


SWAPPED = [16, *range(1, 16), 0, *range(17, 20)]


@pytest.mark.parametrize("walks", [Walks(SWAPPED), Walks(SWAPPED, 9), Walks(SWAPPED, seed=3)])
def test_a_trajectory_of_the_training_is_no_test_of_changed_data(walks):
    seen = SplitData(Walks(files="a"), THEN).seen()
    with pytest.raises(UserError, match=r"received 4, 1 of them with samples of the training or validation"):
        SplitData(walks, THEN).beside(known(files="a"), seen)


def test_changed_data_of_which_nothing_was_seen_are_reported_with_that():
    seen = SplitData(Walks(files="a"), THEN).seen()
    assert len(seen) == 16
    other = Walks([*range(16), 19, 18, 17, 16])
    said = "files other than the training data; none was used in training"
    assert SplitData(other, THEN).beside(known(files="a"), seen) == said
    other.states[16:] = 0.0  # a state of rest, which the training does not know
    assert SplitData(other, THEN).beside(known(files="a"), seen) == said


def test_absent_samples_are_in_no_fingerprint():
    states = torch.full((2, 9, 2), torch.nan, dtype=torch.float64)
    states[0, :4] = 1.0
    found = fingerprints(states)
    assert (found != NONE).nonzero().tolist() == [[0, 0]]
    assert remembered(Trajectories(states, torch.zeros(2, 9))) == found[0, :1].tolist()


def test_fractions_sum_to_one_up_to_rounding():
    check_fractions([0.7, 0.2, 0.1])
    check_fractions([1 / 3, 1 / 3, 1 / 3 + 1e-10])
    for fractions in ([0.7, 0.2, 0.1 + 1e-6], [0.7, 0.2, 0.1 - 1e-6], [0.5, 0.3, 0.1, 0.1]):
        with pytest.raises(UserError, match="sum to 1"):
            check_fractions(fractions)


def test_one_trajectory_in_each_split_is_enough():
    assert split_sizes(3, [0.34, 0.33, 0.33]) == [1, 1, 1]
    assert split_sizes(10, [0.8, 0.15, 0.05]) == [7, 2, 1]
    assert split_sizes(3, [0.98, 0.01, 0.01]) == [1, 1, 1]
    assert split_sizes(4, [0.1, 0.45, 0.45]) == [1, 1, 2]
    for count, received in ((1, "1 trajectory"), (2, "2 trajectories")):
        with pytest.raises(UserError, match=f"each of train, val, test; received {received}. Use more"):
            split_sizes(count, [0.3, 0.2, 0.5])


def test_an_instrument_knows_the_typical_step():
    times = torch.tensor([0.0, 0.1, 0.3, 0.6, 0.7], dtype=torch.float64).expand(20, -1)
    for given, step in ((None, 1.0), (times, 0.1)):
        source = Twenty(given)
        data = SplitData(source, THEN, Sensor(source.space, measured="position", noise=0.1, stride=2))
        assert data.instrument().longest == pytest.approx(2 * step, rel=1e-12)


def test_each_split_is_measured_once_with_draws_of_its_own():
    source = Twenty()
    data = SplitData(source, THEN, Sensor(source.space, measured="position", noise=0.1))
    noise = {split: data.measured(split).values - data[split].states[..., :1] for split in ("val", "test")}
    assert data.measured("val") is data.measured("val")
    assert float((noise["val"] - noise["test"]).abs().min()) > 0
