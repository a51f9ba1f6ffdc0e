"""A printer that did not change, by touches alone and by touches with lengths: a metre apart.

Touches of a bed that may stand anywhere do not see how high the printer is: only what its leaning
tower makes of that. Where a calibration ends there is a matter of noise, and no linear step leads
from one end to the other.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import ppmcal as command
from helpers.printers import leaning

import ppmcal
from ppmcal.calibration.fit.fit_result import FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.prior_information import Posterior
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.sessions.change_detection import Comparison, between, posterior_of
from ppmcal.calibration.sessions.joint_fit import fitted_together
from ppmcal.io import read_campaign, read_mechanism
from ppmcal.model.mechanism import Mechanism

AGAIN = "Both were fitted to their measurements again, from one point"
FLAT = {"center": {"x": 0, "y": 0, "z": 0}, "half_range": {"x": 70, "y": 70, "z": 0}}
TOUCHES = {"kind": "plane", "sigma": {"height": 0.02}}
LENGTHS = {"kind": "distance", "between": "positions", "sigma": {"distance": 0.05}}


def measured(machine: Path, folder: Path, seed: int, instrument: dict[str, Any], count: int,
             frame: Any) -> Path:
    """Measure the printer at places on its bed, all of one machine within its tolerances."""
    printer, rng = read_mechanism(machine), np.random.default_rng(2)
    sizes = {"length": 0.3, "angle": 0.2}
    errors = {printer.parameters[p].name: float(sizes[printer.parameters[p].quantity]
                                                * rng.normal()) for p in printer.free
              if not printer.names[p].endswith("offset")}
    ppmcal.simulate(printer, {
        "format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"}, "errors": errors,
        "poses": {"random": FLAT | {"count": count}}, "instrument": instrument, "frame": frame,
        "seed": seed}).save(folder)
    return folder / "measurements.csv"


def printer(folder: Path) -> tuple[Path, list[Path], list[Path]]:
    """Return the printer's file, heights and lengths of it, and touches of a bed anywhere."""
    machine = leaning(folder)
    bed = dict.fromkeys(("x", "y", "z", "rx", "ry", "rz"), 0.0)
    return machine, [measured(machine, folder / "heights", 1, TOUCHES, 40, "known"),
                     measured(machine, folder / "distances", 2, LENGTHS, 20, "known")], [
                         measured(machine, folder / "mesh", 3, TOUCHES, 40, bed)]


def changed(mechanism: Mechanism, known: Sequence[Posterior]) -> Comparison:
    values = mechanism.values.copy()
    values[list(known[1].places)] = known[1].estimate(mechanism)
    return between(mechanism.with_values(values), known[0], known[1], {},
                   np.random.default_rng(0))[0]


@pytest.mark.long
def test_one_fit_to_both_finds_no_change_where_a_linear_step_does(tmp_path: Path) -> None:
    path, *tables = printer(tmp_path)
    machine = read_mechanism(path)
    fits = [identify(Problem(machine, read_campaign(t, machine), machine.free), FitOptions())
            for t in tables]
    known = [posterior_of(f) for f in fits]
    place = machine.names.index("a.offset")
    assert abs(fits[1].state.g[place] - fits[0].state.g[place]) > 0.3
    for old, new in ((0, 1), (1, 0)):
        pair = known[old], known[new]
        step = changed(machine, pair)
        assert step.changed and step.p_value < 1e-4
        both = changed(machine, fitted_together(fits[old], fits[new], pair, FitOptions()))
        assert not both.changed and both.p_value > 0.05


@pytest.mark.long
def test_the_command_says_so_and_how(tmp_path: Path) -> None:
    """On the console, on the page, and again when the folder is verified."""
    machine, known, alone = printer(tmp_path)
    for name, data in (("lengths", known), ("touches", alone)):
        command("identify", machine, *data, "--out", name, cwd=tmp_path, expect=0)
    found = command("compare", "lengths", "touches", cwd=tmp_path, expect=0)
    told = " ".join(found.out.split())
    assert "nothing has changed" in told and AGAIN in told
    record = json.loads((tmp_path / "compared" / "comparison.json").read_text(encoding="utf-8"))
    assert record["verdict"] == "unchanged" and record["p_value"] > 0.05
    assert {Path(name).parent.name for name in record["provenance"]["inputs"]} >= {
        "heights", "distances", "mesh"}
    command("report", "compared", "--out", "page", cwd=tmp_path, expect=0)
    page = (tmp_path / "page" / "report.html").read_text(encoding="utf-8")
    assert AGAIN in " ".join(page.split())
    assert "same" in command("verify", "compared", cwd=tmp_path, expect=0).out
    # without the tables there is but the linear step
    (tmp_path / "mesh" / "measurements.csv").unlink()
    assert "nothing has changed" not in command(
        "compare", "lengths", "touches", "--out", "alone", cwd=tmp_path, expect=1).out
