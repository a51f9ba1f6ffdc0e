"""Cases of the labelled benchmark: read, refused, spoilt by hand, and scored."""

from __future__ import annotations

import csv
import re

import numpy as np
import pytest
import yaml
from helpers.paths import ROOT
from labelled.beds import way
from labelled.cases import TRUTH, Case, Cause, injected, read_set, read_sets
from labelled.methods import NAMES
from labelled.run import ENGINE
from labelled.score import (
    Answer,
    Name,
    counted,
    judged,
    read_answers,
    scored,
    table,
    write_answers,
)
from labelled.sources import READERS
from rates.digest import engine_digest

from ppmcal.errors import BadInput

ENTRY = {"name": "one", "data": "a.csv", "reader": "belts", "kind": "k", "basis": "owner",
         "words": "w", "source": "s", "causes": [{"kind": "backlash", "joints": ["a"]}]}


def case(*causes: Cause, **fields) -> Case:
    return Case("one", "set", "k", ("a.csv",), "belts", fields.pop("basis", "owner"), "w", "s",
                causes=causes, **fields)


def said(*names: Name, **fields) -> Answer:
    return Answer("set/one", names, **fields)


BACKLASH = Cause(("backlash", "play"), joints=("a", "b"))
RIGHT = Name("backlash", ("a",))


@pytest.mark.parametrize("of, answer, outcome", [
    (case(BACKLASH), said(RIGHT), "right"),
    (case(BACKLASH), said(Name("play", ("c", "b"))), "right"),
    (case(BACKLASH), said(Name("backlash", ("c",))), "wrong"),
    (case(BACKLASH), said(RIGHT, Name("gain")), "more"),
    (case(BACKLASH, acceptable=("gain",)), said(RIGHT, Name("gain")), "right"),
    (case(BACKLASH, acceptable=("gain",)), said(Name("gain")), "unknown"),
    (case(BACKLASH, asks=("backlash",)), said(RIGHT, Name("gain")), "right"),
    (case(BACKLASH, asks=("backlash",)), said(Name("gain")), "missed"),
    (case(BACKLASH, false=("gain",)), said(RIGHT, Name("gain")), "wrong"),
    (case(BACKLASH), said(Name("backlash", ("a",), probability=0.4)), "missed"),
    (case(BACKLASH), said(unknown=0.9), "unknown"),
    (case(BACKLASH), said(Name("gain"), unknown=0.9), "wrong"),
    (case(BACKLASH, Cause(("row",), rows=(7, 9))), said(RIGHT), "missed"),
    (case(BACKLASH, Cause(("row",), rows=(7, 9))), said(RIGHT, Name("row", rows=(8,))), "right"),
    (case(Cause(("row",), rows=(7, 9))), said(Name("row", rows=(10,))), "wrong"),
    (case(Cause(("geometry",), slots=("*.angle",))), said(Name("geometry", slot="a.angle")),
     "right"),
    (case(Cause(("geometry",), slots=("*.angle",))), said(Name("geometry", slot="radius")),
     "wrong"),
    (case(Cause(("gain",), instead=(BACKLASH,))), said(RIGHT), "right"),
    (case(Cause(("gain",), instead=(BACKLASH,))), said(Name("backlash", ("c",))), "wrong"),
    (case(), said(), "right"),
    (case(), said(Name("gain")), "wrong"),
    (case(), said(unknown=0.9), "unknown"),
    (case(asks=("backlash",)), said(Name("gain"), unknown=0.9), "right"),
    (case(BACKLASH), said(refused="no"), "refused"),
])
def test_outcome(of: Case, answer: Answer, outcome: str) -> None:
    assert judged(of, answer).outcome == outcome


def test_one_of_several_causes_is_not_enough_but_no_wrong_name() -> None:
    of = case(BACKLASH, Cause(("gain",)))
    assert judged(of, said(RIGHT)).outcome == "missed"
    assert judged(of, said(RIGHT, Name("drift"))).outcome == "wrong"


def test_withheld_truth_is_not_scored_and_no_answer_is_refused() -> None:
    cases = [case(BACKLASH), Case("two", "set", "k", (), "files", "withheld", "w", "s")]
    found = scored(cases, [Answer("set/two")], "here")
    assert [(j.case.id, j.outcome) for j in found] == [("set/one", "refused")]


@pytest.mark.parametrize("answers, words", [
    ([Answer("set/none")], "no case is called set/none"),
    ([said(), said()], "set/one is answered twice")])
def test_answers_to_nothing_and_twice(answers: list[Answer], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        scored([case()], answers, "here")


def test_table_counts_with_intervals() -> None:
    found = [judged(case(BACKLASH), a) for a in (
        said(RIGHT), said(RIGHT), said(RIGHT, Name("gain")), said())]
    (line, every) = counted(found, "mine")
    assert (line.kind, every.kind, line.cases) == ("k (owner)", "all, something there", 4)
    # two of four: Clopper and Pearson's interval is 0.0676 to 0.9324
    assert line.cell("right") == "2 (7-93)"
    assert line.cell("missed") == "1 (1-81)"
    assert line.names == 1.0
    assert "| k (owner) | 4 | mine | 2 (7-93) | 1 (1-81) |" in table({"mine": found})


def test_answers_are_read_as_written(tmp_path) -> None:
    answers = [said(Name("row", ("a",), "s", (3, 4), 0.25), unknown=0.5, seconds=2.0),
               Answer("set/two", refused="too few")]
    write_answers(tmp_path / "a.jsonl", answers)
    assert read_answers(tmp_path / "a.jsonl") == answers


def test_table_of_names(tmp_path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("case,kind,on,rows,probability\ns/1,backlash,a b,,0.9\ns/1,row,,3 4,\n"
                    "s/2,none,,,\ns/3,unknown,,,0.7\n", encoding="utf-8")
    assert read_answers(path) == [
        Answer("s/1", (Name("backlash", ("a", "b"), probability=0.9), Name("row", rows=(3, 4)))),
        Answer("s/2"), Answer("s/3", unknown=0.7)]


@pytest.mark.parametrize("name, text, words", [
    ("a.jsonl", "{", "line 1"), ("a.jsonl", '\n{"names": []}', "line 2.*README"),
    ("a.jsonl", '{"case": "s/1", "names": [{"rows": [1]}]}', "a name has kind"),
    ("a.jsonl", '{"case": "s/1", "unknown": 2}', "between 0 and 1, not 2"),
    ("a.jsonl", '{"case": "s/1", "names": [{"kind": "row", "rows": ["x"]}]}', "rows are numbers"),
    ("a.csv", "case,what\ns/1,row\n", "columns case and kind"),
    ("a.csv", "case,kind,rows\ns/1,row,x\n", "line 2"),
    ("none.csv", None, "no submission is here")])
def test_broken_submission(tmp_path, name: str, text: str | None, words: str) -> None:
    if text is not None:
        (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(BadInput, match=words):
        read_answers(tmp_path / name)


@pytest.mark.parametrize("change, words", [
    ({"basis": "hearsay"}, "hearsay is no origin of a label"),
    ({"words": None}, "words is missing"), ({"why": 1}, "why is not a key"),
    ({"causes": []}, "write `causes: nothing`"), ({"basis": "injected"}, "nothing injected"),
    ({"causes": [{"kind": "row", "rows": 8}]}, "a first and a last reading"),
    ({"causes": [{"joints": "a"}]}, "a cause has kind")])
def test_broken_case(tmp_path, change: dict, words: str) -> None:
    entry = {k: v for k, v in (ENTRY | change).items() if v is not None}
    path = tmp_path / "set.yaml"
    path.write_text(yaml.safe_dump({"cases": [entry]}), encoding="utf-8")
    with pytest.raises(BadInput, match=words):
        read_set(path)


def test_cases_have_defaults_and_own_names(tmp_path) -> None:
    path = tmp_path / "some.yaml"
    own = {"name": "two", "causes": "nothing"}
    path.write_text(yaml.safe_dump({"defaults": ENTRY, "cases": [{}, own]}), encoding="utf-8")
    one, two = read_set(path)
    assert (one.id, two.id, two.causes, two.basis) == ("some/one", "some/two", (), "owner")
    assert one.causes == (Cause(("backlash",), joints=("a",)),)
    path.write_text(yaml.safe_dump({"defaults": ENTRY, "cases": [{}, {}]}), encoding="utf-8")
    with pytest.raises(BadInput, match="two cases are called some/one"):
        read_set(path)
    with pytest.raises(BadInput, match="the readings are"):
        one.files(tmp_path)


@pytest.mark.slow
def test_truth_tables_of_the_project() -> None:
    """Every label says where it is from; those from regressions are not called the owner's."""
    cases = read_sets()
    assert len({c.id for c in cases}) == len(cases)
    assert all(c.words and c.source and c.reader in READERS for c in cases)
    assert all(c.inject for c in cases if c.basis == "injected")
    assert not any(c.inject for c in cases if c.basis != "injected")
    assert {c.set for c in read_sets(only=["beds"])} == {"beds"}
    assert [c.id for c in read_sets(TRUTH, ["belts/old-runs-2*"])] == [
        "belts/old-runs-26", "belts/old-runs-29"]
    with pytest.raises(BadInput, match="no case has this name"):
        read_sets(only=["nowhere"])
    assert NAMES == ("ppmcal", "bic", "sindy", "gp", "split")


@pytest.mark.slow
def test_the_guide_has_the_table_of_this_engine() -> None:
    """Or says that there is none; every line's outcomes are as many as its cases."""
    text = (ROOT / "docs/labelled-benchmark.md").read_text(encoding="utf-8")
    block = text.split("<!-- rates: labelled -->")[1].split("<!-- end of rates -->")[0]
    if "Not yet measured" in block:
        return
    made = re.search(r"Version \S+, engine (\w{12}) \([\w, ]+\), seed \d+", block)
    assert made and (made[1] == engine_digest(ENGINE) or "An earlier engine's" in block)
    cases = 0
    lines = [[c.strip() for c in line.strip("|").split("|")]
             for line in block.splitlines() if line.startswith("| ")][1:]
    for _, count, method, *cells in lines:
        cases = int(count or cases)
        assert method in NAMES
        assert sum(int(c.split(" ")[0]) for c in cells[:-1]) == cases


def test_injected_by_hand(tmp_path) -> None:
    table = tmp_path / "t.csv"
    table.write_text("q,dir\n1,1\n2,-1\n3,1\n", encoding="utf-8")

    def after(*changes: dict) -> list[float]:
        table.write_text("q,dir\n1,1\n2,-1\n3,1\n", encoding="utf-8")
        injected(case(inject=changes), [table])
        with table.open(encoding="utf-8", newline="") as stream:
            return [float(r["q"]) for r in csv.DictReader(stream)]

    assert after({"column": "q", "row": 2, "write": 7.5}) == [1, 7.5, 3]
    assert after({"column": "q", "from_row": 2, "add": 10}) == [1, 12, 13]
    assert after({"column": ["q"], "by": "dir", "add": 0.5}) == [1.5, 1.5, 3.5]
    for change, words in (({"column": "p", "add": 1}, "no column"),
                          ({"column": "q", "add": 1, "table": "u"}, "no table")):
        with pytest.raises(BadInput, match=words):
            after(change)


def test_regression_of_beds() -> None:
    """A way of 0.02 mm on a curved bed is there; none is not; a few touches say nothing."""
    rng = np.random.default_rng(5)
    x, y = (a.ravel() for a in np.meshgrid(range(-7, 8), range(-7, 8)))
    direction = np.where((y % 2) == 0, 1.0, -1.0)
    bed = 1e-3 * (x**2 - x * y) + rng.normal(0.0, 0.005, x.size)
    found = way(x, y, direction, bed + 0.01 * direction)
    assert found is not None and found.label == "there"
    assert abs(found.size[0] - 0.02) < 3.0 * found.sigma[0]
    none = way(x, y, direction, bed)
    assert none is not None and none.label != "there"
    assert way(x[:12], y[:12], direction[:12], bed[:12]) is None
