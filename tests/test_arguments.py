"""Arguments are checked against the signature they are meant for, and the message says what came."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import pytest

from ahnn.arguments import Count, Within, check_arguments, check_names, checked, describe, fits, nearest
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
    check_arguments("group", target, good)


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        ({"count": 3.0}, r"group\.count: expected int; received 3\.0 \(float\)"),
        ({"count": True}, r"group\.count: expected int; received True \(bool\)"),
        ({"count": None}, r"group\.count: expected int; received None"),
        ({"share": "high"}, r"group\.share: expected float; received 'high' \(str\)"),
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
        check_arguments("group", target, wrong)


def test_a_class_is_checked_by_its_constructor_inherited_fields_included():
    with pytest.raises(UserError, match=r"system\.dt: expected float; received '1s'"):
        check_arguments("system", MassSpring, {"dt": "1s"})
    with pytest.raises(UserError, match="did you mean 'stiffness'"):
        check_arguments("system", MassSpring, {"stifness": 5.0})


def test_a_function_that_takes_anything_accepts_any_name():
    check_arguments("x", lambda **_: None, {"anything": 1})


def test_objects_that_are_built_already_pass():
    assert fits(MassSpring(name="s", dt=1.0, steps=1), MassSpring)
    assert not fits(3.0, MassSpring)


def test_the_nearest_name_is_offered_or_all_of_them():
    assert nearest("modle", ["model", "data"]) == "; did you mean 'model'?"
    assert nearest("xyz", ["model", "data"]) == "; it takes model, data"


def built(parent, *, size: int, pair: tuple[float, float] = (0.0, 1.0)) -> None: ...


@pytest.mark.parametrize(
    ("names", "options", "expected"),
    [
        (["size"], {}, "group: expected key 'parent'; received size"),
        ([], {"partial": True}, "group: expected key 'size'; received no key"),
        (["size", "parent"], {"partial": True}, "group: unknown key 'parent'"),
        (["size", "parent"], {"given": ["parent"]}, "group: unknown key 'parent'; did you mean 'pair'"),
        (["siz"], {"partial": True}, "group: unknown key 'siz'; did you mean 'size'"),
    ],
)
def test_missing_names_and_those_that_are_not_the_users_are_refused(names, options, expected):
    with pytest.raises(UserError, match=expected):
        check_names("group", built, names, **options)


def test_names_that_are_all_there_pass():
    check_names("group", built, ["size", "pair"], partial=True)
    check_names("group", built, ["size"], ["parent"])
    check_names("group", lambda **_: None, ["anything"])


def test_the_length_of_a_pair_and_the_kind_of_a_value_that_is_none_are_checked():
    for wrong in ({"pair": [1.0]}, {"pair": [1.0, 2.0, 3.0]}, {"pair": 1.0}):
        with pytest.raises(UserError, match="expected a list of 2 float"):
            check_arguments("group", built, wrong)
    assert fits([1, 2], tuple[float, ...])
    assert not fits(None, MassSpring)
    assert fits(None, Any)


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
