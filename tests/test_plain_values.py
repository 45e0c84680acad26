"""Plain values: numbers of JSON are numbers, and texts stay texts."""

from __future__ import annotations

import json

import pytest
import yaml

from ahnn.contents import plain_yaml


@pytest.mark.parametrize(
    "text", ["1e5", "-1E-5", "2.5e+3", "[1e5, 0, -3.25]", '{"mean": [1e-12, 7000]}', '"1e5"', '"a"']
)
def test_json_says_the_same_as_its_own_reader(text):
    assert plain_yaml(text) == json.loads(text)


@pytest.mark.parametrize("text", ["e5", "1e", "a1e5", "1e5 km", "1.0.0e5"])
def test_what_is_no_number_is_a_text(text):
    assert plain_yaml(text) == text


def test_a_date_that_does_not_exist_is_invalid_yaml():
    with pytest.raises(yaml.YAMLError, match=r"an invalid value: month must be in 1\.\.12"):
        plain_yaml("epoch: 2024-13-11T00:00:00")
