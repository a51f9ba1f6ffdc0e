"""A unit in a header is the same as one under `read.units` in the sidecar."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.mistakes import MACHINE, Row, scaled, session

from ppmcal.commands.inputs import load
from ppmcal.errors import BadInput
from ppmcal.io.dataset_reader import read_dataset
from ppmcal.model.dataset import Dataset

LEGS = [f"q_leg{i}" for i in range(1, 7)]


def written(folder: Path, headers: dict[str, str], read: dict[str, Any] | None = None,
            factors: dict[str, float] | None = None) -> Path:
    """Write a session with other headers, other numbers and a block `read`."""
    def change(rows: list[Row]) -> None:
        for n, row in enumerate(rows):
            row |= {"temperature": 64.4 + 0.1 * n, "payload": 500.0, "mx": 1.0 + n}
        for name, factor in (factors or {}).items():
            scaled((name,), factor)(rows)
        for n, row in enumerate(rows):
            rows[n] = {headers.get(k, k): v for k, v in row.items()}

    path = session(folder, change)
    side = path.with_suffix(".yaml")
    content = yaml.safe_load(side.read_text(encoding="utf-8"))
    side.write_text(yaml.safe_dump({**content, **({"read": read} if read else {})}),
                    encoding="utf-8")
    return path


def data(path: Path) -> Dataset:
    return read_dataset(path, load(MACHINE))


@pytest.mark.parametrize("form", ["{} [{}]", "{} ({})", "{}[{}]", " {}  ( {} )"])
def test_it_is_the_same_as_in_the_sidecar(tmp_path: Path, form: str) -> None:
    units = {"q_leg1": "in", "q_leg2": "um", "x": "m", "rx": "rad", "temperature": "F",
             "payload": "g", "mx": "N m"}
    headed = data(written(tmp_path / "a", {n: form.format(n, u) for n, u in units.items()}))
    told = data(written(tmp_path / "b", {}, {"units": units}))
    for name in ("q", "position", "rotation"):
        assert getattr(headed, name).tobytes() == getattr(told, name).tobytes()
    for name, values in told.columns.items():
        np.testing.assert_array_equal(headed.columns[name], values)
    assert headed.columns["temperature"][0] == pytest.approx(273.15 + 18.0)
    assert headed.q[0, 0] == pytest.approx(25.4 * data(written(tmp_path / "c", {})).q[0, 0])


def test_units_as_people_write_them(tmp_path: Path) -> None:
    path = written(tmp_path, {"rx": "rx [°]", "x": "x (µm)", "temperature": "temperature [°F]",
                              "mx": "mx (Nm)", "pose": "pose [-]", "payload": "payload (g)"},
                   factors={"x": 1e3})
    plain = written(tmp_path / "plain", {}, {"units": {"temperature": "F", "payload": "g"}})
    one, two = data(path), data(plain)
    np.testing.assert_allclose(one.position, two.position, rtol=1e-12)
    np.testing.assert_array_equal(one.rotation, two.rotation)
    np.testing.assert_array_equal(one.columns["temperature"], two.columns["temperature"])


def test_renamed_columns_have_units_too(tmp_path: Path) -> None:
    path = written(tmp_path, {"q_leg1": "Leg 1 [in]", "q_leg2": "Leg 2 [in]", "x": "X (raw)"},
                   {"columns": {"q_leg1": "Leg 1", "q_leg2": "Leg 2 [in]", "x": "X (raw)"}})
    told = written(tmp_path / "b", {}, {"units": {"q_leg1": "in", "q_leg2": "in"}})
    np.testing.assert_array_equal(data(path).q, data(told).q)


def test_said_twice_alike_it_counts_once(tmp_path: Path) -> None:
    path = written(tmp_path, {q: f"{q} [in]" for q in LEGS}, {"units": {"q_*": "in"}})
    told = written(tmp_path / "b", {}, {"units": {"q_*": "in"}})
    np.testing.assert_array_equal(data(path).q, data(told).q)


def test_what_is_ignored_may_be_words(tmp_path: Path) -> None:
    path = written(tmp_path, {"payload": "remark (of whom?)"},
                   {"ignore": ["remark (of whom?)"]})
    path.write_text(path.read_text().replace("500.0", "windy, warm".replace(",", "")))
    assert len(data(path)) > 10


@pytest.mark.parametrize(("headers", "read", "says"), [
    ({"x": "x [mm]"}, {"units": {"x": "in"}},
     ["run.yaml: read.units.x", "in in", "header", "mm", "Correct"]),
    ({"q_leg1": "q_leg1 (mm)"}, {"units": {"q_*": "in"}}, ["read.units.q_*", "q_leg1"]),
    ({"x": "x [furlong]"}, None, ["run.csv: header, column x [furlong]", "furlong",
                                  "Allowed: m, cm, mm, um, in"]),
    ({"x": "x [deg]"}, None, ["run.csv: header, column x", "cannot be in deg", "m or cm or mm"]),
    ({"x": "x [mm]", "payload": "x (in)"}, None, ["two columns are called 'x'", "ignore"]),
    ({}, {"units": {"q_leg*": "in", "q_?eg1": "mm"}},
     ["q_leg1", "'q_leg*' (in)", "'q_?eg1' (mm)", "run.yaml: read.units.q_", "Leave one"]),
    ({}, {"signs": {"q_*": -1, "q_leg2": -1}}, ["q_leg2", "'q_*' (-1)", "read.signs.q_"]),
    ({"x": "what (ever)"}, None, ["there is no column x"])])
def test_what_cannot_be_is_refused(tmp_path: Path, headers: dict[str, str],
                                   read: dict[str, Any] | None, says: list[str]) -> None:
    with pytest.raises(BadInput) as refused:
        data(written(tmp_path, headers, read))
    for words in says:
        assert words in str(refused.value)


@pytest.mark.parametrize(("columns", "meant"), [
    ({"q_leg1": "Enc A", "q_leg2": "Enc B", "q_leg3": "Enc C", "q_leg4": "Enc D"}, ""),
    ({"q_leg1": "Enc A", "q_leg2": "Enc B", "q_leg4": "Enc D"}, "Did you mean 'Enc C'?"),
    ({"q_leg4": "q_leg6"}, "")])
def test_a_column_that_is_another_one_already_is_not_what_was_meant(
        tmp_path: Path, columns: dict[str, str], meant: str) -> None:
    """The nearest header that is still free, none where none is near."""
    heads = {"q_leg1": "Enc A", "q_leg2": "Enc B", "q_leg3": "Enc C"}
    if "q_leg1" not in columns:
        heads = {"q_leg4": "leg four", "q_leg6": "6"}
    with pytest.raises(BadInput) as error:
        data(written(tmp_path, heads, {"columns": columns}))
    assert (meant in error.value.hint) if meant else "Did you mean" not in error.value.hint
