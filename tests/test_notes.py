"""A sentence has a level and a topic; nothing is decided from its words."""

from __future__ import annotations

import ast
import copy
import json
import pickle
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest
from helpers.sources import nodes_of

import ppmcal
from ppmcal.io.results.sensitivity import SensitivityRecord
from ppmcal.notes import (
    FINDING,
    NOTE,
    Note,
    about,
    has_findings,
    level_of,
    of_column,
    topic_of,
)

PACKAGE = Path(ppmcal.__file__).parent
ONE = Note("no tolerance is given for 'length'", NOTE, "no tolerance")


def test_a_note_is_its_text_wherever_one_is_wanted() -> None:
    assert ONE == "no tolerance is given for 'length'" and json.loads(json.dumps([ONE])) == [ONE]
    assert f"{ONE}." == "no tolerance is given for 'length'."
    assert (ONE.level, ONE.topic) == (NOTE, "no tolerance")
    assert (Note("x").level, Note("x").topic) == (FINDING, "")


def test_a_note_stays_as_it_is_made() -> None:
    with pytest.raises(AttributeError):
        ONE.level = FINDING
    for other in (pickle.loads(pickle.dumps(ONE)), copy.copy(ONE), copy.deepcopy(ONE)):
        assert (other, other.level, other.topic) == (ONE, NOTE, "no tolerance")


def test_a_record_keeps_levels_in_memory_and_writes_text() -> None:
    """The exit code of a command is that of the findings in its record."""
    record = SensitivityRecord(findings=(ONE, "odd"))
    assert [level_of(f) for f in record.findings] == [NOTE, FINDING]
    assert json.loads(record.text())["findings"] == [str(ONE), "odd"]
    again = SensitivityRecord.checked(json.loads(record.text()))
    assert again.findings == record.findings and type(again.findings[0]) is str


def test_levels_give_the_exit_code_and_a_bare_text_is_a_finding() -> None:
    assert not has_findings([]) and not has_findings([ONE])
    assert has_findings([ONE, "odd"]) and has_findings([Note("x")])


def test_what_is_asked_for_is_a_topic() -> None:
    place = of_column("run.csv", "q_leg1")
    said = [ONE, Note(f"{place}: odd", topic=place), "run.csv: column q_leg1: odd too"]
    assert about(said, (place,)) == said[1:2] and about(said, ("no tolerance",)) == [ONE]
    assert topic_of("bare") == ""


# --- no prefix and no part of a sentence decides ------------------------------------------------

SENTENCES = re.compile(r"^(t|f|text|note|notes|finding|findings|sentence|said|told|line|lines|"
                       r"message|what|why|reason|reasons|problem|error|mend|words|warning|verdict|"
                       r"label|model|title|caption)$")
"""What sentences are called in the package, and names that are written in words."""
ALLOWED = {
    # what another library says, which has no other way to tell its errors apart
    ("linalg.py", "'finite' not in str(error)"),
    ("io/yaml.py", "'recursive' in what"),
    # a name is not said twice
    ("calibration/fit/secondary_analyses.py", "reason.startswith(what)"),
    # how a line is laid out: the end of a sentence, a letter at its beginning
    ("commands/diagnose/run.py", "line.startswith('the ')"),
    # lines of files that controllers and instruments write
    ("controllers/klipper/lines.py", "line.startswith(SAVED)"),
    ("controllers/klipper/lines.py", "line.startswith(f'{SAVED} ')"),
    ("controllers/klipper/lines.py", "line.text.startswith(SAVED)"),
    ("controllers/maslow/reading.py", "_CLBM in line"),
    ("io/point_list.py", "'date' in line.lower().split()"),
    ("store/differences.py", "line.startswith('#*#')"),
    # columns of a table
    ("io/dataset_reader.py", "'pose' in table.text"),
    ("io/dataset_reader.py", "'session' in table.text"),
    ("io/dataset_reader.py", "'time' not in table.text"),
    ("io/foreign.py", "'time' in table.text"),
    ("io/join.py", "'pose' not in points.text"),
    # what is fitted per file
    ("calibration/fit/registration_freedoms.py", "'homing' in what"),
    # names: of models (ppmcal/io/results/validation.py), of columns of the fit, of effects
    ("io/results/validation.py", "model.startswith(WITHOUT)"),
    ("io/results/validation.py", "model.removeprefix(WITHOUT)"),
    ("diagnosis/other_days.py", "e.label.startswith('without')"),
}
"""Tests of words that decide nothing of what a sentence says, each with its place."""


def _last(node: ast.AST) -> str:
    """Return the name that an expression ends with: ``f`` of ``f``, ``what`` of ``error.what``."""
    if isinstance(node, ast.Call):
        inner = node.args[0] if node.args else getattr(node.func, "value", None)
        return _last(inner) if inner is not None else ""
    return getattr(node, "attr", "") or getattr(node, "id", "")


def _words(node: ast.AST) -> bool:
    """Whether it may be words: a text of more than a character, or a name that holds one."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, str) and len(node.value) > 1
    return isinstance(node, ast.JoinedStr | ast.Name | ast.Attribute)


def asked_words(tree: Iterable[ast.AST]) -> Iterator[str]:
    """Yield expressions that ask for words in what is called like a sentence."""
    for node in tree:
        if isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.In | ast.NotIn):
            name = _last(node.comparators[0])
            if SENTENCES.match(name) and _words(node.left) and not (
                    isinstance(node.left, ast.Name) and not node.left.id.isupper()):
                yield ast.unparse(node)
        if (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
                and node.func.attr in ("startswith", "endswith", "removeprefix", "removesuffix")
                and SENTENCES.match(_last(node.func.value)) and _words(node.args[0])
                and not isinstance(node.func.value, ast.Call)):
            yield ast.unparse(node)


def found() -> set[tuple[str, str]]:
    return {(path.relative_to(PACKAGE).as_posix(), text) for path in PACKAGE.rglob("*.py")
            for text in asked_words(nodes_of(path))}


def test_nothing_is_decided_from_the_words_of_a_sentence() -> None:
    there = found()
    assert not there - ALLOWED
    assert not ALLOWED - there, "no longer there: take it off the list"


@pytest.mark.parametrize("code", [
    "if 'left out' in t: pass", "any('noise' in t for t in out)", "f.startswith(NOTE)",
    "'match' not in error.what", "x = [p for p in q if p.problem.startswith('left out')]",
    "f'{source} noise' in finding", "any(FAR in t for t in out)", "'finite' in str(error)"])
def test_a_test_of_words_is_seen(code: str) -> None:
    assert list(asked_words(ast.walk(ast.parse(code))))


# --- who makes a sentence says what it is -------------------------------------------------------

ENGINE = ("calibration", "diagnosis", "inference", "design", "simulation", "kinematics", "model")
CARRY = ("findings", "notes", "odd", "advice", "given_up")
"""What is called so, of results and in functions, carries sentences."""


def bare_sentences(tree: Iterable[ast.AST]) -> Iterator[str]:
    """Yield texts that become a finding or a note without a level."""
    def texts(node: ast.AST) -> Iterator[str]:
        if isinstance(node, ast.List | ast.Tuple):
            for one in node.elts:
                yield from texts(one)
        elif isinstance(node, ast.ListComp | ast.GeneratorExp):
            yield from texts(node.elt)
        elif isinstance(node, ast.IfExp):
            yield from (*texts(node.body), *texts(node.orelse))
        elif isinstance(node, ast.JoinedStr) or (
                isinstance(node, ast.Constant) and " " in str(node.value)):
            yield ast.unparse(node)

    for node in tree:
        into: list[ast.AST] = []
        if isinstance(node, ast.Assign | ast.AnnAssign | ast.AugAssign):
            into = node.targets if isinstance(node, ast.Assign) else [node.target]
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "append":
            into = [node.func.value]
        if any(_last(name) in CARRY for name in into):
            value = node.args[0] if isinstance(node, ast.Call) else node.value
            yield from texts(value) if value is not None else ()
        for key in getattr(node, "keywords", ()):
            if key.arg in CARRY:
                yield from texts(key.value)


@pytest.mark.slow
def test_findings_and_notes_have_a_level_where_they_are_made() -> None:
    bare = {(path.relative_to(PACKAGE).as_posix(), text) for path in PACKAGE.rglob("*.py")
            for text in bare_sentences(nodes_of(path))}
    assert not bare


def of_engines() -> Iterator[tuple[str, ast.AST]]:
    """Yield the syntax of the engine packages, each piece with its file."""
    for package in ENGINE:
        for path in (PACKAGE / package).rglob("*.py"):
            for node in nodes_of(path):
                yield path.relative_to(PACKAGE).as_posix(), node


@pytest.mark.long
def test_what_carries_sentences_of_engines_is_declared_to_hold_notes() -> None:
    """So mypy finds whoever puts a bare text there, however it is made."""
    declared = [(path, node.lineno, ast.unparse(node.annotation)) for path, node in of_engines()
                if ((isinstance(node, ast.AnnAssign) and _last(node.target) in CARRY)
                    or (isinstance(node, ast.arg) and node.arg in CARRY)) and node.annotation]
    assert len(declared) > 20 and not [d for d in declared if "Note" not in d[2]]


@pytest.mark.slow
def test_a_note_of_an_engine_says_what_it_is_about() -> None:
    made = [(path, node) for path, node in of_engines()
            if isinstance(node, ast.Call) and _last(node.func) == "Note"]
    assert len(made) > 60
    assert not [(path, ast.unparse(node)) for path, node in made if len(node.args) < 3
                and "topic" not in {key.arg for key in node.keywords}]


@pytest.mark.parametrize(("code", "count"), [
    ("findings.append(f'{x} is odd')", 1), ("notes = ['it is so'] if x else []", 1),
    ("f(findings=('it is so',))", 1), ("notes: list = [f'{n} is so' for n in x]", 1),
    ("notes += [Note('it is so')]", 0), ("findings = list(other)", 0), ("notes = ''", 0)])
def test_a_bare_sentence_is_seen(code: str, count: int) -> None:
    assert len(list(bare_sentences(ast.walk(ast.parse(code))))) == count
