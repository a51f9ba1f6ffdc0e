"""Answers, read from a file or made by a method, and what becomes of them against the labels.

A name counts from a probability of 0.5 on. Of what a case asks:

* right: every cause is named, and nothing else; nothing is named where nothing is known;
* more: every cause is named, and something that nobody wrote down beside it;
* unknown: no name, but that something without a name is there (or a name that is acceptable); not
  where a case asks for some kinds only, and none of them is known: the rest is not judged;
* wrong: a name, and not that of a cause; one that is known to be false, whatever else;
* missed: a cause is there and nothing is said;
* refused: the method gave no answer.
"""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from study_summary import interval

from labelled.cases import Case, Cause, fits
from ppmcal.errors import BadInput

OUTCOMES = ("right", "more", "unknown", "wrong", "missed", "refused")
COUNTS = 0.5
"""A name counts from this probability on; one without a probability counts."""
HINT = "see the format in benchmarks/labelled/README.md"


@dataclass(frozen=True)
class Name:
    """One cause that a method names; ``rows``: readings that do not belong, or the first one.

    Readings are counted from 1; of a step, ``rows`` holds the one from which it is there.
    """

    kind: str
    on: tuple[str, ...] = ()
    slot: str = ""
    rows: tuple[int, ...] = ()
    probability: float = 1.0


@dataclass(frozen=True)
class Answer:
    """What a method says of one case.

    ``unknown``: probability that something is there that it has no name for; ``refused``: why it
    gives no answer.
    """

    case: str
    names: tuple[Name, ...] = ()
    unknown: float = 0.0
    refused: str = ""
    seconds: float = 0.0


@dataclass(frozen=True)
class Judged:
    """One answer against its case: the outcome, and how many names nobody wrote down."""

    case: Case
    answer: Answer
    outcome: str
    others: int = 0


@dataclass(frozen=True)
class Counted:
    """Outcomes of one method in one line of the table; ``names``: how many it gives on average.

    Those that are not asked for too: who names everything is right everywhere.
    """

    kind: str
    method: str
    cases: int
    counts: Mapping[str, int] = field(default_factory=dict)
    names: float = 0.0

    def cell(self, outcome: str) -> str:
        """Return ``12 (48-93)``: a count, and its share in per cent at 95 % (Clopper-Pearson)."""
        n = self.counts.get(outcome, 0)
        low, high = interval(n, self.cases)
        return f"{n} ({100 * low:.0f}-{100 * high:.0f})"


def judged(case: Case, answer: Answer) -> Judged:
    """Return what becomes of an answer."""
    if answer.refused:
        return Judged(case, answer, "refused")
    named = [n for n in answer.names if n.probability >= COUNTS and case.asked(n.kind)]
    false = [n for n in named if fits(n.kind, case.false)]
    hits = [n for n in named if any(_is(n, c) for c in case.causes)]
    others = [n for n in named if n not in hits and not fits(n.kind, case.acceptable)]
    said = answer.unknown >= COUNTS or len(named) > len(hits) + len(others)
    found = all(any(_is(n, c) for n in named) for c in case.causes)
    if false:
        outcome = "wrong"
    elif case.causes and found:
        outcome = "more" if others else "right"
    elif others:
        outcome = "wrong"
    elif said and (case.causes or case.asked("anything")):
        outcome = "unknown"
    elif not case.causes:
        outcome = "right"
    else:
        outcome = "missed"
    return Judged(case, answer, outcome, len(others))


def _is(name: Name, cause: Cause) -> bool:
    return cause.names(name.kind, name.on, name.slot, name.rows)


def scored(cases: Sequence[Case], answers: Iterable[Answer], where: str) -> list[Judged]:
    """Return every scored case with its answer; one without an answer is refused.

    Raises:
        BadInput: an answer to no case, or two to one.
    """
    by: dict[str, Answer] = {}
    known = {c.id for c in cases}
    for a in answers:
        if a.case not in known:
            raise BadInput(f"no case is called {a.case}", where, "names are set/case, as in truth/")
        if a.case in by:
            raise BadInput(f"{a.case} is answered twice", where, "give one answer for each case")
        by[a.case] = a
    return [judged(c, by.get(c.id, Answer(c.id, refused="no answer"))) for c in cases if c.scored]


def counted(found: Sequence[Judged], method: str) -> list[Counted]:
    """Return a line for each kind and origin of a label, and one for all."""
    lines: dict[str, list[Judged]] = {}
    for j in found:
        lines.setdefault(f"{j.case.kind} ({j.case.basis})", []).append(j)
        lines.setdefault("all, something there" if j.case.causes else "all, nothing known",
                         []).append(j)
    order = sorted(lines, key=lambda k: k.startswith("all, "))
    return [Counted(k, method, len(lines[k]), Counter(j.outcome for j in lines[k]),
                    sum(_counting(j.answer) for j in lines[k]) / len(lines[k]))
            for k in order]


def _counting(answer: Answer) -> int:
    return len({(n.kind, n.on, n.slot, n.rows) for n in answer.names if n.probability >= COUNTS})


def table(of: Mapping[str, Sequence[Judged]]) -> str:
    """Return the table of all methods in Markdown, kind by kind."""
    lines = [c for method, found in of.items() for c in counted(found, method)]
    out = ["| what is asked (origin of the label) | cases | method | "
           + " | ".join(OUTCOMES) + " | names |", "|---" * (4 + len(OUTCOMES)) + "|"]
    for kind in dict.fromkeys(c.kind for c in sorted(lines, key=lambda c: c.kind[:4] == "all,")):
        for n, c in enumerate(c for c in lines if c.kind == kind):
            left = f"{kind} | {c.cases}" if n == 0 else " | "
            cells = [*map(c.cell, OUTCOMES), f"{c.names:.1f}"]
            out.append(f"| {left} | {c.method} | " + " | ".join(cells) + " |")
    return "\n".join(out)


def read_answers(path: Path) -> list[Answer]:
    """Return a submission: JSON lines (an answer each), or CSV (a name each).

    Raises:
        BadInput: naming line and key.
    """
    if not path.is_file():
        raise BadInput("no submission is here", str(path), "give JSON lines or CSV")
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".csv":
        return _from_csv(path, text)
    out = []
    for n, line in enumerate(text.splitlines(), 1):
        if line.strip():
            try:
                out.append(_answer(json.loads(line), f"{path}, line {n}"))
            except json.JSONDecodeError as error:
                raise BadInput(f"this is no JSON ({error.msg})", f"{path}, line {n}", HINT
                               ) from None
    return out


def _answer(tree: Any, where: str) -> Answer:
    keys = {"case", "names", "unknown", "refused", "seconds"}
    if not isinstance(tree, dict) or "case" not in tree or set(tree) - keys:
        raise BadInput("an answer has case, and may have " + ", ".join(sorted(keys - {"case"})),
                       where, HINT)
    names = tuple(_name(n, where) for n in tree.get("names", ()))
    return Answer(str(tree["case"]), names, _chance(tree.get("unknown", 0.0), where),
                  str(tree.get("refused", "")), float(tree.get("seconds", 0.0)))


def _name(tree: Any, where: str) -> Name:
    keys = {"kind", "on", "slot", "rows", "probability"}
    if not isinstance(tree, dict) or "kind" not in tree or set(tree) - keys:
        raise BadInput("a name has kind, and may have " + ", ".join(sorted(keys - {"kind"})),
                       where, HINT)
    try:
        rows = tuple(int(r) for r in tree.get("rows", ()))
    except (TypeError, ValueError):
        raise BadInput(f"rows are numbers of readings, not {tree['rows']}", where, HINT) from None
    return Name(str(tree["kind"]), tuple(map(str, tree.get("on", ()))), str(tree.get("slot", "")),
                rows, _chance(tree.get("probability", 1.0), where))


def _chance(value: Any, where: str) -> float:
    try:
        p = float(value)
    except (TypeError, ValueError):
        p = -1.0
    if not 0.0 <= p <= 1.0:
        raise BadInput(f"a probability is between 0 and 1, not {value}", where, HINT)
    return p


def _from_csv(path: Path, text: str) -> list[Answer]:
    rows = list(csv.DictReader(text.splitlines()))
    if not rows or not {"case", "kind"} <= set(rows[0]):
        raise BadInput("a table of answers has the columns case and kind", str(path), HINT)
    trees: dict[str, dict[str, Any]] = {}
    for n, row in enumerate(rows, 2):
        where = f"{path}, line {n}"
        tree = trees.setdefault(row["case"], {"case": row["case"], "names": []})
        given = _chance(row.get("probability") or 1.0, where)
        if row["kind"] == "unknown":
            tree["unknown"] = max(given, tree.get("unknown", 0.0))
        elif row["kind"] == "refused":
            tree["refused"] = row.get("slot") or "refused"
        elif row["kind"] != "none":
            tree["names"].append({"kind": row["kind"], "on": (row.get("on") or "").split(),
                                  "slot": row.get("slot") or "",
                                  "rows": (row.get("rows") or "").split(), "probability": given})
            _name(tree["names"][-1], where)
    return [_answer(t, str(path)) for t in trees.values()]


def write_answers(path: Path, answers: Iterable[Answer]) -> None:
    """Write answers as JSON lines, as :func:`read_answers` reads them."""
    path.write_text("".join(json.dumps(asdict(a)) + "\n" for a in answers), encoding="utf-8")
