"""What is wrong in each world, and which names for it are right.

The right names follow from how a world is built, and were written down before any answer was seen:

- A spring between encoder and load side gives way by f/k: ``compliance``, of k.
- A load side with Coulomb friction F behind a spring k follows its encoder as the play operator
  of width 2 F/k does (Prandtl's element of a spring and a slider). Where all moves are longer
  that is ``backlash`` of the same size, behind the move; ``hysteresis`` is a sum of such elements,
  ``friction`` its own cause. Any of the four is right. Nothing else acts in the plane: the weight
  is carried by the hinges.
- A platform of two plates on a hinge yields between its joints: ``plate_compliance``, as far
  as one smooth field is like a fold, or ``base_compliance``, the platform's twist in proportion to
  its load by whatever yields outside of the limbs. Each leg's joint gives way under its own load
  too, so that ``compliance`` cannot always be told from it: right beside it in a set, wrong alone.
- A stand on a ball joint with a spring tilts by the moment of the load about that joint. That is
  ``base_compliance``: the base itself stays flat and turns about the ball, whose spring is alike
  about all axes.
- Weight turned against the file, on drives that yield: ``compliance`` and ``gravity_tilt``.
- A platform that weighs something itself is in every world with a load, and in no file.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .files import AXES, LENGTH, TURN, sidecar, table, write
from .machines import DELTA, HEXAPOD, PLANAR, Machine, Shape
from .mjcf import Faults
from .session import Run, measure

RIGID = Faults()
SIGMA = (5e-6, 1.7e-5)
"""Of the instrument, m and rad."""
LOADS = (0.0, 5.0, 10.0, 20.0)
"""Payloads, kg."""
REVERSAL = frozenset(("play", "backlash", "hysteresis", "friction"))


@dataclass(frozen=True)
class Case:
    """A world: what it has, and what may and what must be said of it.

    ``right``: names that are right; ``must``: of each group one has to be named, alone or in a set;
    ``approach``: ``both`` (every pose from below and from above, with columns), ``sequence``
    (short and long moves) or ``far``; ``sizes``: true sizes by kind and parameter, in file units.
    """

    machine: Machine
    faults: Faults = RIGID
    right: frozenset[str] = frozenset()
    must: tuple[frozenset[str], ...] = ()
    approach: str = "far"
    loaded: bool = True
    rows: int = 80
    sizes: dict[str, float] = field(default_factory=dict)


SPRING, TWIST, RUB = 7e5, 8e4, 8.0
WIDTH = float(np.degrees(2.0 * RUB / TWIST))
"""Drives: N/m; N m/rad and N m; width of the play that these leave, deg."""
LEAN = (0.08, -0.05)
STAND = 3e4
"""Of the ball joint below the base, N m/rad."""
COMPLIANCE = frozenset(("compliance",))
FRAME = frozenset(("base_compliance",))
PLATES = frozenset(("plate_compliance", "base_compliance"))
YIELDING = {"compliance.stiffness": SPRING / 1e3}
RUBBING = Faults(drive=TWIST, friction=RUB)
CASES = {
    "hexapod-plain": Case(HEXAPOD),
    "3-RRR-plain": Case(PLANAR, loaded=False),
    "delta-plain": Case(DELTA),
    "hexapod-drives": Case(HEXAPOD, Faults(drive=SPRING), COMPLIANCE, (COMPLIANCE,),
                           sizes=YIELDING),
    "delta-drives": Case(DELTA, Faults(drive=SPRING), COMPLIANCE, (COMPLIANCE,), sizes=YIELDING),
    "3-RRR-rubbing-both": Case(PLANAR, RUBBING, REVERSAL, (REVERSAL,), "both", False,
                               sizes={"backlash.width": -WIDTH, "play.width": WIDTH}),
    "3-RRR-rubbing-sequence": Case(PLANAR, RUBBING, REVERSAL, (REVERSAL,), "sequence", False,
                                   sizes={"backlash.width": -WIDTH, "play.width": WIDTH}),
    "hexapod-fold": Case(HEXAPOD, Faults(fold=2e4), PLATES),
    "hexapod-stand": Case(HEXAPOD, Faults(stand=STAND), FRAME, (FRAME,), rows=50,
                          sizes=dict.fromkeys(("base_compliance.rx_mx", "base_compliance.ry_my"),
                                              float(np.degrees(1.0 / STAND)))),
    "hexapod-lean": Case(HEXAPOD, Faults(drive=SPRING, lean=LEAN), COMPLIANCE | {"gravity_tilt"},
                         (COMPLIANCE, frozenset(("gravity_tilt",))), rows=60, sizes=YIELDING | {
                             "gravity_tilt.first": float(np.degrees(LEAN[0])),
                             "gravity_tilt.second": float(np.degrees(LEAN[1]))}),
}


def targets(case: Case, rng: np.random.Generator) -> np.ndarray:
    """Return joint targets from home (N, L), m or rad."""
    machine, legs = case.machine, len(case.machine.legs)
    if case.approach == "sequence":
        step = machine.reach * 10.0 ** rng.uniform(-4.0, 0.0, (case.rows, 1))
        step = step * rng.uniform(0.5, 1.0, (case.rows, legs))   # what sticks long creeps
        place, out = np.zeros(legs), []
        for move in step * rng.choice([-1, 1], (case.rows, legs)):
            place = np.where(np.abs(place + move) > machine.reach, place - move, place + move)
            out.append(place)
        return np.array(out)
    return machine.reach * rng.uniform(-1, 1, (case.rows, legs))


def taken(case: Case, shape: Shape, rng: np.random.Generator) -> Run:
    """Return the campaign; of approaches from both sides only the poses themselves are kept."""
    at = targets(case, rng)
    if case.approach != "both":
        load = rng.choice(LOADS, len(at)) if case.loaded else np.zeros(len(at))
        return measure(case.machine, shape, case.faults, at, load)
    at, back = at[: case.rows // 2], 0.1 * case.machine.reach
    way = np.stack([at - back, at, at + back, at], axis=1).reshape(-1, at.shape[1])
    run = measure(case.machine, shape, case.faults, way, np.zeros(len(way)))
    return Run(*(part[1::2] for part in (run.q, run.position, run.rotation, run.payload,
                                       run.direction)))


def true_shape(machine: Machine, rng: np.random.Generator) -> Shape:
    """Return a machine with errors of its tolerances."""
    turn = 1e-3 * LENGTH if machine.drive.joint == "slide" else float(np.radians(TURN))
    return machine.shape.wrong(rng, 1e-3 * LENGTH, turn, AXES[machine.motion])


def campaign(name: str, seed: int, folder: Path) -> Shape:
    """Write the files of a world's campaign; return its true geometry."""
    case, rng = CASES[name], np.random.default_rng(seed)
    shape = true_shape(case.machine, rng)
    run = taken(case, shape, rng)
    columns = table(case.machine, run, SIGMA, case.approach == "both", rng)
    approach = {"both": "columns", "sequence": "sequence", "far": "unknown"}[case.approach]
    write(folder, case.machine, columns, sidecar(case.machine, SIGMA, approach))
    return shape
