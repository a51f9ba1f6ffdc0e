"""The manifest of a batch: what it stands for, and what is refused with file, place and hint."""

from copy import deepcopy

import pytest
from helpers.commands import ppmcal
from jsonschema import Draft202012Validator

from ppmcal.commands.batch.manifest import read_manifest
from ppmcal.commands.schema.run import file_schema
from ppmcal.errors import BadInput
from ppmcal.io.yaml import dump_yaml

GOOD = {"format": "ppmcal/batch/1", "model": "models/{machine}.yaml",
        "options": {"identify": {"seed": 3}, "diagnose": {"holdout": 0.3}},
        "campaigns": [{"data": "runs/{machine}/{date}/*.csv"}]}


@pytest.fixture
def folder(tmp_path):
    """A folder with measurement files of two machines on two dates, and one of another kind."""
    for path in ("h1/2026-01-02/a.csv", "h1/2026-01-02/b.csv", "h1/2026-02-03/a.csv",
                 "h2/2026-01-02/a.csv", "h2/2026-01-02/notes.txt"):
        file = tmp_path / "runs" / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    return tmp_path


def written(folder, content):
    path = folder / "fleet.yaml"
    path.write_text(dump_yaml(content))
    return path


def test_a_pattern_stands_for_each_machine_and_date(folder):
    found = read_manifest(written(folder, GOOD))
    assert [(c.name, c.model, c.data) for c in found] == [
        ("h1/2026-01-02/identify", "models/h1.yaml",
         ("runs/h1/2026-01-02/a.csv", "runs/h1/2026-01-02/b.csv")),
        ("h1/2026-02-03/identify", "models/h1.yaml", ("runs/h1/2026-02-03/a.csv",)),
        ("h2/2026-01-02/identify", "models/h2.yaml", ("runs/h2/2026-01-02/a.csv",))]
    assert all(c.options == (("seed", 3),) for c in found)


def test_a_pattern_of_one_machine_finds_its_dates_alone(folder):
    entry = {"machine": "h1", "data": "runs/{machine}/{date}/a.csv", "command": "diagnose",
             "options": {"kind": ["backlash", "gain"]}, "name": "play"}
    found = read_manifest(written(folder, GOOD | {"campaigns": [entry]}))
    assert [c.name for c in found] == ["h1/2026-01-02/play", "h1/2026-02-03/play"]
    assert dict(found[0].options) == {"holdout": 0.3, "kind": ("backlash", "gain")}
    assert found[0].typed("out").endswith(
        "runs/h1/2026-01-02/a.csv --holdout 0.3 --kind backlash --kind gain --out out")


def test_a_compensation_may_assume_conditions_and_judge_targets_alone(folder):
    entry = named(command="compensate", options={"path": False, "assume": {"temperature": 22.5}})
    job, = read_manifest(written(folder, GOOD | {"campaigns": [entry]}))
    assert job.typed("out").endswith("a.csv --no-path --assume temperature=22.5 --out out")
    entry["options"] = {"path": True}
    job, = read_manifest(written(folder, GOOD | {"campaigns": [entry]}))
    assert job.typed("out").endswith("a.csv --out out")


def named(**entry):
    return {"machine": "h1", "date": "2026-01-02", "data": "a.csv"} | entry


BROKEN = {
    "an unknown key": (lambda c: c.update(comand="identify"), "", "unknown key 'comand'",
                       "Did you mean 'command'?"),
    "another format": (lambda c: c.update(format="ppmcal/scenario/1"), ": format",
                       "unknown format", "ppmcal/batch/1"),
    "no campaign": (lambda c: c.update(campaigns=[]), ": campaigns", "no campaign is listed",
                    "Add one"),
    "a command that is none": (lambda c: c["campaigns"][0].update(command="simulate"),
                               ": campaigns[1].command", "unknown command", "identify, diagnose"),
    "no model": (lambda c: c.pop("model"), ": campaigns[1]", "the key 'model' is missing",
                 "model: machine.yaml"),
    "no data": (lambda c: c["campaigns"].append({"machine": "h1"}), ": campaigns[2]",
                "the key 'data' is missing", "Add a line such as"),
    "no machine": (lambda c: c["campaigns"].append({"date": "2026-01-02", "data": "a.csv"}),
                   ": campaigns[2]", "the key 'machine' is missing", "write {machine}"),
    "a date that is none": (lambda c: c["campaigns"].append(named(date="14.3.2026")),
                            ": campaigns[2].date", "is not a date", "2026-03-14"),
    "a machine that is no folder": (lambda c: c["campaigns"].append(named(machine="../x")),
                                    ": campaigns[2].machine", "cannot be the name of a folder",
                                    "Use letters"),
    "a pattern that fits nothing": (
        lambda c: c["campaigns"].append({"data": "walks/{machine}/{date}.csv"}),
        ": campaigns[2].data", "no file fits walks/", "Check the pattern"),
    "an unknown option": (lambda c: c["options"]["identify"].update(hold_out=0.3),
                          ": options.identify", "unknown key 'hold_out'", "'holdout'"),
    "an option of another command": (lambda c: c["campaigns"][0].update(options={"png": True}),
                                     ": campaigns[1].options", "unknown key 'png'", "Allowed"),
    "an option of another kind": (lambda c: c["options"]["diagnose"].update(holdout="many"),
                                  ": options.diagnose.holdout", "number", ""),
    "two targets": (lambda c: c["campaigns"].append(
        named(command="compensate", data=["a.csv", "b.csv"])), ": campaigns[2].data",
        "one file of targets", "Name one CSV"),
    "twice the same": (lambda c: c["campaigns"].append(named()), ": campaigns[2]",
                       "h1/2026-01-02/identify, as those of campaigns[1]", "Give one of them"),
}


@pytest.mark.parametrize("change, place, what, mend", BROKEN.values(), ids=BROKEN)
def test_what_is_wrong_is_named_with_file_place_and_mend(folder, change, place, what, mend):
    content = deepcopy(GOOD)
    change(content)
    path = written(folder, content)
    with pytest.raises(BadInput) as refused:
        read_manifest(path)
    assert refused.value.where == f"{path}{place}"
    assert what in refused.value.what
    assert mend in refused.value.hint


def test_a_date_within_a_path_is_checked_too(folder):
    (folder / "runs" / "h1" / "spring").mkdir()
    (folder / "runs" / "h1" / "spring" / "a.csv").touch()
    with pytest.raises(BadInput) as refused:
        read_manifest(written(folder, GOOD))
    assert refused.value.where == "runs/h1/spring/a.csv: date"


def test_the_command_refuses_before_it_begins(folder):
    path = written(folder, GOOD | {"command": "plan"})
    run = ppmcal("batch", path, "--out", folder / "results", expect=2)
    assert "fleet.yaml: command" in run.err.replace("\n", "")
    assert not (folder / "results").exists()


IN_SCHEMA = [n for n in BROKEN if n in (
    "an unknown key", "another format", "no campaign", "a command that is none", "no data",
    "an unknown option")]


@pytest.mark.parametrize("name", IN_SCHEMA)
def test_the_schema_refuses_it_too(name):
    validator = Draft202012Validator(file_schema("batch"))
    assert not list(validator.iter_errors(GOOD))
    content = deepcopy(GOOD)
    BROKEN[name][0](content)
    assert list(validator.iter_errors(content))
