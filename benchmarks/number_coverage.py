"""How often do the 95 % intervals of exported numbers hold? Machines with known errors, exported.

    python benchmarks/number_coverage.py --campaigns 25 --seed 938

A campaign draws a machine's errors from its tolerances, simulates its measurements, identifies it
as ``ppmcal identify`` does and writes it for a controller as ``ppmcal export`` does. The truth of a
number is what the same exporter writes of the machine that was simulated: what a format cannot hold
is no error of its numbers. Numbers that are fixed, by the format or in the model, do not count.

Printed as a Markdown table: of all numbers how many intervals hold the truth. Numbers of one
machine are not independent: the 95 % interval of a rate is Clopper and Pearson's for as many
numbers as spread between campaigns like these (the design effect of cluster samples).
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
import yaml  # noqa: E402
from scipy.stats import beta  # noqa: E402

import ppmcal  # noqa: E402
from ppmcal.controllers import loaded  # noqa: E402
from ppmcal.controllers.number_intervals import with_intervals  # noqa: E402
from ppmcal.errors import PpmcalError  # noqa: E402
from ppmcal.io import read_mechanism  # noqa: E402

CONFIGS = Path(__file__).resolve().parent.parent / "configs"
BELTS = {"instrument": {"kind": "none", "sigma": {"actuator": 0.3}}, "frame": "known"}
RAISED = 430.0
"""By how much the arms of a rotary delta stand above its bed, mm: Klipper's origin is there."""


@dataclass(frozen=True)
class Case:
    """A machine of ``configs`` and the formats that take it.

    ``label``: what is changed in it; ``change``: of its tree in place; ``scenario``: keys in place
    of those of its scenario.
    """

    machine: str
    formats: tuple[str, ...]
    label: str = ""
    scenario: Mapping[str, Any] | None = None
    change: Any = None

    @property
    def words(self) -> str:
        """What the table calls the machine."""
        return f"{self.machine}, {self.label}" if self.label else self.machine


def _leans(tree: dict[str, Any]) -> None:
    tree["limbs"][0]["base"]["direction"] = [0, 0, 1]


def _raised(tree: dict[str, Any]) -> None:
    for limb in tree["limbs"]:
        limb["base"]["point"]["z"] = {"value": RAISED, "fixed": True}
    tree["home"]["pose"]["z"] += RAISED


CASES = (
    Case("delta-linear", ("klipper", "reprap", "marlin")),
    Case("delta-linear", ("klipper", "reprap"), "a tower leans", change=_leans),
    Case("delta-rotary", ("klipper",), f"{RAISED:g} mm above its bed", {"poses": {"random": {
        "center": {"x": 0, "y": 0, "z": RAISED - 380}, "half_range": {"x": 80, "y": 80, "z": 45},
        "count": 60}}}, _raised),
    Case("delta-rotary", ("twincat",)),
    Case("6-UPS", ("linuxcnc",)),
    Case("maslow", ("maslow",)),
    Case("maslow", ("maslow",), "belts alone", BELTS),
    Case("hangprinter", ("hangprinter",)),
)


@dataclass(frozen=True)
class Held:
    """How many intervals of one export hold the truth, ``held`` of ``count``."""

    case: int
    form: str
    held: int
    count: int


@cache
def _trees(case: int) -> tuple[str, str]:
    """Return mechanism file and scenario of a case."""
    one = CASES[case]
    tree, scenario = (yaml.safe_load((folder / f"{one.machine}.yaml").read_text(encoding="utf-8"))
                      for folder in (CONFIGS, CONFIGS / "scenarios"))
    if one.change is not None:
        one.change(tree)
    return yaml.safe_dump(tree, sort_keys=False), yaml.safe_dump(scenario | dict(
        one.scenario or {}))


def campaign(job: tuple[int, int, int]) -> list[Held]:
    """Return what becomes of a campaign: the study's seed, number of its case, its own number."""
    case, seed = job[1], int(np.random.default_rng(job).integers(2**31))
    tree, scenario = _trees(case)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "machine.yaml").write_text(tree, encoding="utf-8")
        machine = ppmcal.load(folder / "machine.yaml")
        made = ppmcal.simulate(machine, yaml.safe_load(scenario) | {"seed": seed})
        try:
            ppmcal.identify(machine, made.data, holdout=0).save(folder / "found")
        except PpmcalError as error:
            print(f"{CASES[case].words}, campaign {job}: {error}")
            return []
        model = folder / "found" / "identified.yaml"
        found, true = read_mechanism(model), machine.with_values(made.campaign.g)
        return [_held(case, form, found, true) for form in CASES[case].formats]


def _held(case: int, form: str, found: Any, true: Any) -> Held:
    writer = loaded(form)
    truth = {n.name: n.new for n in writer.export(true, None, None).numbers}
    numbers = [n for n in with_intervals(found, writer.export(found, None, None)) if n.half]
    held = sum(abs(n.new - truth[n.name]) <= n.half for n in numbers)
    return Held(case, form, held, len(numbers))


def rate(held: Sequence[int], count: Sequence[int]) -> tuple[float, float, float]:
    """Return the part of numbers that hold and its 95 % interval; of campaigns (n,) each.

    >>> [round(v, 3) for v in rate([10, 10], [10, 10])]
    [1.0, 0.832, 1.0]
    """
    k, n = np.array(held, dtype=float), np.array(count, dtype=float)
    own, total = k.sum() / n.sum(), n.sum()
    spread = own * (1.0 - own) * total
    between = np.sum((k - own * n) ** 2) * len(n) / max(len(n) - 1, 1)
    if spread > 0.0 and between > spread:    # numbers of a machine go together
        total *= spread / between
    k = own * total
    low = beta.ppf(0.025, k, total - k + 1.0) if own > 0.0 else 0.0
    high = beta.ppf(0.975, k + 1.0, total - k) if own < 1.0 else 1.0
    return float(own), float(low), float(high)


def table(found: Sequence[Held]) -> list[str]:
    """Return the lines of the table."""
    out = ["| format | machine | campaigns | numbers | hold the truth, % |",
           "|---|---|---|---|---|"]
    for i, case in enumerate(CASES):
        for form in case.formats:
            own = [h for h in found if (h.case, h.form) == (i, form) and h.count]
            if own:
                held, low, high = rate([h.held for h in own], [h.count for h in own])
                out.append(f"| `{form}` | {case.words} | {len(own)} | {sum(h.count for h in own)} "
                           f"| {100 * held:.1f} ({100 * low:.1f}-{100 * high:.1f}) |")
    return out


def main() -> None:
    """Run the study and print its table."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--campaigns", type=int, default=25, help="of each machine")
    parser.add_argument("--seed", type=int, default=938)
    parser.add_argument("--only", nargs="*", help="formats  [default: all]")
    parser.add_argument("--cores", type=int, default=os.cpu_count() or 1)
    asked = parser.parse_args()
    jobs = [(asked.seed, i, n) for i, case in enumerate(CASES) for n in range(asked.campaigns)
            if not asked.only or set(asked.only) & set(case.formats)]
    with multiprocessing.Pool(asked.cores) as pool:
        found = [h for own in pool.imap_unordered(campaign, jobs) for h in own]
    print("\n".join(table(found)))


if __name__ == "__main__":
    main()
