"""``ppmcal diagnose`` names effects with memory from rows in order, and does not without."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.commands import columns, ppmcal, rows, write_csv
from helpers.diagnoses import BOXES, DATA, diagnose, drop, effect, found_in, simulate

MEMORY: dict[str, dict[str, Any]] = {
    "play": effect("play", ["leg2"], width=0.08),
    "creep": effect("creep", give=2e-4, tau=400.0),
    "motion of the base": effect("base_thermal", growth=2e-4, tau=500.0) | {"from": "motion"},
    "product": effect("product", ["leg2"], width=0.012) | {"of": ["backlash", "temperature"]}}


def walked(folder: Path, count: int = 40) -> dict[str, Any]:
    """Write poses that are visited one after the other by short and by long moves."""
    rng = np.random.default_rng(7)
    box = BOXES["3-RPR"]
    half = np.array(list(box["half_range"].values()))
    step = half * rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-3.5, 0.0, (count, 1))
    away = np.zeros(3)
    out = []
    for move in step:
        away = np.clip(away + move, -half, half)
        out.append(np.array(list(box["center"].values())) + away)
    write_csv(folder / "walk.csv", [dict(zip(("x", "y", "rz"), p, strict=True)) for p in out])
    return {"file": "walk.csv"}


def campaign(folder: Path, name: str, **changes: Any) -> Path:
    # work shows in long moves only
    poses = {} if "motion" in name else {"poses": walked(folder)}
    return simulate(folder, "3-RPR", [MEMORY[name]], **(poses | {
        "count": 40, "approach": "sequence",
        "instrument": {"kind": "pose", "sigma": {"position": 0.002, "rotation": 0.0005}}}
        | changes))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Campaigns of a name, made and diagnosed into d/ on first use."""
    @cache
    def folder(name: str) -> Path:
        out = campaign(tmp_path_factory.mktemp("memory"), name)
        diagnose(out)
        return out
    return folder


@pytest.mark.long
@pytest.mark.parametrize("name", MEMORY)
def test_named_with_its_size(made: Callable[[str], Path], name: str) -> None:
    """The kind, its joints, and every parameter within four sigma, written as it reads back.

    How often the other kinds with memory are named is in docs/rates.
    """
    folder, truth = made(name), MEMORY[name]
    found = found_in(folder)
    assert found["verdict"] in ("named", "named-set"), found["effects"]
    assert {e["kind"] for e in found["effects"]} == {truth["kind"]}
    got = found["effects"][0]
    assert got["on"] == truth.get("on", [] if "base" in name else ["leg1", "leg2", "leg3"])
    for parameter, value in truth["parameters"].items():
        entry = got["parameters"][parameter]
        assert abs(entry["value"] - value) < 4.0 * entry["sigma"], (parameter, entry)
        assert entry["sigma"] < 0.25 * abs(value)
    model = yaml.safe_load((folder / "d" / "model.yaml").read_text())["effects"][0]
    assert {k: model.get(k) for k in ("of", "from")} == {k: truth.get(k) for k in ("of", "from")}
    ppmcal("check", "d/model.yaml", cwd=folder)
    again = ppmcal("identify", "d/model.yaml", DATA, "--out", "again", cwd=folder)
    assert again.code in (0, 1), again.err


@pytest.mark.long
def test_not_tested_without_an_order(tmp_path: Path) -> None:
    """Neither times nor `approach: sequence`: what to add is said, and no memory is named."""
    folder = campaign(tmp_path, "play")
    drop(folder, "time", "dir_")
    sidecar = folder / "s" / "measurements.yaml"
    tree = yaml.safe_load(sidecar.read_text()) | {"approach": "unknown"}
    sidecar.write_text(yaml.safe_dump(tree))
    run, found = diagnose(folder)
    lacks = {e["kind"]: e["missing"] for e in found["not_testable"]}
    assert lacks["play"] == lacks["hysteresis"] == ["approach: sequence"]
    assert lacks["leg_thermal from motion"] == ["time"]
    assert "play" not in {e["kind"] for e in found["effects"]}
    assert "approach: sequence" in " ".join(run.out.split())
    tree["approach"] = "sequence"
    sidecar.write_text(yaml.safe_dump(tree))
    _, found = diagnose(folder, DATA, "--kind", "play")
    assert {e["kind"] for e in found["effects"]} == {"play"}


@pytest.mark.long
def test_commands_that_make_up_for_play(made: Callable[[str], Path]) -> None:
    """In order, targets have a past; without one they are refused, and an export says so."""
    folder = made("play")
    assert found_in(folder)["verdict"] in ("named", "named-set")
    targets = [[470 + 20 * (i % 2), 288 + i, 30 + 0.1 * i] for i in range(8)]
    write_csv(folder / "t.csv", [dict(zip(("x", "y", "rz"), t, strict=True)) for t in targets])
    bad = ppmcal("compensate", "d/model.yaml", "t.csv", "--frame", "base", "--out", "c",
                 cwd=folder, expect=2)
    assert "order of the rows" in " ".join(bad.err.split())
    good = ppmcal("compensate", "d/model.yaml", "t.csv", "--frame", "base", "--approach",
                  "sequence", "--out", "c", cwd=folder)
    assert good.code in (0, 1), good.err
    assert {r["status"] for r in rows(folder / "c" / "commands.csv")} == {"ok"}
    assert "q_leg2" in columns(folder / "c" / "commands.csv")
