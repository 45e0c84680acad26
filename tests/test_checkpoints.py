"""Checkpoints are read without executing anything, and compared key by key."""

from __future__ import annotations

import pickle

import pytest
import torch

from ahnn.arguments import flatten
from ahnn.checkpoints import read_checkpoint, require_same
from ahnn.errors import UserError


class Malicious:
    """Creates a file when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (str(self.path), "w")


def good(path):
    torch.save({"state_dict": {"w": torch.ones(3)}, "ahnn": {"system": {"name": "s"}}}, path)
    return path


def test_a_good_checkpoint_is_read(tmp_path):
    content = read_checkpoint(good(tmp_path / "a.ckpt"))
    assert torch.equal(content["state_dict"]["w"], torch.ones(3))


def test_a_missing_checkpoint_is_named(tmp_path):
    with pytest.raises(
        UserError, match=r"none\.ckpt: expected best, last or a file; received none.*ckpt=last"
    ):
        read_checkpoint(tmp_path / "none.ckpt")
    with pytest.raises(UserError, match="received none"):
        read_checkpoint(tmp_path)


@pytest.mark.parametrize("damage", ["empty", "truncated", "text", "flipped"])
def test_a_damaged_checkpoint_is_one_message(tmp_path, damage):
    path = good(tmp_path / "a.ckpt")
    content = bytearray(path.read_bytes())
    if damage == "flipped":
        content[len(content) // 3] ^= 0xFF
        content[-40:] = bytes(40)
    path.write_bytes(
        {"empty": b"", "truncated": content[: len(content) // 2], "text": b"hello"}.get(damage, content)
    )
    with pytest.raises(UserError, match=r"a\.ckpt: expected an intact ahnn checkpoint; received a damaged"):
        read_checkpoint(path)


def test_a_flipped_bit_in_the_weights_is_found_and_its_record_named(tmp_path):
    path = good(tmp_path / "a.ckpt")
    content = path.read_bytes()
    ones = torch.ones(3).numpy().tobytes()
    assert content.count(ones) == 1
    path.write_bytes(content.replace(ones, ones[:-1] + bytes([ones[-1] ^ 1])))
    assert not torch.equal(torch.load(path, weights_only=True)["state_dict"]["w"], torch.ones(3))
    with pytest.raises(UserError, match=r"a\.ckpt: expected an intact .*record a/data/0 does not match"):
        read_checkpoint(path)


@pytest.mark.parametrize("container", ["zip", "pickle"])
def test_a_malicious_pickle_is_refused_and_not_run(tmp_path, container):
    path, sentinel = tmp_path / "evil.ckpt", tmp_path / "sentinel"
    content = {"state_dict": {}, "ahnn": Malicious(sentinel)}
    if container == "zip":
        torch.save(content, path)
    else:
        path.write_bytes(pickle.dumps(content))
    with pytest.raises(UserError, match=r"evil\.ckpt: expected") as refused:
        read_checkpoint(path)
    assert "weights_only" not in str(refused.value)
    assert not sentinel.exists()


@pytest.mark.parametrize("content", [torch.ones(2), {"state_dict": {}}, {"ahnn": {}}])
def test_a_file_of_someone_else_is_refused(tmp_path, content):
    torch.save(content, tmp_path / "other.ckpt")
    with pytest.raises(UserError, match="written by ahnn; received something else"):
        read_checkpoint(tmp_path / "other.ckpt")


def test_equal_settings_pass_whether_lists_or_tuples():
    require_same("x", {"a": {"b": (1, 2)}, "c": None}, {"a": {"b": [1, 2]}, "c": None})


def test_every_difference_is_listed_with_both_values():
    expected = {"model": {"width": 64, "kind": "a"}, "seed": 1}
    received = {"model": {"width": 32, "kind": "a", "extra": 2}}
    with pytest.raises(UserError) as caught:
        require_same("checkpoint x", expected, received)
    lines = str(caught.value).splitlines()
    assert lines == [
        "checkpoint x belongs to a different training run:",
        "  model.extra: expected nothing, received 2",
        "  model.width: expected 64, received 32",
        "  seed: expected 1, received nothing",
    ]


def test_flatten_uses_dotted_keys():
    assert flatten({"a": {"b": {"c": 1}}, "d": [1]}) == {"a.b.c": 1, "d": [1]}
