"""Misreadings that no test holds, and right files with real faults: what is said of each.

    python benchmarks/held_back_readings.py --seeds 11 12
    python benchmarks/held_back_readings.py --cases "rows late, dense" --out lines.csv

Every case is a shipped machine, simulated, whose file is then read as a person's mistake would
have it; the transformations are written down here once more and share nothing with the search.
`identify` is asked. One line per campaign: named (the kinds of the truth and no other), set (the
truth is among the alternatives), other (something else is told), refused (no reading is told),
unseen (nothing is told). Of a right file everything but unseen is a false alarm.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

import ppmcal
from ppmcal import identify
from ppmcal.calibration.interpretation import InterpretationError
from ppmcal.commands.inputs import load, shipped
from ppmcal.errors import PpmcalError
from ppmcal.linalg import Array
from ppmcal.model.dataset import Dataset, Unknown
from ppmcal.model.mechanism import Mechanism

Change = Callable[[Dataset, np.random.Generator], Dataset]


@dataclass(frozen=True)
class Case:
    """One campaign: machine, what its scenario says otherwise, the mistake, and its kinds.

    ``accept``: kinds that are as right; ``errors``: of the machine, in place of the scenario's.
    """

    machine: str
    kinds: tuple[str, ...] = ()
    change: Change | None = None
    scenario: Callable[[dict[str, Any]], dict[str, Any]] = lambda s: s
    accept: tuple[str, ...] = ()
    scale: float = 1.0


def other(data: Dataset, **fields: Any) -> Dataset:
    """Return data with other columns, as a reader would have made them."""
    return replace(data, whole=None, place=None, **fields)


def turns(how: Callable[[Rotation], Any]) -> Change:
    """Return the change of what the rotation columns hold; ``how`` gives rad."""
    return lambda data, _: other(data, rotation=np.asarray(
        how(Rotation.from_rotvec(data.rotation))))


def euler(order: str) -> Change:
    return turns(lambda r: r.as_euler(order))


def late(rows: int) -> Change:
    def change(data: Dataset, _: np.random.Generator) -> Dataset:
        n = len(data)
        first, second = max(rows, 0), max(-rows, 0)
        joints = np.arange(first, n - second)
        seen = joints - rows
        return other(data.take(joints), position=data.position[seen], rotation=data.rotation[seen])
    return change


def values(name: str, how: Callable[[Array], Array], begin: float = 0.0, end: float = 1.0
           ) -> Change:
    """Return the change of a field's rows from one part of a file to another."""
    def change(data: Dataset, _: np.random.Generator) -> Dataset:
        inside = slice(int(begin * len(data)), int(end * len(data)))
        field = getattr(data, name).copy()
        field[inside] = how(field[inside])
        return other(data, **{name: field})
    return change


joints, places = partial(values, "q"), partial(values, "position")


def times(*factors: float) -> Callable[[Array], Array]:
    return lambda values: values * np.array(factors)


def order(*columns: int) -> Callable[[Array], Array]:
    return lambda values: values[:, list(columns)]


def inverse(data: Dataset, _: np.random.Generator) -> Dataset:
    back = Rotation.from_rotvec(data.rotation).inv()
    return other(data, position=-back.apply(data.position), rotation=back.as_rotvec())


def left_handed(data: Dataset, _: np.random.Generator) -> Dataset:
    return other(data, position=data.position * [1, -1, 1], rotation=data.rotation * [-1, 1, -1])


def both(*changes: Change) -> Change:
    def change(data: Dataset, rng: np.random.Generator) -> Dataset:
        for one in changes:
            data = one(data, rng)
        return data
    return change


def at_the_origin(data: Dataset, _: np.random.Generator) -> Dataset:
    return other(data, target=Unknown(False, np.zeros(3)))


def burst(data: Dataset, rng: np.random.Generator) -> Dataset:
    """Eight rows in a stretch off by millimetres: somebody leant on the tracker."""
    size = 20.0 * float(np.nanmedian(data.sigma_position))
    position = data.position.copy()
    position[20:28] += rng.normal(size=(8, 3)) * 10.0 * size
    return other(data, position=position)


def small(turn: float, count: int = 70) -> Callable[[dict[str, Any]], dict[str, Any]]:
    """Return the scenario's poses with all turns within ``turn`` degrees."""
    def scenario(text: dict[str, Any]) -> dict[str, Any]:
        random = text["poses"]["random"]
        half = {k: min(v, turn) if k.startswith("r") else v
                for k, v in random["half_range"].items()}
        return {**text, "poses": {"random": {**random, "half_range": half, "count": count}}}
    return scenario


def path(radius: float, count: int, turn: float) -> Callable[[dict[str, Any]], dict[str, Any]]:
    """Return a dense circle about the scenario's centre in place of its poses."""
    def scenario(text: dict[str, Any]) -> dict[str, Any]:
        center = text["poses"]["random"]["center"]
        swing = {k: turn for k in ("rx", "ry", "rz") if k in center}
        circle = {"center": center, "radius": radius, "count": count, "swing": swing}
        return {**text, "poses": {"circle": circle}}
    return scenario


def hidden(*effects: dict[str, Any], approach: str = "both"
           ) -> Callable[[dict[str, Any]], dict[str, Any]]:
    return lambda text: {**text, "effects": [*effects], "approach": approach}


BACKLASH = {"kind": "backlash", "parameters": {"width": 0.15}}
MISREAD: dict[str, Case] = {
    "Euler of turns of 3 deg": Case("linapod", ("rotation",), euler("xyz"), small(3.0)),
    "Euler of turns of 1.5 deg": Case("6-RUS", ("rotation",), euler("ZYX"), small(1.5)),
    "Euler of turns of 4 deg": Case("6-PUS", ("rotation",), euler("XYZ"), small(4.0)),
    "a row late, dense": Case("linapod", ("shifted",), late(1), path(0.1, 250, 3.0)),
    "two rows early, dense": Case("6-PUS", ("shifted",), late(-2), path(60.0, 200, 2.0)),
    "a row late, of three drives": Case("delta-rotary", ("shifted",), late(1)),
    "joints 1 to 3 in a ring": Case("linapod", ("permuted",), joints(order(1, 2, 0, 3, 4, 5))),
    "two joints the other way": Case("6-RUS", ("sign",), joints(times(-1, 1, 1, -1, 1, 1))),
    "left-handed": Case("6-PUS", ("mirrored",), left_handed),
    "inverse, turns of 3 deg": Case("6-RUS", ("inverse",), inverse, small(3.0)),
    "transposed": Case("linapod", ("rotation",), turns(lambda r: r.inv().as_rotvec()),
                       accept=("sign", "inverse")),
    "inches in one drive": Case("delta-linear", ("unit",), joints(times(1, 1 / 25.4, 1))),
    "drives in radians": Case("3-RRR-1", ("unit",), joints(lambda q: q * np.pi / 180.0)),
    "y and z exchanged, and rx turned": Case(
        "6-PUS", ("exchanged", "sign"), both(places(order(0, 2, 1)), lambda d, _: other(
            d, rotation=d.rotation * [-1, 1, 1])), accept=("mirrored", "rotation")),
    "a sign in a fifth of the rows": Case(
        "linapod", ("mirrored",), places(times(-1, 1, 1), 0.5, 0.7)),
    "drives exchanged from row 40": Case(
        "6-RUS", ("permuted",), joints(order(0, 1, 3, 2, 4, 5), 0.55)),
    "target closed": Case("6-RUS", ("target",), at_the_origin),
}
RIGHT: dict[str, Case] = {
    "right": Case("linapod"),
    "right, dense": Case("delta-rotary", scenario=path(60.0, 200, 0.0)),
    "backlash of every drive": Case("6-PUS", scenario=hidden(BACKLASH)),
    "periodic and gain": Case("6-PUS", scenario=hidden(
        {"kind": "periodic", "on": ["leg2"], "parameters": {"period": 20, "cos": 0.1}},
        {"kind": "gain", "on": ["leg4"], "parameters": {"gain": 4e-4}})),
    "a burst": Case("linapod", change=burst),
    "a burst, of three drives": Case("delta-rotary", change=burst),
    "three times its tolerances": Case("6-RUS", scale=3.0),
    "millimetres off": Case("6-PUS", scale=6.0),
    "backlash in the plane": Case("3-RRR-1", scenario=hidden(
        {"kind": "backlash", "parameters": {"width": 0.05}})),
}


@dataclass(frozen=True)
class Line:
    """What was said of one campaign."""

    case: str
    seed: int
    truth: str
    answer: str
    told: str
    seconds: float


def made(case: Case, seed: int) -> tuple[Mechanism, Dataset]:
    """Simulate a case and read it as it is read."""
    text = yaml.safe_load(shipped(case.machine, True).read_text(encoding="utf-8"))
    text = case.scenario({**text, "seed": seed, "errors": {"random": {"scale": case.scale}}})
    machine = load(shipped(case.machine))
    data = ppmcal.simulate(machine, text).data[0]
    return machine, case.change(data, np.random.default_rng(seed)) if case.change else data


def judged(name: str, case: Case, seed: int) -> Line:
    """Ask about one case and compare."""
    machine, data = made(case, seed)
    start = time.process_time()
    kinds: list[str] = []
    told, answer = "", "unseen"
    try:
        record = identify(machine, data).record
        told = f"noise {record.noise.sigma_ratio or 0.0:.2f}"
    except InterpretationError as error:
        sets = [{m.kind for m in found.mistakes} for found in error.found]
        kinds = sorted(set().union(*sets))
        ways = [{m.kind for m in way.mistakes} for found in error.found
                for way in getattr(found, "alternatives", ())]
        right = _right(case, set(kinds))
        answer = ("named" if right else "set" if any(_right(case, w) for w in ways)
                  else "other" if kinds else "refused")
        told = " ".join(kinds) + "".join(f" or {' '.join(sorted(w))}" for w in ways)
        told = told or error.what
    except PpmcalError as error:
        answer, told = "refused", str(error)
    return Line(name, seed, " ".join(case.kinds), answer, told[:90],
                round(time.process_time() - start, 2))


def _right(case: Case, kinds: set[str]) -> bool:
    return bool(kinds) and (kinds == set(case.kinds) or kinds <= set(case.accept))


def table(lines: Sequence[Line]) -> str:
    """Return what was said, in Markdown."""
    out = ["| case | truth | named | set | other | refused | unseen | told |", "|---" * 8 + "|"]
    for name in dict.fromkeys(line.case for line in lines):
        own = [line for line in lines if line.case == name]
        count = Counter(line.answer for line in own)
        each = " | ".join(str(count[k]) for k in ("named", "set", "other", "refused", "unseen"))
        told = "; ".join(dict.fromkeys(line.told for line in own))
        out.append(f"| {name} | {own[0].truth or 'none'} | {each} | {told} |")
    for what, some in (("misread", [x for x in lines if x.truth]),
                       ("right", [x for x in lines if not x.truth])):
        count = Counter(line.answer for line in some)
        out.append(f"{what}: {len(some)} campaigns, " + ", ".join(
            f"{n} {k}" for k, n in count.most_common())
            + f"; {sum(x.seconds for x in some):.0f} s of CPU")
    return "\n".join(out)


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", nargs="*", type=int, default=[11])
    parser.add_argument("--cases", nargs="*", default=[*MISREAD, *RIGHT])
    parser.add_argument("--out", type=Path, help="CSV of all campaigns")
    given = parser.parse_args(argv)
    lines = []
    for seed in given.seeds:
        for name in given.cases:
            lines.append(judged(name, {**MISREAD, **RIGHT}[name], seed))
            sys.stderr.write(f"{lines[-1]}\n")
    if given.out:
        with given.out.open("w", newline="", encoding="utf-8") as file:
            kept = csv.DictWriter(file, list(asdict(lines[0])))
            kept.writeheader()
            kept.writerows(asdict(line) for line in lines)
    print(table(lines))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
