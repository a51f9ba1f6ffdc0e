"""Campaigns of the three generators, each diagnosed and judged; one line for each."""

from __future__ import annotations

import sys
import tempfile
import time
import zlib
from collections.abc import Iterator
from dataclasses import astuple, dataclass
from pathlib import Path

import bodies_study
import diagnosis_study
import numpy as np
import wild_diagnosis
from bodies_world.cases import CASES as WORLDS
from bodies_world.cases import campaign as world_campaign
from bodies_world.machines import MACHINES
from wild.cases import CASES
from wild_diagnosis import GROUPS

HIDDEN = 3
"""Campaigns of each cell of the generator `hidden`, for each seed."""
ROWS = 120
ETA = (0.5, 2.0)
"""Of the generator `wild`: size over the noise, drawn log-uniformly."""
POOR_NOISE = ("none-ar", "none-tails", "none-actuator", "none, ar 0.6", "none, t4",
              "none, 5 % outliers", "none, 10 % outliers", "none, actuator")


@dataclass(frozen=True)
class Job:
    """One campaign to run; ``study`` is the seed of the study, ``own`` that of the campaign."""

    generator: str
    study: int
    case: str
    machine: str
    own: int
    eta: float
    detail: str


@dataclass(frozen=True)
class Line(Job):
    """What became of one campaign.

    ``group``: nothing, poor noise, one, several, event, memory, unknown; ``right``: every cause is
    named, alone or in a set; ``wrong``: names that are none of them, in whatever verdict;
    ``size``: mean number of names in a set, 0 where nothing is named; ``worse``: whether geometry
    alone surely predicts poses left out better than all that may be there together; ``said``: the
    probability of each kind that leads, and whether it is right, as ``0.9731:1``.
    """

    group: str
    verdict: str
    named: str
    right: int
    alone: int
    wrong: int
    size: float
    worse: int
    said: str
    seconds: float


def jobs(seeds: list[int], generators: list[str]) -> Iterator[Job]:
    """Yield the campaigns of all seeds, in turns: what is stopped early has seen every case."""
    for seed in seeds:
        if "bodies" in generators:
            yield from (Job("bodies", seed, name, machine, seed, 0.0, "")
                        for name, world in WORLDS.items()
                        for machine, body in MACHINES.items() if body is world.machine)
        if "wild" in generators:
            yield from _wild_jobs(seed)
        if "hidden" in generators:
            draws = dict.fromkeys((j.cell for j in diagnosis_study.draw(0, seed)), HIDDEN)
            yield from (Job("hidden", seed, j.cell, j.machine, j.seed, j.eta,
                            f"{j.noise}|{j.kinds}|{j.where}")
                        for j in diagnosis_study.jobs(draws, seed))


def _wild_jobs(seed: int) -> Iterator[Job]:
    """Yield every case of `wild` once, on a machine and of a size drawn by the seed."""
    for name, case in CASES.items():
        if case.group in GROUPS:
            own = zlib.crc32(f"{seed}|{name}".encode()) % 2**20
            rng = np.random.default_rng([seed, own])
            eta = float(np.exp(rng.uniform(*np.log(ETA))))
            machine = case.machines[int(rng.integers(len(case.machines)))]
            yield Job("wild", seed, name, machine, own, round(eta, 4), "")


def run(job: Job) -> Line | None:
    """Return what a diagnosis makes of one campaign; None where there can be no such campaign."""
    start = time.perf_counter()
    try:
        found = {"hidden": _hidden, "wild": _wild, "bodies": _bodies}[job.generator](job)
    except Exception as error:  # a fault is a line of the study, not its end
        print(f"{job}: {error!r}", file=sys.stderr)
        found = (_group(job), "fault", "", 0, 0, 0, 0.0, 0, "")
    if found is None:
        return None
    return Line(*astuple(job), *found, round(time.perf_counter() - start, 1))


def _group(job: Job) -> str:
    if job.case in POOR_NOISE or job.case.startswith("gross"):
        return "poor noise" if "backlash" not in job.case else "one"
    if job.generator == "hidden":
        return "nothing" if job.case.startswith("none") else {
            "two": "several", "three": "several"}.get(job.case, job.case.split(",")[0])
    if job.generator == "bodies":
        return "nothing" if not WORLDS[job.case].right else (
            "several" if len(WORLDS[job.case].must) > 1 else "one")
    group = CASES[job.case].group
    return {"none": "nothing", "physics": "one"}.get(group, group)


Judged = tuple[str, str, str, int, int, int, float, int, str]


def _hidden(job: Job) -> Judged | None:
    noise, kinds, where = job.detail.split("|")
    line = diagnosis_study.run(diagnosis_study.Job(job.case, job.machine, job.own, noise, kinds,
                                                   where, job.eta))
    if line is None:
        return None
    return (_group(job), line.verdict, line.named, line.right, line.alone, line.wrong,
            line.set_size, line.worse, line.said)


def _wild(job: Job) -> Judged | None:
    line = wild_diagnosis.run(wild_diagnosis.Job(job.case, job.machine, job.own, ROWS, job.eta))
    if line is None:
        return None
    truth = line.truth.split()
    group = _group(job)
    if "learned" in truth:
        group = "unknown"
    elif group in ("one", "memory") and len(truth) > 1:
        group = "several"
    sizes = [len(f.split("/")) for f in line.named.split("; ") if f]
    return (group, line.verdict.split(" ")[0], line.named, line.right, line.alone, line.wrong,
            float(np.mean(sizes)) if sizes else 0.0, line.worse, line.said)


def _bodies(job: Job) -> Judged:
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        world_campaign(job.case, job.own, folder / "world")
        answer, case = bodies_study.ask(folder / "world"), WORLDS[job.case]
    said = frozenset[str]().union(*answer.named)
    right = bool(case.right) and all(names & said for names in case.must) and bool(answer.named)
    wrong = sum(not names & case.right for names in answer.named)
    sizes = [len(f) for f in answer.named]
    chances = diagnosis_study.reliability(answer.chances, case.right)
    return (_group(job), answer.verdict, answer.text, int(right and not answer.refused),
            int(right and said <= case.right), wrong, float(np.mean(sizes)) if sizes else 0.0,
            answer.worse, chances)
