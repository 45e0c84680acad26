"""Remarks on runs that were judged to be bad, wherever their models are used."""

from __future__ import annotations

import json

from entry import SMALL, call

from ahnn.loading import judged_training


def write(folder, *findings):
    (folder / "metrics.json").write_text(json.dumps({"plugins": {"verdict": {"findings": findings}}}))


def test_the_reason_for_a_bad_verdict_is_repeated(tmp_path):
    assert judged_training(tmp_path) == ""
    write(tmp_path, "good: relative error 0.1 %")
    assert judged_training(tmp_path) == ""
    write(tmp_path, "not good: relative error 0.1 %", "budget=smoke only checks", "residuals are large; more")
    assert (
        judged_training(tmp_path) == f"run {tmp_path}: its evaluation judged it not good: residuals are large"
    )
    write(tmp_path, "WORTHLESS: relative error 300 %")
    assert judged_training(tmp_path).endswith("judged it WORTHLESS: relative error 300 %")
    (tmp_path / "metrics.json").write_text("[]")
    assert judged_training(tmp_path) == ""


def test_a_prediction_by_a_bad_model_says_so(tmp_path, caplog):
    run = f"run={tmp_path / 'run'}"
    assert call("ahnn.train", *SMALL, "evaluation.figures=false", run) == 0
    assert call("ahnn.predict", run, "start=[0.5,0]", "duration=1", f"output={tmp_path / 'out.csv'}") == 0
    assert "its evaluation judged it" in caplog.text
    assert "its evaluation judged it" in (tmp_path / "out.yaml").read_text()
