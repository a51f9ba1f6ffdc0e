"""The JSON Schemas of the files: valid, up to date, and of one mind with the readers."""

import json
from copy import deepcopy
from pathlib import Path

import pytest
from helpers.commands import ppmcal
from helpers.paths import ROOT
from jsonschema import Draft202012Validator

import ppmcal as face
from ppmcal.commands.schema.run import FILES, file_schema, results
from ppmcal.errors import BadInput
from ppmcal.io import read_mechanism
from ppmcal.io.yaml import read_yaml
from ppmcal.model.effects import effect_kinds
from ppmcal.model.limbs import kinds

SHIPPED = [*(ROOT / "configs").glob("*.yaml"), *(ROOT / "configs" / "scenarios").glob("*.yaml"),
           *(p for p in (ROOT / "sample_data").rglob("*.yaml"))]
HEXAPOD = read_yaml(ROOT / "configs" / "6-UPS.yaml")


def problems(name, content):
    """Return what a schema finds wrong with the content of a file."""
    return [f"{list(e.absolute_path)}: {e.message}"
            for e in Draft202012Validator(file_schema(name)).iter_errors(content)]


@pytest.mark.parametrize("name", FILES)
@pytest.mark.slow_cases("dataset", "scenario", "mechanism")
def test_a_schema_is_one(name):
    Draft202012Validator.check_schema(file_schema(name))


@pytest.mark.parametrize("name", FILES)
def test_the_shipped_schema_is_up_to_date(name):
    shipped = ROOT / "ppmcal" / "io" / "schemas" / f"{name}.json"
    assert json.loads(shipped.read_text()) == file_schema(name), "run `make generated`"


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_shipped_file_is_right_by_its_schema(path):
    content = read_yaml(path)
    assert not problems(content["format"].split("/")[1], content)


def broken(change):
    """Return the hexapod's file with something wrong in it."""
    content = deepcopy(HEXAPOD)
    change(content)
    return content


WRONG = {
    "an unknown key": lambda c: c.update(motoin="spatial"),
    "another motion": lambda c: c.update(motion="flying"),
    "another unit": lambda c: c["units"].update(length="furlong"),
    "an unknown kind": lambda c: c["limbs"][0].update(kind="U(P)Q"),
    "a slot of another kind": lambda c: c["limbs"][0].update(distal=100),
    "a word for a number": lambda c: c["limbs"][0].update(offset="long"),
    "an axis too many": lambda c: c["limbs"][0]["base"].update(point=[1, 2, 3, 4]),
    "a pose coordinate that is none": lambda c: c["home"]["pose"].update(w=1),
    "an effect that is none": lambda c: c.update(effects=[{"kind": "backslash"}]),
    "a parameter of another effect": lambda c: c.update(
        effects=[{"kind": "backlash", "parameters": {"stiffness": 1}}]),
    "no home": lambda c: c.pop("home"),
}


@pytest.mark.parametrize("change", WRONG.values(), ids=WRONG)
def test_what_the_reader_refuses_the_schema_refuses(change, tmp_path):
    content = broken(change)
    path = tmp_path / "m.yaml"
    path.write_text(json.dumps(content))
    with pytest.raises(BadInput):
        read_mechanism(path)
    assert problems("mechanism", content)


def test_a_file_that_extends_another_may_leave_out_what_is_there():
    assert not problems("mechanism", {"extends": "6-UPS.yaml",
                                      "limbs": [{"name": "leg1", "offset": 3}]})


def test_every_kind_is_known():
    definitions = file_schema("mechanism")["$defs"]
    assert {f"limb {name}" for name in kinds()} <= set(definitions)
    assert set(effect_kinds()) < set(definitions["Effect"]["properties"]["kind"]["enum"])


@pytest.mark.parametrize(("kind", "entry", "parameters"), [
    ("leg_thermal", {"from": "motion"}, {"growth": 1e-4, "tau": 60}),
    ("base_thermal", {"from": "motion"}, {"growth": 1e-4, "tau": 60}),
    ("base_compliance", {"about": "base"}, {"rx_mx": 1e-6, "x_my": 1e-6})])
def test_parameters_of_what_an_entry_makes_are_known(kind, entry, parameters):
    effects = [{"kind": kind, **entry, "parameters": parameters}]
    assert not problems("mechanism", broken(lambda c: c.update(effects=effects)))


@pytest.mark.parametrize("name", FILES)
def test_every_key_has_a_description(name):
    schema = file_schema(name)
    for key, part in schema["properties"].items():
        assert "description" in part or "$ref" in part, key


def test_the_command_prints_what_the_function_returns():
    run = ppmcal("schema", "scenario", expect=0)
    assert json.loads(run.out) == face.schema("scenario")
    assert json.loads(ppmcal("schema", "comparison", expect=0).out) == face.schema("comparison")
    assert "Did you mean 'scenario'?" in ppmcal("schema", "scenari", expect=2).err


@pytest.mark.parametrize("name", results())
@pytest.mark.slow_cases("diagnosis")
def test_every_result_has_a_schema(name):
    schema = face.schema(name)
    Draft202012Validator.check_schema(schema)
    assert schema["properties"]["format"] and schema["description"]


@pytest.mark.slow
def test_what_is_written_is_right_by_its_schema():
    sample = ROOT / "sample_data"
    fit = face.identify(sample / "hexapod.yaml", sample / "measurements.csv")
    for result, name in ((fit, "identification"),
                         (face.compensate(fit, sample / "targets.csv"), "commands")):
        written = json.loads(result.files()[f"{name}.json"])
        assert not list(Draft202012Validator(face.schema(name)).iter_errors(written))
    wrong = {**written, "rows": "many"}
    assert list(Draft202012Validator(face.schema("commands")).iter_errors(wrong))


def test_init_tells_editors_where_the_schema_is(tmp_path):
    ppmcal("init", "6-UPS", cwd=tmp_path, expect=0)
    for name, kind in (("6-UPS.yaml", "mechanism"), ("6-UPS.scenario.yaml", "scenario")):
        first = (tmp_path / name).read_text().split("\n", 1)[0]
        head, _, uri = first.partition("$schema=file://")
        assert head == "# yaml-language-server: "
        assert json.loads(Path(uri).read_text()) == file_schema(kind)
    assert read_mechanism(tmp_path / "6-UPS.yaml").name == "6-UPS"
