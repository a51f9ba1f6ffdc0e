"""Cases: where the data are, what was asked of them, and what somebody wrote down as the cause.

A set is a YAML file of cases (README.md has the format). What is wrong in one is an error with
file, case and hint, before anything runs.
"""

from __future__ import annotations

import csv
import fnmatch
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from ppmcal.errors import BadInput

TRUTH = Path(__file__).resolve().parent / "truth"
BASES = {
    "owner": "the machine's owner wrote it down",
    "file": "the file contradicts itself: the firmware's own solver gives other numbers",
    "regression": "an independent regression on the same readings",
    "injected": "put into a real file by hand, as the case says",
    "simulated": "simulated, with the truth known",
    "withheld": "known to somebody else: answered, not scored"}
"""Where a label may come from."""
CASE_KEYS = {"name", "data", "reader", "asks", "basis", "kind", "words", "source", "causes",
             "false", "acceptable", "inject", "options", "seen"}


@dataclass(frozen=True)
class Cause:
    """One cause: kinds that name it (patterns), where; ``rows`` of the file's readings, from 1.

    ``joints``, of which one is enough; ``slots``: patterns, one of which has to fit; empty: any.
    ``instead``: what names it as well.
    """

    kinds: tuple[str, ...]
    joints: tuple[str, ...] = ()
    slots: tuple[str, ...] = ()
    rows: tuple[int, int] | None = None
    instead: tuple[Cause, ...] = ()

    def names(self, kind: str, on: Sequence[str], slot: str, rows: Sequence[int]) -> bool:
        """Return whether a name is this cause."""
        return any(c.names(kind, on, slot, rows) for c in self.instead) or (
            fits(kind, self.kinds) and (not self.joints or bool(set(on) & set(self.joints)))
            and (not self.slots or fits(slot, self.slots))
            and (self.rows is None or any(self.rows[0] <= r <= self.rows[1] for r in rows)))


@dataclass(frozen=True)
class Case:
    """One campaign and its label.

    Attributes:
        name, set: unique together. kind: the line of the table that it counts in.
        data: paths of its files relative to the data root; reader: how they are read.
        options: of the reader.
        inject: changes of the written tables, made by hand (:func:`injected`).
        asks: kinds that are judged, as patterns; others are neither right nor wrong.
        basis: where the label comes from; words: what was written, paraphrased; source.
        causes: all have to be named; none: nothing of what is asked is known to be there.
        false: kinds that are known not to be there. acceptable: neither right nor wrong.
        seen: whether the tool was tuned with these readings in the past.
    """

    name: str
    set: str
    kind: str
    data: tuple[str, ...]
    reader: str
    basis: str
    words: str
    source: str
    asks: tuple[str, ...] = ("*",)
    causes: tuple[Cause, ...] = ()
    false: tuple[str, ...] = ()
    acceptable: tuple[str, ...] = ()
    inject: tuple[Mapping[str, Any], ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    seen: bool = True

    @property
    def id(self) -> str:
        """Return what a submission calls it: ``belts/old-runs-29``."""
        return f"{self.set}/{self.name}"

    @property
    def scored(self) -> bool:
        """Whether the truth is here."""
        return self.basis != "withheld"

    def asked(self, kind: str) -> bool:
        """Whether a kind is judged."""
        return fits(kind, self.asks)

    def files(self, root: Path) -> list[Path]:
        """Return the files; BadInput where one is missing."""
        out = [root / d for d in self.data]
        for path in out:
            if not path.exists():
                raise BadInput(f"{self.id}: its data are not here", str(path),
                               "say with --data (or PPMCAL_DATA) where the readings are")
        return out


def fits(name: str, patterns: Sequence[str]) -> bool:
    return any(fnmatch.fnmatchcase(name, p) for p in patterns)


def read_sets(folder: Path = TRUTH, only: Sequence[str] = ()) -> list[Case]:
    """Return the cases of all sets of a folder, those of one set together.

    Args:
        folder: with ``*.yaml``.
        only: names of sets, or patterns of ``set/name``; empty: all.
    """
    paths = sorted(folder.glob("*.yaml"))
    if not paths:
        raise BadInput("no truth table is here", str(folder), "give a folder with sets, *.yaml")
    cases = [c for p in paths for c in read_set(p)]
    chosen = [c for c in cases if not only or c.set in only or fits(c.id, only)]
    if not chosen:
        raise BadInput("no case has this name", " ".join(only),
                       "sets are " + ", ".join(dict.fromkeys(c.set for c in cases)))
    return chosen


def read_set(path: Path) -> list[Case]:
    """Return the cases of one set."""
    try:
        tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        raise BadInput(f"this is no YAML ({error.__class__.__name__})", str(path),
                       "mend the file, or take it out of the folder") from None
    if not isinstance(tree, dict) or not isinstance(tree.get("cases"), list):
        raise BadInput("a set has a list of cases", str(path), "see benchmarks/labelled/README.md")
    name, usual = str(tree.get("set", path.stem)), dict(tree.get("defaults", {}))
    out = [_case(path, name, usual | dict(entry)) for entry in tree["cases"]]
    double = {c.id for c in out if sum(o.id == c.id for o in out) > 1}
    if double:
        raise BadInput(f"two cases are called {min(double)}", str(path), "give each its own name")
    return out


def _case(path: Path, of: str, entry: Mapping[str, Any]) -> Case:
    where = f"{path}, case {entry.get('name', '?')}"
    unknown = set(entry) - CASE_KEYS
    if unknown:
        raise BadInput(f"{min(unknown)} is not a key of a case", where,
                       "keys are " + ", ".join(sorted(CASE_KEYS)))
    for key in ("name", "data", "reader", "basis", "words", "source", "kind", "causes"):
        if key not in entry:
            raise BadInput(f"{key} is missing", where, "a label without its origin is none")
    if entry["basis"] not in BASES:
        raise BadInput(f"{entry['basis']} is no origin of a label", where,
                       "one of " + ", ".join(BASES))
    if entry["basis"] == "injected" and not entry.get("inject"):
        raise BadInput("an injected label has nothing injected", where, "say it in inject")
    causes = () if entry["causes"] == "nothing" else tuple(
        _cause(where, c) for c in entry["causes"] or ())
    if not causes and entry["causes"] != "nothing" and entry["basis"] != "withheld":
        raise BadInput("causes are empty", where, "write `causes: nothing` where none is known")
    texts = {k: str(entry[k]) for k in ("name", "kind", "reader", "basis", "words", "source")}
    return Case(set=of, data=_texts(entry["data"]), causes=causes,
                asks=_texts(entry.get("asks", "*")), false=_texts(entry.get("false", ())),
                acceptable=_texts(entry.get("acceptable", ())),
                inject=tuple(entry.get("inject", ())), options=dict(entry.get("options", {})),
                seen=bool(entry.get("seen", True)), **texts)


def _cause(where: str, entry: Any) -> Cause:
    if not isinstance(entry, dict) or "kind" not in entry or set(entry) - {
            "kind", "joints", "slot", "rows", "or"}:
        raise BadInput("a cause has kind, and may have joints, slot, rows, or", where,
                       "see benchmarks/labelled/README.md")
    rows = entry.get("rows")
    if rows is not None and not (isinstance(rows, list) and len(rows) == 2):
        raise BadInput(f"rows are a first and a last reading, not {rows}", where,
                       "write rows: [8, 9]")
    return Cause(_texts(entry["kind"]), _texts(entry.get("joints", ())),
                 _texts(entry.get("slot", ())),
                 None if rows is None else (int(rows[0]), int(rows[1])),
                 tuple(_cause(where, c) for c in entry.get("or", ())))


def _texts(value: Any) -> tuple[str, ...]:
    return (value,) if isinstance(value, str) else tuple(str(v) for v in value)


def injected(case: Case, tables: Sequence[Path]) -> None:
    """Change written tables as a case says: what stands in a cell, or a number added to it.

    Each entry names ``column``, and the readings it changes: ``row`` (from 1), ``from_row`` or all.
    ``write`` puts a number there, ``add`` adds one, times the column ``by`` where one is named;
    ``table`` is the stem of the file (the first where none is said).
    """
    for change in case.inject:
        path = next((t for t in tables if t.stem == change.get("table", tables[0].stem)), None)
        if path is None:
            raise BadInput(f"{case.id}: no table is called {change['table']}", "inject",
                           "tables are " + ", ".join(t.stem for t in tables))
        with path.open(encoding="utf-8", newline="") as stream:
            rows = list(csv.DictReader(stream))
        for column in _texts(change["column"]):
            if column not in rows[0]:
                raise BadInput(f"{case.id}: no column is called {column}", path.name,
                               "columns are " + ", ".join(rows[0]))
            for n, row in enumerate(rows, 1):
                if n == change.get("row", n) and n >= change.get("from_row", 1):
                    row[column] = repr(_changed(change, row, float(row[column])))
        with path.open("w", encoding="utf-8", newline="") as stream:
            out = csv.DictWriter(stream, list(rows[0]))
            out.writeheader()
            out.writerows(rows)


def _changed(change: Mapping[str, Any], row: Mapping[str, str], value: float) -> float:
    if "write" in change:
        return float(change["write"])
    return value + float(change["add"]) * (float(row[change["by"]]) if "by" in change else 1.0)
