"""How well each number that a controller takes is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.printers import printer
from helpers.report_files import html_of

import ppmcal
from ppmcal.commands.export.run import told
from ppmcal.controllers import loaded
from ppmcal.controllers.export import Exported, record_of
from ppmcal.controllers.number_intervals import following, with_intervals
from ppmcal.io import read_mechanism
from ppmcal.io.results.export import ExportRecord
from ppmcal.io.results.knowledge import read_identification, read_knowledge
from ppmcal.linalg import Array, cholesky
from ppmcal.model.mechanism import Mechanism
from ppmcal.report.exported import export_section
from ppmcal.report.records import Held
from ppmcal.wording.told import ShortTable

SCENARIO = {
    "format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"}, "seed": 4,
    "poses": {"random": {"center": {"x": 0, "y": 0, "z": 30},
                         "half_range": {"x": 80, "y": 80, "z": 30}, "count": 12}},
    "errors": {"random": {"scale": 1.0}}, "frame": "known", "target": "known",
    "instrument": {"kind": "position", "sigma": {"position": 0.05}}}


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A delta printer, identified from places of its nozzle."""
    folder = tmp_path_factory.mktemp("delta")
    machine = printer(folder, ratio=-1.0)
    fit = ppmcal.identify(machine, ppmcal.simulate(machine, SCENARIO).data)
    fit.save(folder / "i")
    return folder / "i" / "identified.yaml"


def known(model: Path, form: str) -> tuple[Mechanism, Exported]:
    """Return the machine, and its export with intervals."""
    machine = read_mechanism(model)
    made = loaded(form).export(machine, None, None)
    return machine, replace(made, numbers=with_intervals(machine, made))


@pytest.mark.slow
def test_a_parameter_that_is_written_as_it_stands_keeps_its_interval(model: Path) -> None:
    """The same half as identify gives it, in the controller's unit; what is fixed has none."""
    _, made = known(model, "klipper")
    own = {p.name: p.half for p in read_identification(model.with_name("identification.json"))
           .parameters}
    half = {n.name: n.half for n in made.numbers}
    for name, parameter in (("printer.delta_radius", "radius"),
                            ("stepper_a.arm_length", "a.length"),
                            ("stepper_b.angle", "b.base.point.angle")):
        assert half[name] == pytest.approx(own[parameter], rel=1e-3)
    assert half["stepper_c.angle"] == 0.0    # 90 deg by definition


@pytest.mark.slow
@pytest.mark.parametrize("form", ["klipper", "reprap"])
def test_numbers_of_several_parameters_have_all_correlations(model: Path, form: str) -> None:
    """As machines have them that err by the principal parts of the covariance, exported anew."""
    machine, made = known(model, form)
    knowledge = read_knowledge(model.with_name("identification.json"), machine)
    places = [machine.names.index(n) for n in knowledge.names if n in machine.names]
    own = [c for c, n in enumerate(knowledge.names) if n in machine.names]
    assert made.again is not None
    ends = []
    for way in cholesky(knowledge.covariance[np.ix_(own, own)]).T:
        for side in (way, -way):
            g = machine.values.copy()
            g[places] += side
            ends.append(made.again(machine.with_values(g)))
    told = {p.name: p for p in read_identification(model.with_name("identification.json"))
            .parameters}
    ratio = [p.half / p.sigma for p in told.values() if p.half and p.sigma]
    moved = 0
    for number in made.numbers:
        values = np.array([f[number.name] for f in ends])
        drawn = float(np.sqrt(np.sum((values[::2] - values[1::2])**2)) / 2.0)
        if number.half and drawn > 1e-3:
            assert min(ratio) * 0.98 < number.half / drawn < max(ratio) * 1.02, number
            moved += 1
        else:
            assert drawn < 1e-3
    assert moved >= 9


@pytest.mark.slow
def test_without_what_the_fit_knows_there_is_none(model: Path, tmp_path: Path) -> None:
    """Nor a column of the table for it."""
    alone = tmp_path / "identified.yaml"
    alone.write_text(model.read_text())
    machine, made = known(alone, "klipper")
    assert [n.half for n in made.numbers] == [None] * len(made.numbers)
    assert "+- 95 %" not in _head(record_of(made, machine.name, {}))


@pytest.mark.slow
def test_table_and_page_show_them(model: Path) -> None:
    """Beside each number, in export.json too."""
    machine, made = known(model, "klipper")
    record = record_of(made, machine.name, {})
    radius = record.number_half["printer.delta_radius"]
    rows = next(t for t in told(record) if isinstance(t, ShortTable)).rows
    assert _head(record)[4] == "+- 95 %"
    assert rows[0][4] == f"{radius:.3g}"
    page = html_of(export_section(Held("o", record)))
    assert "± 95 %" in page
    assert f"{radius:.3g}" in page
    assert ExportRecord.checked(record.entries()).number_half == record.number_half


def _head(record: ExportRecord) -> list[str]:
    return list(next(t for t in told(record) if isinstance(t, ShortTable)).heads)


class _Shifted:
    """Stands for a machine: two lengths that errors compare with a and a + b."""

    def __init__(self, *lengths: float) -> None:
        self.lengths = np.array(lengths)


def test_fitted_numbers_follow_what_they_were_fitted_to() -> None:
    """As a fit again would have them, where errors bend and do not vanish."""
    def errors(machine: _Shifted) -> object:
        first, second = machine.lengths
        return lambda p: np.array([p[0]**2 - first, p[0] + p[1] - second, 0.1 * p[1] - 0.1])

    def fitted(machine: _Shifted) -> Array:
        from scipy.optimize import least_squares

        return np.asarray(least_squares(errors(machine), [2.0, 1.0], xtol=1e-15, ftol=1e-15,
                                        gtol=1e-15).x)

    start = _Shifted(4.0, 3.02)
    again = following(errors, start, fitted(start), np.full(2, 1e-5),    # type: ignore[arg-type]
                      lambda p: dict(zip("ab", p.tolist(), strict=True)))
    for step in ((1e-3, 0.0), (0.0, 1e-3)):
        ends = [_Shifted(*(start.lengths + side * np.array(step))) for side in (1.0, -1.0)]
        was, now = (np.array(list(again(one).values())) for one in ends)    # type: ignore[arg-type]
        assert was - now == pytest.approx(fitted(ends[0]) - fitted(ends[1]), rel=2e-3, abs=1e-6)

