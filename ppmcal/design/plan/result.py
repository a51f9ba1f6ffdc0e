"""What a plan is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ppmcal.calibration.knowledge import Scale
from ppmcal.design.plan.candidate_poses import Candidates
from ppmcal.design.plan.information import CandidateInformation, Curve
from ppmcal.design.plan.path import Route
from ppmcal.design.virtual_instrument import Instrument
from ppmcal.linalg import Array, Ints
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note


@dataclass(frozen=True, eq=False)
class Plan:
    """Which measurements to take, in this order, SI.

    Attributes:
        mechanism: nominal, with the effects planned for; instrument: what measures.
        pool: the candidates; open_ended: actuators without limits.
        offer: what could be measured; rows: chosen ones in the order of the route (n,).
        columns: settings of the chosen rows (n,) each.
        gain: by how much log det falls without a row (n,).
        route: the order; ``chosen``: rows in the order of selection.
        planned: accuracy of the nested design after each row; random: mean of random ones.
        best: (rows, position, rotation) of exchanged designs at a few sizes.
        least: fewest rows that determine everything; pays: from where one more hardly helps, 0
            if not within the curve.
        limit: what ever more measurements leave, m and rad.
        reached: rows that reach the wanted accuracy, None if not or not asked; ``about``:
            whether that is an extrapolation.
        observability: O1 to O5 of the plan, and the mean of random designs of the same size.
        efficiency: (det of the plan over that of random ones)^(1/parameters), information per
            row; nan, and no observability, where that comparison is left out.
        tasks: number of task poses; tasks_left_out: reason -> number of the user's that the
            machine cannot take.
        refined: whether the chosen poses were moved in small steps.
        unused: settings that were given and that nothing depends on.
        notes: comparisons that are left out.
        scale: how well joint values alone will show the machine's size, None with an instrument.
    """

    mechanism: Mechanism
    instrument: Instrument
    pool: Candidates
    open_ended: tuple[str, ...]
    offer: CandidateInformation
    rows: Ints
    columns: Mapping[str, Array]
    gain: Array
    route: Route
    chosen: tuple[int, ...]
    planned: Curve
    random: Curve
    best: tuple[tuple[int, float, float], ...]
    least: int
    pays: int
    limit: tuple[float, float]
    reached: int | None
    about: bool
    observability: Mapping[str, Mapping[str, float]]
    efficiency: float
    tasks: int
    tasks_left_out: Mapping[str, int]
    refined: bool
    unused: tuple[str, ...]
    notes: tuple[Note, ...] = ()
    scale: Scale | None = None
