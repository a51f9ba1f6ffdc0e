"""Rates that the docs state are of this version's engine and of seeds that nobody had looked at."""

from __future__ import annotations

import ast
import json
import re
from dataclasses import replace

import pytest
from diagnosis_study import reliability
from helpers.paths import ROOT
from hidden import Options, hide
from rates.digest import engine_digest, pieces_of
from rates.studies import AFTERWARDS, STUDIES, filled
from rates.tables import FOLDER, TABLES
from study_runner import read

from ppmcal.calibration.fit.problem import Problem
from ppmcal.diagnosis import diagnose, learned_terms

BY_NAME = {s.name: s for s in STUDIES}
MADE = re.compile(r"Version \S+, engine (\w{12}) \([\w/, ]+\), seeds? ([\d, ]+)")
RATE = re.compile(r"\d %? ?\(\d+(\.\d+)? ?(-|to) ?\d+(\.\d+)?\)")
NOT_YET = "Not yet measured for this version: `make rates` does it."
"""What stands in a table's place until it has been."""
PLACES = [(study.name, page, name) for study in STUDIES for page, names in study.pages.items()
          for name in names]


def block(page: str, name: str) -> str:
    text = (ROOT / page).read_text(encoding="utf-8")
    return text.split(f"<!-- rates: {name} -->")[1].split("<!-- end of rates -->")[0]


@pytest.mark.slow_cases(
    "diagnosis-docs/diagnosis.md-rates", "plan-docs/plan.md-plan",
    "intervals-docs/campaigns.md-intervals",
    "ropes-coverage-docs/without-instrument.md-ropes-coverage")
@pytest.mark.parametrize(("study", "page", "name"), PLACES)
def test_the_engine_has_not_changed_since_the_study(study, page, name):
    """``make rates`` with seeds that nobody has looked at; then list the old ones as looked at."""
    made = MADE.search(block(page, name))
    digest = made[1] if made else ""
    assert digest == BY_NAME[study].digest or block(page, name).strip() == NOT_YET


@pytest.mark.parametrize(("study", "page", "name"), PLACES)
def test_no_seed_of_a_study_had_been_looked_at(study, page, name):
    text = (ROOT / "docs/diagnosis.md").read_text(encoding="utf-8")
    looked = text[text.index("Seeds that were looked at"):].split("\n\n")[0]
    if "diagnosis" in BY_NAME[study].engine:
        looked += text[text.index("Looked at in these three generators"):].split("\n\n")[0]
    spans = [(int(a), int(b or a)) for a, b in re.findall(r"(\d+)(?: to (\d+))?", looked)]
    made = MADE.search(block(page, name))
    for seed in made[2].split(",") if made else ():
        assert not any(a <= int(seed) <= b for a, b in spans), seed


@pytest.mark.parametrize("name", list(TABLES))
def test_a_table_is_that_of_its_campaigns(name):
    if not (FOLDER / "about.json").exists():
        table = NOT_YET
    else:
        about = json.loads((FOLDER / "about.json").read_text(encoding="utf-8"))
        table = TABLES[name](read(FOLDER / "campaigns.csv"), about)
    for page, names in BY_NAME["diagnosis"].pages.items():
        if name in names:
            assert block(page, name).strip() == table.strip()


@pytest.mark.parametrize("page", sorted({page for _, page, _ in PLACES}))
def test_no_table_of_rates_of_another_version_stands_beside_them(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    for _, where, name in PLACES:
        if where == page:
            text = filled(text, name, "")
    assert not [line for line in text.splitlines() if line.startswith("|") and RATE.search(line)]


@pytest.mark.long
def test_what_runs_afterwards_changes_no_verdict_and_no_name(monkeypatch: pytest.MonkeyPatch
                                                             ) -> None:
    """Its code is not in the digest either: it only tells sizes of what was named."""
    made = hide("3-RPR", 7, ["backlash"], 2.0, Options(poses=30), "all")
    count = len(made.dataset)
    days = tuple("am" if n < count // 2 else "pm" for n in range(count))
    problem = Problem(made.mechanism, (replace(made.dataset, sessions=days),), made.mechanism.free)
    whole = diagnose.diagnose(problem)
    assert whole.effects and all(e.sessions is not None for e in whole.effects)
    module = diagnose.with_sessions.__module__.removeprefix("ppmcal.").replace(".", "/")
    assert ("diagnosis/equations.py", f"{module}.py") == AFTERWARDS
    monkeypatch.setattr(diagnose, "with_sessions", lambda fit, effects: (effects, []))
    monkeypatch.setattr(learned_terms, "equations", lambda seen, terms: (None,) * len(terms.terms))
    without = diagnose.diagnose(problem)
    assert without.verdict == whole.verdict and without.suspected == whole.suspected
    assert without.effects == tuple(replace(e, sessions=None) for e in whole.effects)


def test_reliability_is_of_kinds_with_a_probability():
    """One of several joints is told once; the same kind on others is the same kind."""
    lag = ("lag", 0.6, [("gain", 0.1), ("lag", 0.25)])
    assert reliability([("play", None, []), lag, lag, ("gain", 0.5, [])], {"lag"}) == (
        "0.8500:1 0.5000:0")


def test_the_digest_sees_code_and_no_words():
    plain = "LIMIT = 3\ndef f(a):\n    return a + LIMIT\n"
    told = ('"""Of f."""\n\nLIMIT = 3\n"""Of what."""\n\n'
            'def f(a: float) -> float:  # adds\n    "Doc."\n    return a + LIMIT\n')
    assert pieces_of(plain) == pieces_of(told)
    assert pieces_of(plain) != pieces_of(plain.replace("3", "4"))
    says = 'def f(a):\n    raise ValueError(f"there is no {a}", "n")\n'
    assert pieces_of(says) == pieces_of(says.replace("there is no", "found neither it nor"))
    assert pieces_of(says) != pieces_of(says.replace('"n"', '"m"'))
    assert pieces_of("class A:\n    n: int\n") != pieces_of("class A:\n    m: int\n")
    out = 'out = list[str]()\nout.append(f"there is no {x}")\n'
    assert pieces_of(out) == pieces_of(
        'out = list[Note]()\nout.append(Note(f"there is never any {x}", NOTE, topic="few"))\n')
    assert pieces_of(out) != pieces_of(out.replace("append", "remove"))


@pytest.mark.parametrize("package", sorted({p for s in STUDIES for p in s.engine}))
@pytest.mark.slow_cases("calibration")
def test_no_engine_compares_a_sentence(package):
    """So that what a sentence says decides nothing."""
    for path in (ROOT / "ppmcal" / package).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Compare):
                said = [c.value for c in (node.left, *node.comparators)
                        if isinstance(c, ast.Constant)]
                assert not [t for t in said if isinstance(t, str) and len(t.split()) > 2], path


def test_the_digest_sees_what_is_imported_under_which_name_and_not_from_where():
    plain = "from ppmcal.calibration.fit import a, c as b\nx = a + b\n"
    moved = ("from ppmcal.calibration.fit.one import c as b\n"
             "from ppmcal.linalg import a\nx = a + b\n")
    assert pieces_of(plain) == pieces_of(moved)
    for other in (plain.replace("c as b", "d as b"), plain.replace("ppmcal", "numpy")):
        assert pieces_of(other) != pieces_of(plain)


def test_a_definition_that_moves_to_another_module_is_the_same(tmp_path, monkeypatch):
    one, two = "LIMIT = 3\n", "def f(a):\n    return a + LIMIT\n"
    digests = []
    for name, texts in (("before", (one + two, "")), ("after", (one, two)),
                        ("other", (one, two.replace("+", "-")))):
        for module, text in zip(("a", "b"), texts, strict=True):
            (tmp_path / name / "engine").mkdir(parents=True, exist_ok=True)
            (tmp_path / name / "engine" / f"{module}.py").write_text(text)
        monkeypatch.setattr("rates.digest.PACKAGE", tmp_path / name)
        digests.append(engine_digest(("engine",)))
    assert digests[0] == digests[1] != digests[2]
