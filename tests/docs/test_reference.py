"""The reference leaves nothing out: keys, commands, functions, limb kinds, effects."""

from __future__ import annotations

import inspect
import re

import click
import pytest
import yaml
from generators import api, commands, keys, kinds
from generators.mathml import with_formulas
from helpers.paths import ROOT
from jsonschema import Draft202012Validator

import ppmcal
from ppmcal.cli import cli
from ppmcal.commands import names
from ppmcal.commands.schema.run import FILES, file_schema
from ppmcal.model.effects import effect_kinds
from ppmcal.model.limbs import kinds as limb_kinds
from ppmcal.model.motions import motions

EFFECTS_PAGE = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
OF_MOTION = {"spatial": "6-UPS", "translational": "delta-linear", "planar": "3-RPR"}
MADE_OF = {"turning": "delta-rotary", "ropes": "cable-4-planar"}


def undescribed(node, where):
    """Yield the keys of a schema without a description, but for conditions on kinds."""
    if isinstance(node, list):
        for i, one in enumerate(node):
            yield from undescribed(one, f"{where}[{i}]")
    if isinstance(node, dict):
        for key, one in node.get("properties", {}).items():
            if "description" not in one and not re.search(r"allOf\[\d+\]\.(if|then)$", where):
                yield f"{where}.{key}"
        for key, one in node.items():
            if key not in ("default", "enum"):
                yield from undescribed(one, f"{where}.{key}")


@pytest.mark.parametrize("name", FILES)
def test_every_key_of_a_schema_is_described(name):
    assert list(undescribed(file_schema(name), name)) == []


def test_the_search_for_descriptions_finds_what_lacks_one():
    assert list(undescribed({"properties": {"a": {"properties": {"b": {}},
                                                  "description": "A."}}}, "s")) == [
        "s.properties.a.b"]


@pytest.mark.parametrize("name", FILES)
@pytest.mark.slow_cases("mechanism", "scenario")
def test_every_key_has_an_example_that_the_page_shows(name):
    page = keys.key_page(name)
    for part, schema in keys.parts(name):
        for key in schema["properties"]:
            assert keys.example(name, part, key) != "", f"{name}: {part or 'the file'}: {key}"
            assert f"| `{key}` |" in page
    for part in {*keys.EXAMPLES[name]}:
        gone = {*keys.EXAMPLES[name][part]} - {*dict(keys.parts(name))[part]["properties"]}
        assert not gone, f"{part}: there is no {gone}"


@pytest.mark.parametrize("name", FILES)
def test_the_examples_of_a_file_are_right_by_its_schema(name):
    whole = {k: keys.EXAMPLES[name][""][k] for k in keys.WHOLE[name].split()}
    assert [e.message for e in Draft202012Validator(file_schema(name)).iter_errors(whole)] == []


def test_the_example_of_a_mechanism_is_one():
    whole = {k: keys.EXAMPLES["mechanism"][""][k] for k in keys.WHOLE["mechanism"].split()}
    assert ppmcal.check(ppmcal.load(whole)).findings == ()


def test_every_command_has_its_section_with_help_options_and_examples():
    page = commands.command_page()
    for name in names():
        section = re.search(rf"^## {name}$(.*?)(?=^## )", page, re.M | re.S)[1]
        command = cli.get_command(click.Context(cli), name)
        assert f"\nppmcal {name}" in section.partition("Examples:")[2], name
        for option in (p for p in command.params if isinstance(p, click.Option)):
            # what only tells a gone option's successors is no option to show
            assert (f"`{option.opts[0]}" in section) != option.hidden, (name, option.opts)
            assert option.help, (name, option.opts)
    assert all(f"| {code} |" in page for code in (0, 1, 2, 3))


def test_every_public_name_has_a_docstring_and_a_place_on_the_page():
    page = api.api_page()
    for name in ppmcal.__all__:
        thing = getattr(ppmcal, name)
        assert inspect.getdoc(thing), name
        assert f"### {name}\n" in page, name
        if inspect.isfunction(thing):
            told = api.docstring(thing)
            for parameter in inspect.signature(thing).parameters:
                assert f"{parameter}`" in told, f"{name}: {parameter} is not described"


@pytest.mark.long
def test_every_limb_kind_has_its_section():
    page = kinds.limb_page()
    for kind in limb_kinds().values():
        assert f"## {kind.name} {{ #{kinds.anchor_of(kind)} }}" in page
        assert all(f"| `{slot.name}` |" in page for slot in kind.slots)
    anchors = [kinds.anchor_of(k) for k in limb_kinds().values()]
    assert len(set(anchors)) == len(anchors)


@pytest.mark.slow
def test_every_effect_is_in_the_table_and_has_its_section_and_example():
    sections = kinds.effect_sections()
    table = [line for line in EFFECTS_PAGE.splitlines() if line.startswith("| ")]
    for name, kind in effect_kinds().items():
        assert any(name in line.split("|")[1] for line in table), name
        assert f"### {name}\n" in sections
        assert name in kinds.EXAMPLES, f"docs/generators/examples.yaml lacks an example of {name}"
        motion = next(m for m in OF_MOTION if kind.exists_in(motions()[m]))
        read_effect(name, MADE_OF.get(kind.joints, OF_MOTION[motion]))


def read_effect(name, machine):
    """Read a machine with the example of an effect, on its own second joint."""
    content = yaml.safe_load((ROOT / "configs" / f"{machine}.yaml").read_text(encoding="utf-8"))
    raw = {"kind": name, **kinds.EXAMPLES[name]}
    if "on" in raw:
        raw["on"] = [ppmcal.load(content).actuators[1]]
    ppmcal.load({**content, "effects": [raw]})


def test_formulas_become_mathml_and_code_stays():
    out = with_formulas("a $u^2$ b `$x$`\n\n$$\nc = 0\n$$\n\n```\n$ ppmcal init\n```\n")
    assert out.count("<math") == 2
    assert "`$x$`" in out
    assert "$ ppmcal init" in out
    assert "costs $5 and $6" in with_formulas("costs $5 and $6")


def test_every_page_is_in_the_contents():
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    named = set(re.findall(r": ([\w/-]+\.md)$", text, re.M))
    written = {path.name for path in (ROOT / "docs").glob("*.md")}
    made = {f"reference/{name}.md" for name in (*FILES, "commands", "limbs", "python")}
    assert named == written | made | {"calibration.md", "changes.md"}
