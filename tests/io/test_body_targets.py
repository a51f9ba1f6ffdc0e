"""Several targets of one body in one file: long, wide, or a file for each; all mean the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.bodies import MARKS, listed, long, machine, measured, several, sidecar, wide

import ppmcal
from ppmcal.calibration.validation.residual_vectors import split
from ppmcal.errors import BadInput
from ppmcal.model.dataset import Dataset
from ppmcal.model.sessions import pose_labels, session_masks
from ppmcal.notes import NOTE, level_of


def read(folder: Path, *paths: Path) -> tuple[Dataset, ...]:
    return ppmcal.read_data(machine(folder), *paths)


def nudged(row: str, by: float) -> str:
    """A row of a table measured anew: its last cell is another one."""
    *others, last = row.split(",")
    return ",".join([*others, repr(float(last) + by)])


@pytest.mark.long
def test_long_wide_and_several_files_are_one_campaign_with_one_frame(tmp_path: Path) -> None:
    seen = measured(3, rows=20)
    forms = [[wide(tmp_path, seen)], [long(tmp_path, seen)], several(tmp_path, seen)]
    found = []
    for paths in forms:
        data = read(tmp_path, *paths)
        assert [d.name for d in data] == [f"body {n}" for n in MARKS]
        for d, marks in zip(data, seen.marks.values(), strict=True):
            assert d.target.fitted and d.frame.fitted
            assert d.position[:, :2] * 1e3 == pytest.approx(marks, rel=1e-12)
        assert [d.frame.same_as for d in data] == [None, "body T1", "body T1"]
        assert len(session_masks(data)) == 1
        held = split(data, 0.3, 5)
        assert all(np.array_equal(held[0], h) for h in held) and held[0].any()
        labels = pose_labels(data)
        assert all(np.array_equal(labels[0], own) for own in labels)
        found.append(ppmcal.identify(tmp_path / "bench.yaml", paths).to_frame()["value"].to_numpy())
    assert found[0] == pytest.approx(found[1], rel=1e-9)
    assert found[0] == pytest.approx(found[2], rel=1e-9)


def test_a_scale_that_targets_of_one_file_share_is_told_once(tmp_path: Path) -> None:
    path = long(tmp_path, measured(3, rows=20))
    with path.with_suffix(".yaml").open("a") as sidecar_file:
        sidecar_file.write("scale: unknown\n")
    found = ppmcal.identify(machine(tmp_path), path)
    (said,) = [note for note in found.notes if "readings come out" in note]
    assert said.startswith("body T1: ") and not any("left out" in f for f in found.findings)


def test_one_body_is_one_session_called_by_its_file(tmp_path: Path) -> None:
    (label, _), = session_masks(read(tmp_path, long(tmp_path, measured(3, rows=12))))
    assert label == "body"


def test_rows_of_a_long_file_are_one_time_line(tmp_path: Path) -> None:
    one, two, three = read(tmp_path, long(tmp_path, measured(3, rows=12)))
    assert one.numbers()[:2].tolist() == [1, 4] and three.numbers()[:2].tolist() == [3, 6]
    assert one.stands is not None and two.stands is not None
    assert np.array_equal(one.stands, two.stands)


def test_what_is_measured_again_at_one_stand_is_another_one(tmp_path: Path) -> None:
    path = long(tmp_path, measured(3, rows=12))
    head, *rows = path.read_text().splitlines()
    # at each pose T1, T2, T3, then T1 once more, and T1 of the whole tour at its end
    again = [line for i, row in enumerate(rows) for line in (
        [row] if i % 3 < 2 else [row, nudged(rows[i - 2], 0.004)])]
    path.write_text("\n".join([head, *again, *(nudged(r, -0.006) for r in rows[::3])]) + "\n")
    one, two, _ = read(tmp_path, path)
    assert one.stands is not None and two.stands is not None
    shared = np.isin(one.stands, two.stands)
    assert shared.sum() == 12 and len(one) == 36 and np.unique(one.stands).size == 36
    assert np.unique(one.groups).size == 12


@pytest.mark.parametrize("spelt", ["{name}_{axis} [mm]", "{name}.{axis} (mm)", "{axis}_{name} [mm]",
                                   "{axis}{name}", "{name} {axis}"])
def test_wide_columns_may_be_spelt_as_people_do(tmp_path: Path, spelt: str) -> None:
    seen = measured(4, rows=12)
    data = read(tmp_path, wide(tmp_path, seen, spelt=spelt))
    for d, marks in zip(data, seen.marks.values(), strict=True):
        assert d.position[:, :2] * 1e3 == pytest.approx(marks, rel=1e-12)


def test_units_and_names_of_wide_columns_are_those_of_the_sidecar(tmp_path: Path) -> None:
    seen = measured(4, rows=12)
    plain = wide(tmp_path, seen, spelt="{name}{axis}")
    more = "read:\n  units: {T1*: in, T2x: m}\n  columns: {T3_x: east}\n  signs: {T2y: -1}\n"
    text = plain.read_text()
    plain.write_text(text.replace("T3x", "east"))
    (tmp_path / "wide.yaml").write_text(sidecar("body", listed(list(MARKS)), more=more))
    one, two, three = read(tmp_path, plain)
    assert one.position[:, :2] * 1e3 == pytest.approx(25.4 * seen.marks["T1"], rel=1e-12)
    assert two.position[:, :2] == pytest.approx(seen.marks["T2"] * [1.0, -1e-3], rel=1e-12)
    assert three.position[:, :2] * 1e3 == pytest.approx(seen.marks["T3"], rel=1e-12)


def test_a_known_target_is_taken_as_it_stands(tmp_path: Path) -> None:
    path = wide(tmp_path, measured(4, rows=12))
    (tmp_path / "wide.yaml").write_text(sidecar(
        "body", "targets: {T1: [40, -15], T2: known, T3: unknown}"))
    one, two, three = read(tmp_path, path)
    assert one.target.value == pytest.approx([0.04, -0.015, 0.0]) and not one.target.fitted
    assert not two.target.fitted and not two.target.value.any() and three.target.fitted


def test_a_mark_that_was_hidden_is_told_and_keeps_its_rows(tmp_path: Path) -> None:
    path = wide(tmp_path, measured(4, rows=12))
    rows = [line.split(",") for line in path.read_text().splitlines()]
    for n in (3, 7):
        rows[n][6] = rows[n][7] = ""
    path.write_text("\n".join(",".join(r) for r in rows) + "\n")
    one, two, three = read(tmp_path, path)
    assert [len(d) for d in (one, two, three)] == [12, 10, 12]
    assert np.array_equal(two.numbers(), np.setdiff1d(one.numbers(), [3, 7]))
    (note,) = two.findings
    assert "rows 3, 7" in note and "T2" in note and level_of(note) == NOTE
    labels = pose_labels([one, two])
    assert np.array_equal(labels[1], np.delete(labels[0], [2, 6]))


@pytest.mark.parametrize(("edit", "what"), [
    (lambda y: y.replace("T2: unknown", "T9: unknown"), "T9"),
    (lambda y: y.replace("T2: unknown, ", ""), "T2"),
    (lambda y: y + "target: unknown\n", "target"),
    (lambda y: y.replace("targets: {T1: unknown, T2: unknown, T3: unknown}", "targets: 3"), "3"),
    (lambda y: y.replace("T2: unknown", "T2: [1]"), "targets.T2"),
    (lambda y: y.replace("targets: {T1: unknown, T2: unknown, T3: unknown}", "target: unknown"),
     "targets: {T1: unknown, T2: unknown, T3: unknown}")])
def test_what_file_and_sidecar_do_not_agree_in_is_refused(tmp_path: Path, edit, what) -> None:  # type: ignore[no-untyped-def]
    seen = measured(4, rows=12)
    for path in (wide(tmp_path, seen), long(tmp_path, seen)):
        side = path.with_suffix(".yaml")
        side.write_text(edit(side.read_text()))
        if "T9" in what or "T2" not in what or path.stem == "long" or "targets" in what:
            with pytest.raises(BadInput) as error:
                read(tmp_path, path)
            assert what in str(error.value) and error.value.hint


def test_a_row_that_names_no_target_is_refused_with_its_place(tmp_path: Path) -> None:
    path = long(tmp_path, measured(4, rows=12))
    text = path.read_text().splitlines()
    text[5] = text[5].replace("T2", "")
    path.write_text("\n".join(text) + "\n")
    with pytest.raises(BadInput) as error:
        read(tmp_path, path)
    assert "row 5, column target" in error.value.where


def test_numbers_and_other_headings_name_targets_too(tmp_path: Path) -> None:
    path = long(tmp_path, measured(4, rows=12), column="Reflector")
    path.write_text(path.read_text().replace("T", ""))
    (tmp_path / "long.yaml").write_text(sidecar("body", "targets: {1: unknown, 2: unknown, "
                                                        "3: unknown}"))
    assert [d.mark for d in read(tmp_path, path)] == ["1", "2", "3"]


def test_tables_in_memory_have_targets_as_files_have(tmp_path: Path) -> None:
    seen = measured(4, rows=12)
    columns = {f"q_leg{i + 1}": seen.q[:, i] for i in range(3)} | {
        f"{n}_{c}": m[:, i] for n, m in seen.marks.items() for i, c in enumerate("xy")}
    found = ppmcal.read_data(machine(tmp_path), columns, sidecar={
        "instrument": {"kind": "position", "sigma": {"position": 0.01}},
        "targets": dict.fromkeys(MARKS, "unknown")})
    assert [d.mark for d in found] == list(MARKS)
