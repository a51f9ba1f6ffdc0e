"""Records of design commands and exports: what is read back is what was written."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.paths import ROOT

from ppmcal.codec import shape
from ppmcal.commands.tolerances.options import TolerancesArguments
from ppmcal.commands.tolerances.run import solve
from ppmcal.controllers import loaded
from ppmcal.controllers.export import record_of
from ppmcal.design.assembly_modes import ModeRow, assembly_modes
from ppmcal.design.plan.plan import PlanOptions, plan
from ppmcal.design.sensitivity import SensitivityOptions, analyse
from ppmcal.design.statics import AppliedLoad
from ppmcal.design.stiffness import StiffnessStudy, stiffness_at_home, stiffness_table
from ppmcal.design.virtual_instrument import default_instrument
from ppmcal.design.workspace import workspace
from ppmcal.errors import BadInput
from ppmcal.io import read_mechanism
from ppmcal.io.grid import metric_length, read_grid
from ppmcal.io.results.export import CommandErrors, ExportRecord
from ppmcal.io.results.parts import ErrorSize
from ppmcal.io.results.plan import PlanRecord
from ppmcal.io.results.record import Record
from ppmcal.io.results.sensitivity import SensitivityRecord
from ppmcal.io.results.stiffness import StiffnessRecord
from ppmcal.io.results.tolerances import TolerancesRecord
from ppmcal.io.results.workspace import WorkspaceRecord
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import home_state
from ppmcal.model.mechanism import Mechanism
from ppmcal.store.provenance import provenance

CONFIGS = ROOT / "configs"
GRID = "x=450:550:4,y=250:330:3"


def machine(name: str = "3-RPR") -> Mechanism:
    return read_mechanism(CONFIGS / f"{name}.yaml")


def source(m: Mechanism, seed: int | None = 3) -> dict[str, object]:
    return provenance(m.inputs, "ppmcal test", seed)


def sensitivity(_: Path) -> SensitivityRecord:
    m = machine()
    grid = read_grid(GRID, m)
    asked = SensitivityOptions(np.zeros(3), metric_length(None, m), together=("leg1.offset",),
                               size=1e-4)
    found = analyse(m, asked, grid.poses(m))
    return SensitivityRecord.of(found, m, grid, source(m, None))


def tolerances(_: Path) -> TolerancesRecord:
    m = machine()
    asked = TolerancesArguments(m, accuracy=0.5, share=0.9, measure=10, machines=20,
                                cores=1, seed=3)
    return TolerancesRecord.of(solve(m, asked), m, source(m))


def stiffness(folder: Path, load: bool = True) -> StiffnessRecord:
    path = folder / "stiff.yaml"
    whole = yaml.safe_load((CONFIGS / "3-RPR.yaml").read_text())
    path.write_text(yaml.safe_dump(whole | {"stiffness": {"bar": 5e4}}))
    m = read_mechanism(path)
    tool, grid = np.zeros(3), read_grid(GRID, m)
    force = AppliedLoad.of(np.array([10.0, *[0.0] * 5]), "fx = 10 N") if load else None
    found = stiffness_table(m, grid.poses(m), tool, force.wrench if force else None)
    return StiffnessRecord.of(StiffnessStudy(m, grid.poses(m), grid, tool, force,
                                             stiffness_at_home(m, tool), found), source(m, None))


def space(_: Path) -> WorkspaceRecord:
    m = machine()
    q = home_state(m).q
    rows = [ModeRow(0, q, assembly_modes(Model(m), q, 0)), ModeRow(1, q, None, "no pose closes")]
    return WorkspaceRecord.of(workspace(m, read_grid("x=-100:1100:9,y=-100:700:9", m)), rows,
                              source(m, 0))


def measuring_plan(_: Path) -> PlanRecord:
    m = machine()
    found = plan(m, default_instrument(m), PlanOptions(6, 3), wanted=1e-5)
    return PlanRecord.of(found, 1e-5, ["A note."], source(m))


def exported(form: str, name: str) -> Callable[[Path], ExportRecord]:
    def build(_: Path) -> ExportRecord:
        m = machine(name)
        g = m.values.copy()
        g[list(m.free)] += 1e-5
        m = m.with_values(g)
        return record_of(loaded(form).export(m, None, None), m.name, source(m, None))

    return build


RECORDS: dict[str, Callable[[Path], Record]] = {
    "sensitivity": sensitivity, "tolerances": tolerances, "stiffness": stiffness,
    "no load": lambda folder: stiffness(folder, load=False), "workspace": space,
    "plan": measuring_plan, "klipper": exported("klipper", "delta-linear"),
    "reprap": exported("reprap", "delta-linear"), "joints": exported("joints", "3-RPR"),
    "linuxcnc": exported("linuxcnc", "6-UPS"), "grid": exported("grid", "3-RPR")}


@pytest.mark.long_cases("grid")
@pytest.mark.slow
@pytest.mark.parametrize("kind", RECORDS)
def test_what_is_read_is_what_was_written(tmp_path: Path, kind: str) -> None:
    written = RECORDS[kind](tmp_path)
    path = tmp_path / written.FILE
    path.write_text(written.text())
    again = type(written).read(path)
    assert again == written
    assert again.text() == written.text()
    # nothing but declared keys, in their order
    assert not written.more
    names = list(dict.fromkeys(f.key.partition(".")[0] for f in shape(type(written))))
    held = list(json.loads(written.text()))
    assert held == [n for n in names if n in held]


@pytest.mark.parametrize("kind", [SensitivityRecord, TolerancesRecord, StiffnessRecord,
                                  WorkspaceRecord, PlanRecord, ExportRecord])
def test_any_key_may_be_missing_null_or_unknown(tmp_path: Path, kind: type[Record]) -> None:
    path = tmp_path / kind.FILE
    names = [f.key for f in shape(kind)]
    path.write_text(json.dumps({**dict.fromkeys(names), "later": {"a": [1]}}))
    again = kind.read(path)
    assert again.entries()["later"] == {"a": [1]}
    assert all(getattr(again, f.name) == getattr(kind(), f.name) for f in shape(kind))
    path.write_text("{}")
    assert kind.read(path) == kind()


@pytest.mark.parametrize(("kind", "text", "place"), [
    (PlanRecord, '{"route": {"after": "long"}}', "route.after: should be a number"),
    (PlanRecord, '{"candidates": 3}', "candidates: should be an object"),
    (StiffnessRecord, '{"home": {"translational": {"values": {}}}}', "home.translational.values"),
    (WorkspaceRecord, '{"modes": [{"count": 1.5}]}', "modes[0].count: should be a whole number"),
    (TolerancesRecord, '{"yield": [{"share": "all"}]}', "yield[0].share: should be a number"),
    (ExportRecord, '{"gain": {"before": {"rms": true}}}', "gain.before.rms: should be a number"),
    (ExportRecord, '{"format": "ppmcal/export/2"}', "export.json of this version of ppmcal"),
])
def test_a_value_of_another_kind_is_refused(tmp_path: Path, kind: type[Record], text: str,
                                            place: str) -> None:
    path = tmp_path / kind.FILE
    path.write_text(text)
    with pytest.raises(BadInput) as refusal:
        kind.read(path)
    assert place in str(refusal.value)
    assert str(path) in str(refusal.value)


def test_errors_in_words() -> None:
    turn = ErrorSize(rms=0.0012, max=0.0034, unit="deg")
    both = CommandErrors(rms=0.0123, max=0.0456, unit="mm", rotation=turn)
    assert both.words() == ("0.0123 mm rms, 0.0456 mm at most; 0.00120 deg rms, 0.00340 deg at "
                            "most")
    assert both.rms_words() == "0.012 mm and 0.0012 deg"
    assert CommandErrors(rms=1e-9, unit="mm").rms_words() == "below 0.0001 mm"
    assert CommandErrors().words() == CommandErrors().rms_words() == ""


@pytest.mark.slow
def test_console_and_report_say_the_same_of_an_export(tmp_path: Path) -> None:
    """One sentence on what is left, one on each thing that cannot be expressed."""
    from ppmcal.report.exported import export_section
    from ppmcal.report.records import Held
    from ppmcal.report.section import placed

    m = machine("delta-linear")
    found = loaded("klipper").export(m, None, None)
    worse = replace(found, before=found.after, after=replace(found.after, rms=1e-3))
    record = record_of(worse, m.name, source(m, None))
    assert record.all_findings() == [
        "the new Klipper numbers are worse than the old ones over this workspace"]
    sentence = record.predicted_sentence()
    assert sentence.startswith("What the format cannot express: 1 mm rms")
    assert sentence.replace("'", "&#39;") in placed([export_section(
        Held("o", record))])[0].html


@pytest.mark.parametrize(("text", "words"), [
    ("x=-1e300:3:4", "not between -1e12 and 1e12"), ("x=3:nan", "not between"),
    ("x=5:5:3", "does not go from a lower to a higher")])
def test_a_range_is_refused_for_what_is_wrong_with_it(text: str, words: str) -> None:
    with pytest.raises(BadInput, match=words):
        read_grid(text, machine("3-RPR"))
