"""Arguments are checked against the signature they are meant for, and the message says what came."""

from __future__ import annotations

from math import inf, nan
from typing import Annotated, Any, Literal

import pytest

from ahnn.arguments import Count, Interval, Within, check_arguments, checked, describe, fits, nearest
from ahnn.errors import UserError
from ahnn.systems import MassSpring


def target(
    *,
    count: int,
    share: float = 0.5,
    name: str = "a",
    flag: bool = False,
    kind: Literal["one", "two"] = "one",
    split: list[float] | None = None,
    options: dict[str, Any] | None = None,
    thing: MassSpring | None = None,
) -> None: ...


@pytest.mark.parametrize(
    "good",
    [
        {"count": 3},
        {"share": 1},
        {"share": 1e-3},
        {"kind": "two"},
        {"split": [1, 0.5]},
        {"split": None},
        {"options": {"a": 1}},
        {"flag": True},
    ],
)
def test_fitting_values_pass(good):
    check_arguments("group", target, {"count": 1} | good)


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        ({"count": 3.0}, r"group\.count: expected int; received 3\.0 \(float\)"),
        ({"count": True}, r"group\.count: expected int; received True \(bool\)"),
        ({"count": None}, r"group\.count: expected int; received None"),
        ({"share": "high"}, r"group\.share: expected float; received 'high' \(str\)"),
        ({"share": 10**20}, r"group\.share: expected float; received 100000000000000000000 \(int\)"),
        ({"name": 3}, r"group\.name: expected str; received 3"),
        ({"flag": 1}, r"group\.flag: expected bool; received 1"),
        ({"kind": "three"}, r"group\.kind: expected one of one, two; received 'three'"),
        ({"split": [0.5, "b"]}, r"group\.split: expected a list of float or None; received \[0\.5, 'b'\]"),
        ({"options": [1]}, r"group\.options: expected .* or None; received \[1\]"),
        ({"thing": "spring"}, r"group\.thing: expected MassSpring or None; received 'spring'"),
        ({"coun": 3}, r"group: unknown key 'coun'; did you mean 'count'\?"),
        ({"zzz": 3}, r"group: unknown key 'zzz'; it takes count, share"),
    ],
)
def test_other_values_are_refused_with_who_expected_and_received(wrong, expected):
    with pytest.raises(UserError, match=expected):
        check_arguments("group", target, {"count": 1} | wrong)


def test_a_class_is_checked_by_its_constructor_inherited_fields_included():
    with pytest.raises(UserError, match=r"system\.dt: expected float > 0; received '1s'"):
        check_arguments("system", MassSpring, {"name": "s", "steps": 3, "dt": "1s"})
    with pytest.raises(UserError, match="did you mean 'stiffness'"):
        check_arguments("system", MassSpring, {"stifness": 5.0})


def test_a_function_that_takes_anything_accepts_any_name():
    check_arguments("x", lambda **_: None, {"anything": 1})


def test_objects_that_are_built_already_pass():
    assert fits(MassSpring(name="s", dt=1.0, steps=1), MassSpring)
    assert not fits(3.0, MassSpring)


def test_a_close_name_is_offered_or_all_of_them():
    assert nearest("modle", ["model", "data"]) == "; did you mean 'model'?"
    assert nearest("strat", ["start", "state"]) == "; did you mean 'start'?"  # the letters of both agree
    assert nearest("plot", ["ckpt", "data"]) == "; it takes ckpt, data"
    assert nearest("plot", ["ckpt", "data"], "; see --help") == "; see --help"
    assert nearest("plot", ["ckpt", "data"], "") == ""


def built(parent, *, size: int, pair: tuple[float, float] = (0.0, 1.0)) -> None: ...


@pytest.mark.parametrize(
    ("arguments", "options", "expected"),
    [
        ({"size": 1}, {}, "group: expected key 'parent'; received size"),
        ({}, {"partial": True}, "group: expected key 'size'; received no key"),
        ({"size": 1, "parent": 2}, {"partial": True}, "group: unknown key 'parent'"),
        ({"size": 1, "parent": 2}, {"given": ["parent"]}, "group: unknown key 'parent'; did you mean 'pair'"),
        ({"siz": 1}, {"partial": True}, "group: unknown key 'siz'; did you mean 'size'"),
    ],
)
def test_missing_names_and_those_that_are_not_the_users_are_refused(arguments, options, expected):
    with pytest.raises(UserError, match=expected):
        check_arguments("group", built, arguments, **options)


def test_names_that_are_all_there_pass():
    check_arguments("group", built, {"size": 1, "pair": [0.0, 1.0]}, partial=True)
    check_arguments("group", built, {"size": 1}, ["parent"])
    check_arguments("group", lambda **_: None, {"anything": 1})


def test_a_node_that_will_be_built_passes_any_type():
    check_arguments("group", built, {"size": {"_target_": "x"}}, partial=True)


def test_the_length_of_a_pair_and_the_kind_of_a_value_that_is_none_are_checked():
    for wrong in ({"pair": [1.0]}, {"pair": [1.0, 2.0, 3.0]}, {"pair": 1.0}):
        with pytest.raises(UserError, match="expected a list of 2 float"):
            check_arguments("group", built, {"size": 1} | wrong, partial=True)
    assert fits([1, 2], tuple[float, ...])
    assert not fits(None, MassSpring)
    assert fits(None, Any)


def test_limits_say_themselves_what_they_admit():
    for limit, words, inside, outside in (
        (Within(0, 1), "from 0 to 1", (0, 1), (-0.1, 1.1, nan)),
        (Within(above=0), "> 0", (1e-9,), (0, inf)),
        (Within(0, below=1), ">= 0 and < 1", (0,), (1,)),
        (Within(1), ">= 1", (1, 10**400), (0, nan)),
        (Within(2, multiple=2), ">= 2 and a multiple of 2", (2, 12), (0, 3)),
        (Within(), "(finite)", (-1e300,), (inf, nan)),
        (
            Interval(),
            "a range [low, high] of numbers (finite), with low <= high",
            ((0, 0), [-1, 2]),
            ((1, 0), (0,)),
        ),
    ):
        assert str(limit) == words
        assert all(value in limit for value in inside)
        assert not any(value in limit for value in outside)


@checked
def halved(size: Count) -> float:
    return size / 2


def test_functions_are_checked_too():
    assert halved(3) == 1.5
    with pytest.raises(UserError, match=r"^size: expected int >= 1; received 0$"):
        halved(size=0)


@checked
class Sampler:
    """Something with limits at its parameters."""

    def __init__(
        self, batch_size: Count, share: Annotated[float, Within(0, 1)] = 0.5, limit: Count | None = None
    ):
        self.batch_size, self.share, self.limit = batch_size, share, limit


def test_limits_are_written_at_the_parameter_and_hold_in_python_and_yaml():
    assert Sampler(3, limit=None).batch_size == 3
    for call, message in {
        lambda: Sampler(0): r"^batch_size: expected int >= 1; received 0$",
        lambda: Sampler("3"): r"^batch_size: expected int >= 1; received '3' \(str\)$",
        lambda: Sampler(1, 2.0): r"^share: expected float from 0 to 1; received 2\.0$",
        lambda: Sampler(1, float("nan")): r"^share: expected float from 0 to 1; received nan$",
        lambda: Sampler(1, limit=0): r"^limit: expected int >= 1 or None; received 0$",
    }.items():
        with pytest.raises(UserError, match=message):
            call()
    with pytest.raises(UserError, match=r"^data\.batch_size: expected int >= 1; received 0$"):
        check_arguments("data", Sampler, {"batch_size": 0})
    assert describe(Count | None) == "int >= 1 or None"
