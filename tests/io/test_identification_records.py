"""Records of identify, compare, simulate, compensate, kinematics: what is written reads back."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest
import yaml
from helpers.commands import ppmcal, rows

from ppmcal.codec import shape
from ppmcal.errors import BadInput
from ppmcal.io.results.commands import CommandsRecord
from ppmcal.io.results.comparison import ComparisonRecord
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.identification_parts import ErrorStages
from ppmcal.io.results.kinematics import KinematicsRecord
from ppmcal.io.results.parts import ErrorSize
from ppmcal.io.results.record import Record
from ppmcal.io.results.simulation import TruthRecord

CASES: dict[str, type[Record]] = {
    "sA": TruthRecord, "iA": IdentificationRecord, "both": IdentificationRecord,
    "kept": IdentificationRecord, "cmp": ComparisonRecord, "cmd": CommandsRecord,
    "kin": KinematicsRecord, "tool": KinematicsRecord}
RECORDS = tuple(dict.fromkeys(CASES.values()))
BARE = ("p_value", "p_alone", "times", "of_tolerance")
"""Numbers without a unit in parts that have one."""


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sessions, leg 3 homed anew between them: each by itself, both, carried on, compared."""
    folder = tmp_path_factory.mktemp("records")

    def run(*args: str, findings: int = 0) -> None:
        ppmcal(*args, "--quiet", cwd=folder, expect=findings)

    ppmcal("init", "3-RPR", cwd=folder, expect=0)
    scenario = yaml.safe_load((folder / "3-RPR.scenario.yaml").read_text())
    data = []
    for seed, label in enumerate("AB"):
        scenario |= {"errors": {"leg1.offset": 0.3, "leg3.offset": 0.5 * seed}, "seed": seed}
        (folder / f"{label}.yaml").write_text(yaml.safe_dump(scenario))
        run("simulate", "3-RPR.yaml", f"{label}.yaml", "--out", f"s{label}")
        side = folder / f"s{label}" / "measurements.yaml"
        side.write_text(side.read_text().replace("name: ", "name: of "))
        data.append(f"s{label}/measurements.csv")
        run("identify", "3-RPR.yaml", data[-1], "--out", f"i{label}")
    run("identify", "3-RPR.yaml", *data, "--out", "both", findings=1)
    run("identify", "3-RPR.yaml", data[1], "--start", "iA", "--keep", "--out", "kept", findings=1)
    run("compare", "iA", "iB", "--out", "cmp", findings=1)
    targets = [",".join(row[c] for c in ("x", "y", "rz")) for row in rows(folder / data[0])[:4:2]]
    (folder / "t.csv").write_text("\n".join(["x,y,rz", *targets, "9000,0,0"]) + "\n")
    run("compensate", "iA/identified.yaml", "t.csv", "--out", "cmd", findings=1)
    run("kinematics", "forward", "3-RPR.yaml", data[0], "--out", "kin")
    run("kinematics", "inverse", "3-RPR.yaml", data[0], "--tool", "30,-15", "--out", "tool")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_what_is_written_reads_back(folders: Path, case: str, tmp_path: Path) -> None:
    """Every key and every digit, in the same order."""
    kind = CASES[case]
    path = folders / case / kind.FILE
    found = kind.read(path)
    assert found.text() == path.read_text(encoding="utf-8")
    assert set(json.loads(path.read_text())) <= {
        f.key.partition(".")[0] for f in shape(kind)}
    again = tmp_path / kind.FILE
    again.write_text(found.text(), encoding="utf-8")
    assert kind.read(again).text() == found.text()


@pytest.mark.slow
def test_the_parts_hold_what_was_found(folders: Path) -> None:
    found = IdentificationRecord.read(folders / "both" / "identification.json")
    assert found.units.length == "mm" and found.covariance is not None
    assert len(found.covariance.matrix) == found.columns == len(found.covariance.names)
    shifts = {s.actuator: s for s in found.homing_shifts}
    assert shifts["leg3"].unit == "mm" and abs(shifts["leg3"].value or 0.0) > 0.2
    assert "homing offset of leg3" in " ".join(found.all_findings())
    assert found.provenance.command.startswith("ppmcal ")
    kept = IdentificationRecord.read(folders / "kept" / "identification.json")
    assert list(kept.earlier.values()) == ["sA/measurements.csv"]
    assert not IdentificationRecord.read(folders / "iA" / "identification.json").earlier
    truth = TruthRecord.read(folders / "sA" / "truth.json")
    assert truth.errors == pytest.approx({"leg1.offset": 0.3})
    moved = KinematicsRecord.read(folders / "tool" / "kinematics.json")
    assert (moved.tool, moved.tool_unit) == ((30.0, -15.0, 0.0), "mm")
    commands = CommandsRecord.read(folders / "cmd" / "commands.json")
    assert (commands.rows, commands.refused) == (3, 1)
    assert commands.units["sigma_rotation"] == "deg"


@pytest.mark.parametrize("kind", RECORDS, ids=lambda k: k.FILE)
def test_null_is_a_missing_key_and_other_kinds_are_refused(kind: type[Record], tmp_path: Path
                                                           ) -> None:
    path = tmp_path / kind.FILE
    objects = {f.key.partition(".")[0] for f in shape(kind)}
    within = {f.key.partition(".")[0]: {} for f in shape(kind) if "." in f.key}
    for f in shape(kind):
        name, _, key = f.key.partition(".")
        if key:
            within[name][key] = None
    for nulls in (dict.fromkeys(objects), dict.fromkeys(objects) | within):
        path.write_text(json.dumps(nulls | {"unheard_of": 1}))
        found, empty = kind.read(path), kind()
        assert all(getattr(found, f.name) == getattr(empty, f.name) for f in shape(kind))
    for f in shape(kind):
        name, _, key = f.key.partition(".")
        path.write_text(json.dumps({name: {key: [[[3]]]} if key else [[[3]]]}))
        with pytest.raises(BadInput, match=rf"{kind.FILE}: {re.escape(f.key)}.*should be"):
            kind.read(path)
    for name in within:
        path.write_text(json.dumps({name: 3}))
        with pytest.raises(BadInput, match=rf"{kind.FILE}: {name}: should be an object"):
            kind.read(path)


def test_numbers_that_cannot_be_calculated_with_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "identification.json"
    for text in ("NaN", "Infinity", "-1e31", "true", '"1"'):
        path.write_text(f'{{"parameters": [{{"name": "a", "value": {text}}}]}}')
        with pytest.raises(BadInput, match=r"parameters\[0\].value: should be a number"):
            IdentificationRecord.read(path)


def parts(kind: type) -> Iterator[type]:
    """Yield a record and all parts that it can hold."""
    yield kind
    for hint in get_type_hints(kind).values():
        for inner in inside(hint):
            if isinstance(inner, type) and is_dataclass(inner):
                yield from parts(inner)


def inside(annotation: Any) -> Iterator[Any]:
    yield annotation
    for inner in get_args(annotation):
        yield from inside(inner)


@pytest.mark.parametrize("kind", RECORDS, ids=lambda k: k.FILE)
def test_every_number_has_a_unit_or_is_bare_by_its_docstring(kind: type[Record]) -> None:
    for part in parts(kind):
        hints = get_type_hints(part)
        numbers = [name for name, hint in hints.items() if float in inside(hint)]
        said = part.__doc__ or ""
        if numbers:
            assert "unit" in hints or "unit" in said or "bare" in said, part
        for name in set(numbers) & set(BARE):
            assert name in said, (part, name)


def test_geometry_alone_that_is_worse_than_before_says_why() -> None:
    """By the rows that its own fit left out, else by what a fit weighs; nothing where it is not."""
    def size(rms: float) -> dict[str, ErrorSize]:
        return {"position": ErrorSize(rms=rms, unit="mm")}

    worse = ErrorStages(before=size(0.178), geometry=size(0.298), after=size(0.1))
    assert "geometry alone 0.298 mm (its fit weighs all that is" in worse.sizes(True)
    own = worse.changed(own_rows=size(0.102), left_out=12)
    assert ("geometry alone 0.298 mm (0.102 mm without the 12 rows that its own fit left out), "
            "with what was found 0.1 mm") in own.sizes(True)
    better = ErrorStages(before=size(0.298), geometry=size(0.178), after=size(0.1))
    assert "(" not in better.sizes(True)
