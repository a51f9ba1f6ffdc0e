"""Messages on files whose hint is the line to write, for mistakes that users made."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from helpers.bodies import MACHINE, machine, measured, sidecar, wide
from helpers.paths import ROOT

import ppmcal as package
from ppmcal.calibration.interpretation import unit_findings
from ppmcal.errors import BadInput, unknown

CONFIGS = sorted((ROOT / "configs").glob("*.yaml"))
TABLE = "q_leg1,q_leg2,q_leg3,{}\n500,501,502,10,20\n510,501,502,11,20\n505,507,502,10,22\n"


def refusal(folder: Path, table: str, beside: str | None = None) -> str:
    """Return the message on a table, with a sidecar if there is one."""
    machine(folder)
    (folder / "t.csv").write_text(table)
    if beside is not None:
        (folder / "t.yaml").write_text(beside)
    with pytest.raises(BadInput) as told:
        package.read_data(package.load(folder / "bench.yaml"), folder / "t.csv")
    return str(told.value)


@pytest.mark.parametrize(("heads", "line"), [
    ("X,Y", "`read: {columns: {x: X, y: Y}}`"), ("East,North", "`read: {columns: {x: East, y: N")])
def test_columns_that_nobody_knows_are_offered(tmp_path: Path, heads: str, line: str) -> None:
    assert line in refusal(tmp_path, TABLE.format(heads), sidecar("t", "target: unknown"))


def test_the_line_for_such_columns_works(tmp_path: Path) -> None:
    machine(tmp_path)
    (tmp_path / "t.csv").write_text(TABLE.format("X,Y"))
    (tmp_path / "t.yaml").write_text(sidecar("t", "target: unknown",
                                             more="read: {columns: {x: X, y: Y}}\n"))
    (data,) = package.read_data(package.load(tmp_path / "bench.yaml"), tmp_path / "t.csv")
    assert data.position[0, :2] == pytest.approx([0.01, 0.02])


def test_the_header_of_one_mark_is_offered_under_its_name(tmp_path: Path) -> None:
    machine(tmp_path)
    path = wide(tmp_path, measured(1), spelt="{name}_{axis}")
    path.write_text(path.read_text().replace("T2_x", "X2"))
    with pytest.raises(BadInput, match=r"read: \{columns: \{T2_x: X2\}\}"):
        package.read_data(package.load(tmp_path / "bench.yaml"), path)


def test_the_example_of_a_sidecar_suits_the_columns(tmp_path: Path) -> None:
    table = "q_leg1,q_leg2,q_leg3,distance\n500,501,502,10\n"
    told = refusal(tmp_path, table)
    assert "instrument: {kind: distance, sigma: {distance: 0.01}, point: unknown}" in told
    (tmp_path / "t.yaml").write_text(told.split("example:\n")[1].split("with your")[0])
    (data,) = package.read_data(package.load(tmp_path / "bench.yaml"), tmp_path / "t.csv")
    assert data.kind.name == "distance"


def test_a_pdf_is_no_table(tmp_path: Path) -> None:
    assert "is a binary file" in refusal(tmp_path, "%PDF-1.4\nstream\n")


def test_a_decimal_comma_in_a_mapping_is_told(tmp_path: Path) -> None:
    (tmp_path / "m.yaml").write_text(MACHINE.replace("offset: 0.4", "offset: 0,02"))
    with pytest.raises(BadInput, match="the number of 'offset' seems to have a decimal comma"):
        package.load(tmp_path / "m.yaml")


def test_a_table_in_the_place_of_the_machine_is_told(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(TABLE.format("x,y"))
    with pytest.raises(BadInput, match="looks like a table: the mechanism file comes first"):
        package.load(tmp_path / "t.csv")


def test_a_name_in_other_letters_is_the_nearest() -> None:
    assert unknown("kind", "U(P)s", ["U(P)U", "U(P)S"]).hint.endswith("Did you mean 'U(P)S'?")


def test_a_wrong_cell_is_placed_by_the_header_of_the_file(tmp_path: Path) -> None:
    machine(tmp_path)
    path = wide(tmp_path, measured(1), spelt="{name}_{axis}")
    head, first, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head, ",".join([*first.split(",")[:-1], "n/a"]), *rows]) + "\n")
    with pytest.raises(BadInput, match=r"row 1, column T3_y: 'n/a' is not a number"):
        package.read_data(package.load(tmp_path / "bench.yaml"), path)
    path.write_text("\n".join([head.replace("q_leg2", "dir_leg1"), first, *rows]) + "\n")
    with pytest.raises(BadInput) as told:
        package.read_data(package.load(tmp_path / "bench.yaml"), path)
    assert "(target" not in str(told.value).partition("column dir_leg1")[2]


def test_an_empty_cell_of_a_row_that_is_used_is_told(tmp_path: Path) -> None:
    machine(tmp_path)
    (tmp_path / "t.csv").write_text(TABLE.format("x,y").replace("502,11,", "502,,"))
    (tmp_path / "t.yaml").write_text(sidecar("t", "target: unknown"))
    (data,) = package.read_data(package.load(tmp_path / "bench.yaml"), tmp_path / "t.csv")
    (note,) = [f for f in data.findings if "is empty" in f]
    assert note.endswith("row 2: x is empty; what else was measured there is used.")


def test_angles_that_are_a_whole_turn_off_are_told_as_that(tmp_path: Path) -> None:
    path = next(p for p in CONFIGS if p.name == "3-RRR-1.yaml")
    tree = yaml.safe_load(path.read_text())
    low, high = tree["limits"]["leg1"]
    lines = "".join(f"{0.5 * (low + high) + 360 + i},95,-145,0,0,{i}\n" for i in range(6))
    (tmp_path / "t.csv").write_text("q_leg1,q_leg2,q_leg3,x,y,rz\n" + lines)
    (tmp_path / "t.yaml").write_text(sidecar("t", "target: unknown").replace("position", "pose", 1)
                                     .replace("0.01}", "0.01, rotation: 0.01}"))
    cranks = package.load(path)
    found = unit_findings(cranks, package.read_data(cranks, tmp_path / "t.csv"))
    assert any("subtract 360 deg in that column" in f for f in found)
