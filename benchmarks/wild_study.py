"""How mistakes in files are told, and whether right files are let through, over `benchmarks/wild`.

    python benchmarks/wild_study.py --groups mistake --seeds 1 2
    python benchmarks/wild_study.py --groups none gross physics event memory --eta 3

One line per campaign on standard error, one per case (and machine with ``--every``) in the table
on standard output; ``--out FILE`` keeps the lines as CSV. Per campaign:

- shows: as it was written, a short fit leaves more than twice the noise, or rows have no pose;
- named: every kind of the truth, or one as right as it, is among those told by `identify` (by
  `diagnose`, of columns that only effects depend on), and with its rows, where it is not in all;
- mended: read with the block proposed, the file is fitted to the noise inside the tolerances;
- refused: a file without a mistake that is said to have one.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from wild.cases import CASES
from wild.catalogue import write
from wild.machines import MACHINES

from ppmcal import diagnose, identify
from ppmcal.calibration.fit import Problem
from ppmcal.calibration.interpretation import Interpretation, InterpretationError, plain_mistakes
from ppmcal.calibration.interpretation.limits import TELLING
from ppmcal.calibration.interpretation.score import score
from ppmcal.commands.inputs import prepared
from ppmcal.errors import PpmcalError

KINDS = frozenset(("permuted", "sign", "unit", "rotation", "inverse", "mirrored", "exchanged",
                   "shifted", "stale", "outside-limits", "radius", "other-machine",
                   "shuffled"))
AT_NOISE = 2.0
"""A mended file is fitted to at most so many times the noise,"""
NEARLY = 0.75
"""Of the rows with a mistake, so large a part has to be told, and hardly any other."""
INSIDE = 3.0
"""and the geometry moves by no more than so many tolerances, RMS over the parameters."""


@dataclass(frozen=True)
class Answer:
    """What was said of one campaign.

    ``found``: the misreadings that refuse it; ``beside``: those that do not; ``refused``: why it
    was refused without naming a mistake; ``noise``, ``moved``: of its fit.
    """

    found: tuple[Interpretation, ...] = ()
    beside: tuple[Interpretation, ...] = ()
    refused: str = ""
    noise: float = np.nan
    moved: float = np.nan

    @property
    def kinds(self) -> list[str]:
        """Kinds that were told, best first."""
        return [m.kind for f in (*self.found, *self.beside) for m in f.mistakes]


@dataclass(frozen=True)
class Line:
    """One campaign: see the module."""

    case: str
    machine: str
    seed: int
    group: str
    truth: str
    shows: bool
    named: bool
    mended: bool | None
    refused: bool
    seconds: float
    told: str


ENVIRONMENT = ("payload", "dir_", "vel_", "temperature")


def ask_diagnosis(folder: Path) -> Answer:
    """Return what diagnosis says: mistakes of columns that only effects depend on show there."""
    try:
        result = diagnose(folder / "mechanism.yaml", [folder / "data.csv"])
    except InterpretationError as error:
        return Answer(error.found, refused="" if error.found else str(error))
    except PpmcalError as error:
        return Answer(refused=str(error))
    return Answer(noise=result.record.ratio_after or 0.0, moved=0.0)


def ask(folder: Path) -> Answer:
    """Return what identification says of a folder's campaign."""
    paths = folder / "mechanism.yaml", [folder / "data.csv"]
    try:
        machine, datasets = prepared(*paths)
        found: tuple[Interpretation, ...] = ()
        refused, noise, moved = "", float("nan"), float("nan")
        try:
            record = identify(*paths).record
            noise = record.noise.sigma_ratio or 0.0
            times = [p.error / p.tolerance for p in record.parameters
                     if p.status == "identified" and p.error is not None and p.tolerance]
            moved = float(np.sqrt(np.mean(np.square(times)))) if times else 0.0
        except InterpretationError as error:
            found, refused = error.found, "" if error.found else str(error)
        beside = tuple(m for d in datasets for m in plain_mistakes(d, machine, found))
    except PpmcalError as error:
        return Answer(refused=str(error))
    return Answer(found, beside, refused, noise, moved)


def shows(folder: Path) -> bool:
    """Whether a campaign as written is beyond what a short fit explains."""
    try:
        machine, datasets = prepared(folder / "mechanism.yaml", [folder / "data.csv"])
        return score(Problem(machine, datasets, machine.free), np.inf).noise > TELLING
    except (PpmcalError, np.linalg.LinAlgError):
        return True


def mended(folder: Path, answer: Answer, asked: Callable[[Path], Answer]) -> bool | None:
    """Return whether the block proposed mends the file, None where the user has to."""
    block = next((f.block for f in (*answer.found, *answer.beside) if f.block is not None), None)
    if block is None:
        return None
    other = folder / "mended"
    other.mkdir()
    for name in ("mechanism.yaml", "data.csv"):
        (other / name).write_bytes((folder / name).read_bytes())
    sidecar = yaml.safe_load((folder / "data.yaml").read_text(encoding="utf-8"))
    (other / "data.yaml").write_text(yaml.safe_dump({**sidecar, "read": block}), encoding="utf-8")
    again = asked(other)
    return not again.refused and again.noise <= AT_NOISE and again.moved <= INSIDE


def named(truth: dict[str, Any], answer: Answer) -> bool:
    """Whether the mistakes of the truth are told."""
    told = {m.kind: m for f in (*answer.found, *answer.beside) for m in f.mistakes}
    if "other-machine" in truth["kinds"]:
        return "other-machine" in told
    if "a diameter for a radius" in answer.refused:
        return [w["kind"] for w in truth["mistakes"]] == ["radius"]    # home cannot be reached
    for wrong in truth["mistakes"]:
        kind = next((k for k in (wrong["kind"], *wrong["accept"]) if k in told), None)
        if wrong["kind"] not in KINDS:
            continue    # on no list
        if kind is None:
            return False
        rows = set(told[kind].rows)
        if wrong["kind"] == "stale" and not rows >= set(wrong["rows"]):
            return False
        if wrong["kind"] != "stale" and wrong["rows"] and not _about(rows, set(wrong["rows"])):
            return False
    return bool(answer.kinds)


def _about(told: set[int], true: set[int]) -> bool:
    """Whether a mistake of some rows is told of these: a few may be right by chance."""
    return len(told & true) >= NEARLY * len(true) and len(told - true) <= (1 - NEARLY) * len(true)


def judged(case: str, machine: str, seed: int, rows: int, eta: float, folder: Path) -> Line:
    """Write one campaign, ask, and judge."""
    truth = write(case, machine, rows, seed, folder, eta)
    columns = [c for m in truth["mistakes"] for c in m["columns"]]
    asked = ask_diagnosis if columns and all(c.startswith(ENVIRONMENT) for c in columns) else ask
    start = time.monotonic()
    answer = asked(folder)
    seconds = time.monotonic() - start
    group = truth["group"]
    wrong = [k for k in truth["kinds"] if k in KINDS] if group == "mistake" else []
    other = bool(wrong) or group == "mistake"
    said = " ".join(answer.kinds) or answer.refused or (
        f"fit {answer.noise:.2f} times the noise, geometry {answer.moved:.1f} tolerances")
    return Line(case, machine, seed, group, " ".join(truth["kinds"]),
                shows(folder) if other else False, bool(wrong) and named(truth, answer),
                mended(folder, answer, asked) if wrong else None,
                not other and bool(answer.found or answer.refused), seconds, said)


def chosen(groups: Sequence[str], cases: Sequence[str], machines: Sequence[str]
           ) -> Iterator[tuple[str, str]]:
    """Yield cases of the groups, or those named, with the machines they fit."""
    for name, case in CASES.items():
        if name in cases or (not cases and case.group in groups):
            yield from ((name, m) for m in case.machines if m in machines)


def table(lines: Iterable[Line], by_machine: bool) -> str:
    """Return the table, one line per case or per case and machine, in Markdown."""
    groups: dict[str, list[Line]] = defaultdict(list)
    for line in lines:
        groups[f"{line.case}, {line.machine}" if by_machine else line.case].append(line)
    out = ["| case | campaigns | named | where it shows | mended | refused | s, median | s, most |",
           "|---|---|---|---|---|---|---|---|"]
    everything = [line for own in groups.values() for line in own]
    for name, own in (*groups.items(), ("all", everything)):
        seconds = [line.seconds for line in own]
        told = [line for line in own if line.mended is not None]
        seen = [line for line in own if line.shows]
        out.append(
            f"| {name} | {len(own)} | {sum(line.named for line in own)} | "
            f"{sum(line.named for line in seen)} of {len(seen)} | "
            f"{sum(bool(line.mended) for line in told)} of {len(told)} | "
            f"{sum(line.refused for line in own)} | {np.median(seconds):.1f} | "
            f"{max(seconds):.1f} |")
    return "\n".join(out)


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="wild_study", description=__doc__.splitlines()[0])
    parser.add_argument("--groups", nargs="*", default=["mistake"])
    parser.add_argument("--cases", nargs="*", default=[])
    parser.add_argument("--machines", nargs="*", default=list(MACHINES))
    parser.add_argument("--seeds", nargs="*", type=int, default=[1])
    parser.add_argument("--rows", type=int, default=120)
    parser.add_argument("--eta", type=float, default=1.0)
    parser.add_argument("--every", action="store_true", help="a line per machine in the table")
    parser.add_argument("--out", type=Path, help="CSV of all campaigns")
    args = parser.parse_args(argv)
    lines: list[Line] = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in args.seeds:
            for case, machine in chosen(args.groups, args.cases, args.machines):
                place = Path(folder) / f"{case}-{machine}-{seed}"
                lines.append(judged(case, machine, seed, args.rows, args.eta, place))
                sys.stderr.write(json.dumps(list(asdict(lines[-1]).values())) + "\n")
    if not lines:
        parser.error("no case of that name fits those machines")
    if args.out:
        with args.out.open("w", newline="", encoding="utf-8") as file:
            kept = csv.DictWriter(file, list(asdict(lines[0])))
            kept.writeheader()
            kept.writerows(asdict(line) for line in lines)
    sys.stdout.write(table(lines, args.every) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
