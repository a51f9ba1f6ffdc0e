"""Validations in the report."""

from __future__ import annotations

import json

import pytest
from helpers.commands import ppmcal as command
from helpers.drawings import svg_of

from ppmcal.commands.validate.run import errors_table
from ppmcal.io.results.validation import (
    ErrorSize,
    PredictedError,
    ValidatedDataset,
    ValidationRecord,
)
from ppmcal.report.validation import picture


def predicted(model, rms, closer=0.0, low=0.0, high=0.0, verdict=""):
    return PredictedError(model=model, position=ErrorSize(rms=rms, p95=2 * rms, max=3 * rms,
                                                          unit="mm"),
                          closer=closer, low=low, high=high, unit="mm", verdict=verdict)


@pytest.fixture
def day():
    return ValidatedDataset(name="may", source="may.csv", rows=40, of_rows=41,
                            fitted=("frame", "homing"), demanded=("homing",), errors=(
                                predicted("model", 0.02),
                                predicted("without backlash", 0.05, -0.03, -0.04, -0.02, "worse"),
                                predicted("nominal", 0.5, -0.48, -0.5, -0.4, "worse")))


@pytest.fixture
def folder(day, tmp_path):
    out = tmp_path / "validated"
    out.mkdir()
    record = ValidationRecord(format=ValidationRecord.FORMAT, name="stage", datasets=(day,),
                              findings=("look here",))
    for name, text in record.files().items():
        (out / name).write_text(text, encoding="utf-8")
    return out


def test_words(day):
    assert day.registered_sentence() == ("may: 40 of 41 rows; fitted: the frame and the joints' "
                                        "zeros (the joints' zeros since the data demand it).")
    turned = day.errors[0].changed(rotation=ErrorSize(rms=0.1, unit="deg"))
    both = day.changed(errors=(turned, *day.errors[1:]), demanded=())
    assert both.registered_sentence() == (
        "may: 40 of 41 rows; fitted: the frame and the joints' zeros, to the least square of "
        "positions and rotations over their noise.")
    assert day.effects_sentence() == "It is made smaller by backlash (0.03 mm)."


def test_a_miss_that_is_one_row_is_not_told_as_another_machine(day):
    """One value typed wrong of 40: 0.8 mm off, the others within 0.01 mm."""
    def missing(largest):
        size = ErrorSize(rms=0.13, max=largest, unit="mm")
        first = day.errors[0].changed(position=size, noise=19.0)
        return day.changed(errors=(first, *day.errors[1:])).misled()[0]

    assert "one row, off by 0.8 mm" in missing(0.8)
    assert "another machine" not in missing(0.8)
    assert "another machine, or something has changed" in missing(0.4)


def test_the_console_says_in_which_unit_one_is_better(day):
    table = errors_table(day)
    assert table.heads == ["machine", "mm rms", "better by, mm", "95 %, mm", ""]
    assert len(table.rows) == 3


def test_the_picture_has_a_line_for_each_machine(day):
    drawn = picture(day)
    assert drawn is not None
    svg = svg_of(drawn)
    assert all(e.model in svg for e in day.errors)
    assert picture(day.changed(errors=day.errors[:1])) is None


def test_the_report_begins_with_it(folder, tmp_path):
    done = command("report", folder, "--out", tmp_path / "rep")
    assert done.code == 0, done.err
    page = (tmp_path / "rep" / "report.html").read_text(encoding="utf-8")
    assert "On other measurements" in page and "without backlash" in page
    record = json.loads((tmp_path / "rep" / "report.json").read_text(encoding="utf-8"))
    assert record["headline"] == ["may: the model misses by 0.02 mm rms."]
    assert record["validations"][0]["validation"]["datasets"][0]["demanded"] == ["homing"]
    assert {"where": str(folder), "what": "look here"} in record["attention"]
