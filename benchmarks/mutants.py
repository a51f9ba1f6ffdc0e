"""How many small faults in the core do the tests notice? ``make mutants``.

A sample of all faults that ``mutation/operators.py`` knows, drawn by the hash of seed and fault, so
that an edit elsewhere draws the others again. What was tried is kept in build/mutants and
not tried again; ``--again`` tries survivors anew, after a test was written.
"""

from __future__ import annotations

import argparse
import ast
import json
import multiprocessing
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from functools import cache, partial
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from mutation.core import BUILD, COMPILED_TESTS, ROOT, TESTS, core_files
from mutation.operators import Mutant, mutants_of
from mutation.trial import Outcome, Trial, from_import, preload, serve

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

RESULTS = BUILD / "results.jsonl"
EQUIVALENT = ROOT / "benchmarks" / "mutation" / "equivalent.yaml"
FORK = multiprocessing.get_context("fork")
START_UP = 10.0
"""CPU seconds that a child may take on top of twice its tests' time under coverage."""
STATUSES = ("killed", "timed out", "equivalent", "survived")


class Map(NamedTuple):
    """Seconds of each test, and tests by file and line."""

    seconds: dict[str, float]
    lines: dict[str, dict[int, set[str]]]


def main(arguments: Sequence[str] | None = None) -> int:
    """Make the map where there is none, try what was not tried, and print the figures."""
    options = _options(arguments)
    sample = drawn(options.sample, options.seed, options.compiled, options.file)
    if not options.tally:
        if options.new_map or not list(BUILD.glob("map*.json")):
            for old in BUILD.glob("map*.json"):
                old.unlink()
            made_map(options.tests)
        found = results()
        todo = [m for m in sample if m.name not in found or (
            options.again and found[m.name]["status"] == "survived" and not _equal(m))]
        # a survivor is tried from the import on: what was computed there had no fault before
        afresh = [m for m in todo if m.at_import or "/compil" in m.file or m.name in found]
        warm = [m for m in todo if m not in afresh]
        if warm:
            server = FORK.Process(target=serve, args=(
                options.tests, lambda trial: try_all(warm, trial, options)))
            server.start()
            server.join()
        found = results()
        try_all([m for m in todo if m in afresh or m.name not in found], from_import, options)
    return told(sample)


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sample", type=int, default=500, help="how many mutants")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cores", type=int, default=1)
    parser.add_argument("--budget", type=float, default=20.0, help="CPU s of tests, each, at most")
    parser.add_argument("--again", action="store_true", help="try survivors once more")
    parser.add_argument("--compiled", action="store_true", help="those of compiled functions")
    parser.add_argument("--file", default="", help="only mutants of files with names like this")
    parser.add_argument("--new-map", action="store_true", help="see anew which test runs what")
    parser.add_argument("--tally", action="store_true", help="try nothing, print the figures")
    parser.add_argument("--tests", nargs="+", default=TESTS, help="tests that are asked")
    return parser.parse_args(arguments)


def drawn(count: int, seed: int, compiled: bool = False, within: str = "") -> list[Mutant]:
    """Return the sample: of all mutants of the core those with the first hashes."""
    every = [m for file in core_files(compiled)
             for m in mutants_of(file, (ROOT / file).read_text(encoding="utf-8"))]
    sample = sorted(every, key=lambda m: m.drawn(seed))[:count]
    return [m for m in sample if re.search(within, m.file)]


def made_map(tests: Sequence[str]) -> None:
    """Run the tests once under coverage."""
    subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "mutation.coverage_map", "--map",
         str(BUILD / "map.json"), "-q", "-m", "not slow", *tests], cwd=ROOT, check=False,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(
            filter(None, (str(ROOT / "benchmarks"), os.environ.get("PYTHONPATH"))))})


@cache
def read_map() -> Map:
    """Return what the runs under coverage saw."""
    made = Map({}, {})
    for path in sorted(BUILD.glob("map*.json")):
        data = json.loads(path.read_text(encoding="utf-8"))
        names = [name for name, _ in data["tests"]]
        made.seconds.update(data["tests"])
        for file, lines in data["lines"].items():
            for line, tests in lines.items():
                made.lines.setdefault(file, {}).setdefault(int(line), set()).update(
                    names[t] for t in tests)
    return made


def covering(mutant: Mutant) -> set[str]:
    """Return the tests that run a mutant's line, or else its function or its module."""
    made = read_map()
    seen = made.lines.get(mutant.file, {})
    if "/compil" in mutant.file:
        return {t for t in made.seconds if t.startswith(COMPILED_TESTS)}
    if not mutant.at_import and seen.get(mutant.line):
        return seen[mutant.line]
    within = [lines for lines in _functions(mutant.file) if lines[0] <= mutant.line <= lines[-1]]
    lines = within[-1] if within else range(10**6)
    found = {t for line, tests in seen.items() if line in lines for t in tests}
    # a declaration is read where no line of its file is run: what mirrors its package
    folder = mutant.file.split("/")[1]
    mirror = {t for t in made.seconds if t.startswith(f"tests/{folder}/")}
    return found if found and within else found | mirror


@cache
def _functions(file: str) -> list[range]:
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    return [range(n.lineno, (n.end_lineno or n.lineno) + 1) for n in ast.walk(tree)
            if isinstance(n, ast.FunctionDef)]


def in_order(tests: set[str], name: str, killers: Counter[str], budget: float) -> list[str]:
    """Return tests: those that noticed others in this file or have its name, then quick ones."""
    seconds = read_map().seconds
    siblings = {test: n for _, group in groupby(sorted(tests), key=lambda t: t.split("[")[0])
                for n, test in enumerate(sorted(group, key=lambda t: seconds[t]))}
    order = sorted(tests, key=lambda t: (
        -min(killers[t], 1), name not in t, (seconds[t] + 0.05) * (1 + siblings[t])))
    out, spent = [], 0.0
    for test in order:
        if spent + seconds[test] <= budget:
            out.append(test)
            spent += seconds[test]
    return out or order[:1]


def try_all(todo: Sequence[Mutant], trial: Trial, options: argparse.Namespace) -> None:
    """Try mutants, each core some of them, and append a line of results for each."""
    BUILD.mkdir(parents=True, exist_ok=True)
    lock = FORK.Lock()
    if trial is from_import:
        preload()
    read_map()
    # in the order in which they were drawn: what is done when it is stopped is a sample too
    workers = [FORK.Process(target=_worker, args=(todo[n::options.cores], trial, options.budget,
                                                  lock)) for n in range(options.cores)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()


def _worker(todo: Sequence[Mutant], trial: Trial, budget: float, lock: Any) -> None:
    parts = core_files() | core_files(True)
    killers: dict[str, Counter[str]] = {}
    for line in results().values():
        killers.setdefault(line["file"], Counter())[line["test"]] += 1
    sound: dict[str, bool] = {}
    for mutant in todo:
        known = killers.setdefault(mutant.file, Counter())
        outcome, asked = _tried(partial(trial, mutant), partial(trial, None), mutant, known,
                                budget, sound)
        if outcome.status == "not tried":
            continue
        known[outcome.test] += 1
        line = {"name": mutant.name, "part": parts[mutant.file], "file": mutant.file,
                "status": outcome.status, "test": outcome.test, "tests": asked,
                "seconds": outcome.seconds}
        with lock, RESULTS.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")


Ask = Callable[[Sequence[str], float], Outcome]


def _tried(faulty: Ask, faultless: Ask, mutant: Mutant, killers: Counter[str], budget: float,
           sound: dict[str, bool]) -> tuple[Outcome, int]:
    """Return what became of a mutant and how many tests were asked.

    A test that fails without any fault notices nothing: it is left out, and the mutant tried again.
    Nor does time that runs out without any fault.
    """
    seconds = read_map().seconds
    name = Path(mutant.file).stem
    while tests := in_order({t for t in covering(mutant) if sound.get(t, True)}, name, killers,
                            budget):
        allowed = START_UP + 2.0 * sum(seconds[t] for t in tests)
        outcome = faulty(tests, allowed)
        blamed = outcome.test if outcome.test in seconds else tests[0]
        if outcome.status == "killed" and blamed not in sound:
            sound[blamed] = faultless([blamed], allowed).status == "survived"
        if outcome.status == "timed out" and faultless(tests, allowed).status == "timed out":
            return Outcome("not tried", "", outcome.seconds), len(tests)
        if outcome.status != "killed" or sound[blamed]:
            return outcome, len(tests)
    return Outcome("survived", "", 0.0), 0


def results() -> dict[str, dict[str, Any]]:
    """Return the last line of results of each mutant."""
    if not RESULTS.is_file():
        return {}
    lines = map(json.loads, RESULTS.read_text(encoding="utf-8").splitlines())
    return {line["name"]: line for line in lines}


def told(sample: Sequence[Mutant]) -> int:
    """Print the survivors and a table; return 1 where fewer than nine of ten were noticed."""
    found = results()
    table: dict[str, Counter[str]] = {}
    for m in sorted((m for m in sample if m.name in found), key=lambda m: (m.file, m.line)):
        line = found[m.name]
        status = line["status"]
        if status == "survived" and _equal(m):
            status = "equivalent"
        table.setdefault(line["part"], Counter())[status] += 1
        if status == "survived":
            print(f"{m.file}:{m.line}  {m.text} [{m.change}]  ({line['tests']} tests)")
    print(f"\n{'':18}" + "".join(f"{s:>12}" for s in STATUSES) + f"{'noticed':>12}")
    every: Counter[str] = sum(table.values(), Counter())
    for name, row in [*table.items(), ("all", every)]:
        print(f"{name:18}" + "".join(f"{row[s]:12d}" for s in STATUSES) + f"{_part(row):12.1%}")
    return int(_part(every) < 0.9)


def _equal(mutant: Mutant) -> bool:
    """Whether a mutant was judged to be no fault."""
    return _spaced(mutant.name) in _equivalents()


@cache
def _equivalents() -> set[str]:
    return {_spaced(name) for group in yaml.safe_load(EQUIVALENT.read_text(encoding="utf-8"))
            for name in group["mutants"]}


def _spaced(name: str) -> str:
    return re.sub(r"\s+", " ", name).strip()


def _part(row: Counter[str]) -> float:
    """Return which part of the mutants that are no equivalents was noticed."""
    noticed = row["killed"] + row["timed out"]
    return noticed / max(noticed + row["survived"], 1)


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)
