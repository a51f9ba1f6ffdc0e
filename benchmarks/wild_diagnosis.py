"""How well ``ppmcal diagnose`` does on what `benchmarks/wild` lets happen to machines.

    python benchmarks/wild_diagnosis.py --out wild --seeds 1 2
    python benchmarks/wild_diagnosis.py --out wild --groups event --eta 0.5 --minutes 10
    python benchmarks/wild_diagnosis.py --out wild --summary

The generator shares no code with the package. Every campaign is one line of ``wild.csv``; a study
that was stopped goes on where it was. Per campaign:

- right: every true cause, or one that the catalogue says is as right, is named or among what the
  named effect cannot be told from; events with their row, at most two rows away;
- wrong: a named effect that is none of them, with all that it cannot be told from, in whatever
  verdict; a true file that is said to be misread;
- closed: part of the residual's excess over the noise that is gone in poses that no fit has seen,
  by the named effects and then by what was learned.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
import zlib
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
from diagnosis_study import reliability, surely_worse  # noqa: E402
from study_runner import read, remaining, work  # noqa: E402
from study_summary import share  # noqa: E402
from wild.cases import CASES  # noqa: E402
from wild.catalogue import write  # noqa: E402
from wild.machines import MACHINES  # noqa: E402

from ppmcal import diagnose  # noqa: E402
from ppmcal.calibration.interpretation import InterpretationError  # noqa: E402
from ppmcal.errors import PpmcalError  # noqa: E402

GROUPS = ("none", "gross", "event", "memory", "physics")
ONSET = 2
"""Rows by which an event's row may be off."""
NAMED = ("named", "named-set", "partial")


@dataclass(frozen=True)
class Job:
    """One campaign to run."""

    case: str
    machine: str
    seed: int
    rows: int
    eta: float


@dataclass(frozen=True)
class Line:
    """What became of one campaign; one line of wild.csv. ``learned``: inputs of learned terms.

    ``before``, ``after``: residuals over the noise in unseen poses, without and with all that was
    found; ``worse``: whether geometry alone surely predicts poses better; ``said``: the
    probability of each kind, and if it is right.
    """

    group: str
    case: str
    machine: str
    seed: int
    rows: int
    eta: float
    truth: str
    verdict: str
    named: str
    right: int
    alone: int
    wrong: int
    learned: str
    before: str
    after: str
    closed: str
    worse: int
    said: str
    seconds: float


def jobs(groups: Sequence[str], cases: Sequence[str], machines: Sequence[str],
         seeds: Sequence[int], rows: int, eta: float) -> Iterator[Job]:
    """Yield every case of the groups, or those named, on every machine that it fits."""
    for seed in seeds:
        for name, case in CASES.items():
            if name in cases or (not cases and case.group in groups):
                for machine in case.machines:
                    if machine in machines:
                        own = zlib.crc32(f"{seed}|{name}|{machine}".encode()) % 2**20
                        yield Job(name, machine, own, rows, eta)


def run(job: Job) -> Line | None:
    """Write one campaign, diagnose it, judge; None where the case cannot be that large."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        truth = write(job.case, job.machine, job.rows, job.seed, folder, job.eta)
        if not all(e["physical"] for e in truth["effects"]):
            return None
        start = time.perf_counter()
        try:
            found = diagnose(folder / "mechanism.yaml", [folder / "data.csv"]).record
        except InterpretationError as error:
            kinds = " ".join(m.kind for f in error.found for m in f.mistakes)
            return _line(job, truth, {"verdict": f"misread {kinds}".strip()}, start)
        except PpmcalError as error:
            print(f"{job}: {error}", file=sys.stderr)
            return _line(job, truth, {"verdict": "refused"}, start)
        return _line(job, truth, found.entries(), start, surely_worse(found.predictive))


def _line(job: Job, truth: Mapping[str, Any], found: Mapping[str, Any], start: float,
          worse: int = 0) -> Line:
    """Compare a diagnosis with the truth."""
    effects = [e for e in truth["effects"] if e["kind"] != "learned"]
    accept, kinds = set(truth["accept"]), {e["kind"] for e in effects}
    families = [{e["kind"]} | {kind_of(a) for a in e["alternatives"]}
                for e in found.get("effects", ())]
    whole = bool(effects) and len(effects) == len(truth["effects"])
    right = whole and (all(any(k in f for f in families) for k in kinds)
                       or any(f & accept for f in families)) and _in_time(effects, found)
    wrong = sum(not f & (kinds | accept) for f in families)
    wrong += found["verdict"].startswith("misread")
    gap = found.get("gap") or {}
    learned = found.get("learned") or ()
    before, after = gap.get("before"), gap.get("after")
    if learned:
        # each term's gap is that of unseen poses from before it to after it
        after = learned[-1]["gap"]["after"]
        if not families or before is None:
            # of the same rows: those that look like gross errors differ from fit to fit
            before = learned[0]["gap"]["before"]
    return Line(
        truth["group"], job.case, job.machine, job.seed, job.rows, job.eta,
        " ".join(e["kind"] for e in truth["effects"]), found["verdict"],
        "; ".join("/".join(sorted(f)) for f in families), int(right),
        int(right and set().union(*families) <= kinds), wrong,
        " ".join(t["input"] for t in learned), _number(before), _number(after),
        _closed(before, after), worse,
        reliability(((e["kind"], e["probability"], zip(
            map(kind_of, e["alternatives"]), e["probabilities"], strict=True))
            for e in found.get("effects", ())), kinds | accept),
        round(time.perf_counter() - start, 1))


def kind_of(label: str) -> str:
    """Return the kind of an effect from what people call it."""
    return "product" if " x " in label else label.split(" ")[0]


def _in_time(effects: Sequence[Mapping[str, Any]], found: Mapping[str, Any]) -> bool:
    """Whether every event, or what it cannot be told from, was found with its row."""
    rows = [(e["kind"], e["row"]) for e in effects if "row" in e]
    told = [({e["kind"]} | {kind_of(a) for a in e["alternatives"]},
             e["parameters"]["from_row"]["value"]) for e in found.get("effects", ())
            if "from_row" in e["parameters"]]
    return all(any(kind in family and abs(row - at) <= ONSET for family, at in told)
               for kind, row in rows)


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"


def _closed(before: float | None, after: float | None) -> str:
    """Return the part of the excess over the noise that is gone; empty where there is none."""
    if before is None or after is None or before < 1.05:
        return ""
    return f"{1.0 - max(after**2 - 1.0, 0.0) / (before**2 - 1.0):.3f}"


def table(lines: Sequence[Mapping[str, str]]) -> str:
    """Return the study in Markdown."""
    return "\n".join([*_targets(lines), "", *_cases(lines), ""])


def _targets(lines: Sequence[Mapping[str, str]]) -> list[str]:
    def of(group: str) -> list[Any]:
        return [r for r in lines if r["group"] == group and (group in ("none", "gross")
                                                             or "learned" not in r["truth"])]

    unnamed = [r for r in lines if "learned" in r["truth"]]
    shut = [float(r["closed"]) for r in unnamed if r["closed"]]
    rows = [
        ("nothing happened: something said to be there", "at most 5 %",
         share(of("none"), lambda r: r["verdict"] != "none")),
        ("nothing happened: something named", "at most 1 %",
         share(of("none"), lambda r: r["verdict"] in NAMED)),
        *((f"{what}: right, alone or in a set", wanted, share(of(group), _right))
          for what, group, wanted in (
              ("events, with their rows", "event", "at least 95 %"),
              ("memory", "memory", "at least 90 %"), ("physics", "physics", ""))),
        ("of no kind in the list: something named", "at most 1 %",
         share(unnamed, lambda r: int(r["wrong"]) > 0)),
        ("the same: gap closed by what was learned, median", "at least 80 %",
         f"{100 * np.median(shut):.0f} %" if shut else "-"),
        ("all: a wrong name, in whatever verdict", "at most 1 %",
         share(lines, lambda r: int(r["wrong"]) > 0)),
        ("all: geometry alone surely predicts poses better", "never",
         share(lines, lambda r: int(r["worse"]) > 0))]
    return ["| | wanted | found (95 %) |", "|---|---|---|",
            *(f"| {a} | {b} | {c} |" for a, b, c in rows)]


def _right(row: Mapping[str, str]) -> bool:
    return row["right"] == "1"


def _cases(lines: Sequence[Mapping[str, str]]) -> list[str]:
    groups: dict[tuple[str, str], list[Mapping[str, str]]] = defaultdict(list)
    for line in lines:
        groups[line["group"], line["case"]].append(line)
    out = ["| group | case | campaigns | right | alone | wrong | none | unnamed | partial | "
           "gap closed, median | s, median |", "|---" * 11 + "|"]
    for (group, case), own in sorted(groups.items(), key=lambda g: GROUPS.index(g[0][0])):
        count = {v: sum(r["verdict"] == v for r in own) for v in ("none", "unnamed", "partial")}
        shut = [float(r["closed"]) for r in own if r["closed"]]
        closed = f"{100 * np.median(shut):.0f} %" if shut else "-"
        seconds = np.median([float(r["seconds"]) for r in own])
        out.append(f"| {group} | {case} | {len(own)} | {sum(map(_right, own))} | "
                   f"{sum(r['alone'] == '1' for r in own)} | "
                   f"{sum(int(r['wrong']) > 0 for r in own)} | {count['none']} | "
                   f"{count['unnamed']} | {count['partial']} | {closed} | {seconds:.1f} |")
    return out


def main() -> None:
    """Run the study and print its tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("wild"))
    parser.add_argument("--groups", nargs="*", default=list(GROUPS))
    parser.add_argument("--cases", nargs="*", default=[])
    parser.add_argument("--machines", nargs="*", default=list(MACHINES))
    parser.add_argument("--seeds", nargs="*", type=int, default=[1])
    parser.add_argument("--rows", type=int, default=120)
    parser.add_argument("--eta", type=float, default=1.0)
    parser.add_argument("--minutes", type=float, default=0.0, help="stop after this time")
    parser.add_argument("--cores", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--scheduler", help="run on this dask cluster, tcp://HOST:8786")
    parser.add_argument("--summary", action="store_true", help="only print the tables")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / "wild.csv"
    if not given.summary:
        end = time.monotonic() + 60.0 * given.minutes if given.minutes else None
        todo = remaining(path, jobs(given.groups, given.cases, given.machines, given.seeds,
                                    given.rows, given.eta))
        work(path, Line, run, todo, end, given.cores, given.scheduler)
    text = table(read(path))
    (given.out / "summary.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
