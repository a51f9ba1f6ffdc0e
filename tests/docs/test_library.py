"""The inner library: ten names are where the page says, its example and the notebook run."""

from __future__ import annotations

import importlib
import re
import tomllib

import numpy as np
from generators.notebook import cells
from helpers.paths import ROOT

import ppmcal

PAGE = (ROOT / "docs" / "library.md").read_text(encoding="utf-8")
NAMES = dict(re.findall(r"^\| `(\w+)` \| `(ppmcal[\w.]*)` \|", PAGE, re.M))
INNER = ("algebra", "model", "kinematics", "inference", "calibration.fit")


def test_ten_names_are_where_the_page_says():
    assert len(NAMES) == 10
    for name, module in NAMES.items():
        found = getattr(importlib.import_module(module), name)
        assert found.__doc__ and module.removeprefix("ppmcal.").startswith(INNER)
        # a command of the same name is another function: it reads files and chooses
        assert getattr(ppmcal, name, None) is not found


def test_the_inner_library_imports_nothing_above_it():
    config = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    (one,) = (c for c in config["tool"]["importlinter"]["contracts"]
              if c["name"] == "the inner library knows nothing above it")
    assert one["source_modules"] == [f"ppmcal.{name}" for name in INNER]
    above = {f"ppmcal.{p.parent.name}" for p in (ROOT / "ppmcal").glob("*/__init__.py")} | {
        f"ppmcal.calibration.{p.parent.name}"
        for p in (ROOT / "ppmcal" / "calibration").glob("*/__init__.py")}
    ground = {"ppmcal.calibration", "ppmcal.wording"}
    assert set(one["forbidden_modules"]) == above - ground - set(one["source_modules"])
    assert "ignore_imports" not in one


def test_the_example_of_the_page_prints_what_is_free(capsys):
    names: dict[str, object] = {}
    exec(compile(re.search(r"```python\n(.*?)```", PAGE, re.S)[1], "library.md", "exec"), names)
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == [
        names["machine"].names[p] for p in names["machine"].free]


def test_the_cells_of_the_notebook_run():
    names: dict[str, object] = {}
    code = [text for kind, text in cells(ROOT / "docs" / "library.ipynb") if kind == "code"]
    assert len(code) == 10
    for text in code:
        exec(compile(text, "library.ipynb", "exec"), names)
    assert set(NAMES) <= set(names)
    assert names["fit"].converged and np.argmax(names["found"].probability) == 1
