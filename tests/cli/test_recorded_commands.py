"""commands_recorded.csv: commands as the measurement file has its joints, and back again."""

from __future__ import annotations

import csv
import json
from decimal import Decimal
from pathlib import Path

import pytest
import yaml
from helpers.commands import ppmcal, rows
from helpers.paths import ROOT

LEGS = ("leg1", "leg2", "leg3")
STRUTS = {"leg1": "Strut; left", "leg2": "Strut B", "leg3": "Strut C"}
SIGNS = {"leg1": 1, "leg2": -1, "leg3": 1}
"""In the recording leg2 is counted the other way."""
INCH = Decimal("25.4")
TARGETS = "pose,x,y,rz\nA,500,290,5\nfar away,5000,290,5\nC,480,300,2\n"
READ = {"columns": {"pose": "Pt", **{f"q_{a}": h for a, h in STRUTS.items()}},
        "units": {"q_*": "in"}, "signs": {"q_leg2": -1}}


def recording(folder: Path, measured: list[dict[str, str]], decimals: int) -> None:
    """Write measurements with joints in inches, under other names, as a spreadsheet does."""
    rest = [c for c in measured[0] if c not in ("pose", *(f"q_{a}" for a in LEGS))]
    with (folder / "monday.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, delimiter=";")
        table.writerow(["Pt", *STRUTS.values(), *rest])
        for row in measured:
            joints = [SIGNS[a] * Decimal(row[f"q_{a}"]) / INCH for a in LEGS]
            table.writerow([row["pose"], *(f"{q:.{decimals}f}".replace(".", ",") for q in joints),
                            *(row[c].replace(".", ",") for c in rest)])


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A machine in mm, with measurements of it as it has them."""
    folder = tmp_path_factory.mktemp("bench")
    (folder / "m.yaml").write_bytes((ROOT / "configs" / "3-RPR.yaml").read_bytes())
    scenario = {"format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
                "poses": {"random": {"center": {"x": 500, "y": 290, "rz": 5},
                                     "half_range": {"x": 60, "y": 60, "rz": 8}, "count": 24}},
                "errors": {"random": {"scale": 1.0}}, "seed": 3,
                "instrument": {"kind": "pose", "sigma": {"position": 0.004, "rotation": 0.001}}}
    (folder / "s.yaml").write_text(yaml.safe_dump(scenario), encoding="utf-8")
    (folder / "targets.csv").write_text(TARGETS, encoding="utf-8")
    ppmcal("simulate", "m.yaml", "s.yaml", "--out", "sim", cwd=folder)
    return folder


@pytest.fixture(scope="module", params=[2, 6])
def compensated(bench, tmp_path_factory, request):
    """Commands of a machine that was identified by a recording with so many decimals."""
    folder = tmp_path_factory.mktemp("recorded")
    measured = rows(bench / "sim" / "measurements.csv")
    recording(folder, [{"pose": str(i), **row} for i, row in enumerate(measured)], request.param)
    side = yaml.safe_load((bench / "sim" / "measurements.yaml").read_text(encoding="utf-8"))
    side |= {"name": "monday", "read": READ}
    # its own rounding is noise of the joints
    side["instrument"]["sigma"]["actuator"] = float(INCH) * 10.0 ** -request.param
    (folder / "monday.yaml").write_text(yaml.safe_dump(side), encoding="utf-8")
    for name in ("m.yaml", "targets.csv"):
        (folder / name).write_bytes((bench / name).read_bytes())
    ppmcal("identify", "m.yaml", "monday.csv", cwd=folder, expect=None)
    done = ppmcal("compensate", "identified", "targets.csv", cwd=folder, expect=1)
    return folder, " ".join(done.out.split()), request.param


@pytest.mark.slow
def test_commands_go_back_as_the_joints_were_recorded(compensated):
    """Headers, inches, decimal commas and the turned sign; what was refused is left out."""
    folder, said, recorded = compensated
    with (folder / "compensated" / "commands_recorded.csv").open(newline="", encoding="utf-8") as f:
        header, *cells = list(csv.reader(f, delimiter=";"))
    assert header == ["Pt", *STRUTS.values()]
    assert [row[0] for row in cells] == ["A", "C"]
    sent = [row for row in rows(folder / "compensated" / "commands.csv") if row["status"] == "ok"]
    decimals = len(cells[0][1].partition(",")[2])
    assert decimals >= recorded
    for row, ours in zip(cells, sent, strict=True):
        for a, cell in zip(LEGS, row[1:], strict=True):
            exact = SIGNS[a] * Decimal(ours[f"q_{a}"]) / INCH
            # half a unit of the last place, and what a double is off
            assert abs(Decimal(cell.replace(",", ".")) - exact) <= Decimal(10) ** -decimals * (
                Decimal("0.5") + Decimal("1e-6"))
    assert (f"as monday has its joints: in, {decimals} decimals, separated by semicolons, decimal "
            "commas") in said


@pytest.mark.slow
def test_rounding_takes_less_than_the_model_is_uncertain_by(compensated):
    """Two recorded decimals, 0.25 mm, are too few of them; six are kept though fewer would do."""
    folder, _, recorded = compensated
    record = json.loads((folder / "compensated" / "commands.json").read_text(encoding="utf-8"))
    decimals = {c["decimals"] for c in record["recorded"]["columns"] if c["name"] != "pose"}
    sigma = min(float(row["sigma_position"]) for row in rows(
        folder / "compensated" / "commands.csv") if row["status"] == "ok")
    if recorded == 6:
        assert decimals == {6}
        return
    step = float(INCH) * 10.0 ** -min(decimals)
    assert min(decimals) > recorded
    assert step < sigma < 10.0 * float(INCH) * 10.0 ** -recorded


@pytest.mark.slow
def test_the_same_sidecar_reads_them_back(compensated):
    """With what a tracker measured at them: the joint values are those that were sent."""
    folder, _, _ = compensated
    (folder / "points.csv").write_text("pose,x,y,rz\nA,1,2,3\nC,4,5,6\n", encoding="utf-8")
    ppmcal("read", "compensated/commands_recorded.csv", "points.csv", "--mechanism", "m.yaml",
           "--sidecar", "monday.yaml", "--out", "again.csv", cwd=folder)
    sent = {row["pose"]: row for row in rows(folder / "compensated" / "commands.csv")}
    again = rows(folder / "again.csv")
    assert [row["pose"] for row in again] == ["A", "C"]
    record = json.loads((folder / "compensated" / "commands.json").read_text(encoding="utf-8"))
    steps = {c["name"]: float(INCH) * 10.0 ** -c["decimals"] for c in record["recorded"]["columns"]}
    for row in again:
        for a in LEGS:
            name = f"q_{a}"
            assert float(row[name]) == pytest.approx(float(sent[row["pose"]][name]), rel=0.0,
                                                     abs=0.501 * steps[name])


@pytest.mark.slow
def test_joints_as_the_machine_has_them_are_in_commands_csv_alone(bench):
    """And asked for, they are as any file has them."""
    ppmcal("identify", "m.yaml", "sim/measurements.csv", cwd=bench)
    ppmcal("compensate", "identified", "targets.csv", cwd=bench, expect=1)
    assert "recorded" not in (bench / "identified" / "identification.json").read_text("utf-8")
    assert not (bench / "compensated" / "commands_recorded.csv").exists()
    plain = (bench / "compensated" / "commands.csv").read_bytes()
    ppmcal("compensate", "identified", "targets.csv", "--like", "sim/measurements.csv", "--out",
           "asked", cwd=bench, expect=1)
    assert (bench / "asked" / "commands.csv").read_bytes() == plain
    found = rows(bench / "asked" / "commands_recorded.csv")
    assert [*found[0]] == ["pose", "q_leg1", "q_leg2", "q_leg3"]
    assert [row["pose"] for row in found] == ["A", "C"]
