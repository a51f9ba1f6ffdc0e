"""Run the labelled benchmark, or score a submission.

    PYTHONPATH=benchmarks python -m labelled.run --data DIR --out DIR
    PYTHONPATH=benchmarks python -m labelled.run --submission answers.jsonl

DIR of ``--data`` holds the readings, which are not part of the project. ``--out`` gets the answers
of each method as a submission (``ppmcal.jsonl`` and so on), ``cases.csv`` with the outcome of each,
and ``table.md``. A run that was stopped goes on where it was. README.md has the formats.
"""

from __future__ import annotations

import argparse
import csv
import multiprocessing
import os
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from rates.digest import engine_digest  # noqa: E402
from rates.studies import filled  # noqa: E402

import ppmcal  # noqa: E402
from labelled.cases import BASES, TRUTH, Case, read_sets  # noqa: E402
from labelled.methods import NAMES, answers  # noqa: E402
from labelled.score import (  # noqa: E402
    Answer,
    Judged,
    read_answers,
    scored,
    table,
    write_answers,
)
from labelled.sources import written  # noqa: E402
from ppmcal.errors import BadInput, PpmcalError  # noqa: E402

ENGINE = ("calibration", "diagnosis", "inference")
"""What decides what the tool names."""


def parser() -> argparse.ArgumentParser:
    """Return the options."""
    out = argparse.ArgumentParser(prog="labelled.run", description=(__doc__ or "").split("\n")[0])
    out.add_argument("--data", type=Path, default=os.environ.get("PPMCAL_DATA"),
                     help="folder of the readings  [default: PPMCAL_DATA]")
    out.add_argument("--truth", type=Path, default=TRUTH, help="folder of sets, *.yaml")
    out.add_argument("--sets", nargs="*", default=[], help="sets, or patterns of set/case")
    out.add_argument("--methods", nargs="+", default=list(NAMES), choices=NAMES, metavar="METHOD",
                     help=" ".join(NAMES))
    out.add_argument("--submission", type=Path, action="append", default=[],
                     help="score these answers; nothing is run")
    out.add_argument("--out", type=Path, help="folder for answers and table")
    out.add_argument("--page", type=Path, help="put the table into this page of the guide, too")
    out.add_argument("--write-files", type=Path,
                     help="only write each case's mechanism and tables there")
    out.add_argument("--seed", type=int, default=1, help="of what methods draw")
    out.add_argument("--cores", type=int, default=1)
    return out


def ran(cases: Sequence[Case], given: argparse.Namespace) -> dict[str, list[Answer]]:
    """Return the answers of all methods, from an earlier run where it has them."""
    found: dict[str, dict[str, Answer]] = {m: {} for m in given.methods}
    if given.out:
        given.out.mkdir(parents=True, exist_ok=True)
        for m in given.methods:
            path = given.out / f"{m}.jsonl"
            if path.exists():
                found[m] = {a.case: a for a in read_answers(path)}
    todo = [(c, [m for m in given.methods if c.id not in found[m]]) for c in cases]
    todo = [(c, m) for c, m in todo if m]
    with multiprocessing.Pool(given.cores) as pool:
        for n, (case, new) in enumerate(pool.imap(
                partial(_one, given.data, given.seed), todo), 1):
            for m, a in new.items():
                found[m][case] = a
                if given.out:
                    write_answers(given.out / f"{m}.jsonl", found[m].values())
            took = sum(a.seconds for a in new.values())
            print(f"{n} of {len(todo)}: {case}, {took:.0f} s", file=sys.stderr, flush=True)
    return {m: [of[c.id] for c in cases] for m, of in found.items()}


def _one(root: Path, seed: int, job: tuple[Case, list[str]]) -> tuple[str, dict[str, Answer]]:
    case, methods = job
    return case.id, answers(case, root, methods, seed)


def write_cases(path: Path, of: Mapping[str, Sequence[Judged]]) -> None:
    """Write what became of each answer: one line for each case and method."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        out = csv.writer(stream)
        out.writerow(["case", "kind", "basis", "seen", "method", "outcome", "named", "unknown",
                      "seconds"])
        for method, found in of.items():
            for j in found:
                named = "; ".join(
                    " ".join([n.kind, *n.on, n.slot, *map(str, n.rows),
                              f"({n.probability:.2f})"]).replace("  ", " ")
                    for n in j.answer.names)
                out.writerow([j.case.id, j.case.kind, j.case.basis, j.case.seen, method,
                              j.outcome, named or j.answer.refused, f"{j.answer.unknown:.2f}",
                              j.answer.seconds])


def told(of: Mapping[str, Sequence[Judged]], seed: int) -> str:
    """Return the table with what it is of."""
    some = next(iter(of.values()))
    seconds = ", ".join(f"{m} {sum(j.answer.seconds for j in found):.0f} s"
                        for m, found in of.items())
    bases = "; ".join(f"{b}: {BASES[b]}" for b in dict.fromkeys(j.case.basis for j in some))
    unseen = sum(not j.case.seen for j in some)
    return "\n".join([
        f"Version {ppmcal.__version__}, engine {engine_digest(ENGINE)} ({', '.join(ENGINE)}), "
        f"seed {seed}: {len(some)} cases of {', '.join(dict.fromkeys(j.case.set for j in some))}; "
        f"the tool's authors had never seen the readings of {unseen}.", "", table(of), "",
        f"In brackets: share in per cent, 95 % interval (Clopper and Pearson). Origins: {bases}.",
        f"CPU time: {seconds}."])


def main(argv: Sequence[str] | None = None) -> int:
    """Command line: 0 done, 2 bad input."""
    given = parser().parse_args(argv)
    try:
        return _done(given)
    except PpmcalError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


def _done(given: argparse.Namespace) -> int:
    cases = read_sets(given.truth, given.sets)
    if given.submission:
        of = {p.stem: scored(cases, read_answers(p), str(p)) for p in given.submission}
    else:
        if given.data is None or not Path(given.data).is_dir():
            raise BadInput("the readings are not here", str(given.data or "--data"),
                           "say with --data (or PPMCAL_DATA) where they are")
        given.data = Path(given.data)
        for case in cases:
            case.files(given.data)
        if given.write_files:
            for case in cases:
                written(case, given.data, given.write_files / case.id)
            return 0
        of = {m: scored(cases, a, m) for m, a in ran(cases, given).items()}
    text = told(of, given.seed)
    if given.out:
        given.out.mkdir(parents=True, exist_ok=True)
        write_cases(given.out / "cases.csv", of)
        (given.out / "table.md").write_text(text + "\n", encoding="utf-8")
    if given.page:
        given.page.write_text(filled(given.page.read_text(encoding="utf-8"), "labelled", text),
                              encoding="utf-8")
    print(text)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
