"""From a wanted accuracy to tolerances."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ppmcal.calibration.fit import secondary
from ppmcal.commands.inputs import files_of, load, place_of
from ppmcal.commands.result import Result
from ppmcal.commands.tolerances.options import TolerancesArguments
from ppmcal.design.error_jacobian import Poses, covariance, root_sum_square
from ppmcal.design.error_sources import Source, geometry_only, natural_units, sources
from ppmcal.design.error_sources import tolerances as stated_tolerances
from ppmcal.design.monte_carlo import Fleet
from ppmcal.design.plan.candidate_poses import evenly, region_of
from ppmcal.design.processes import cores as all_cores
from ppmcal.design.recalibration import MeasurementSetup, predicted
from ppmcal.design.tolerance_allocation import Demand, allocate, check, simulate
from ppmcal.design.virtual_instrument import Instrument, default_instrument
from ppmcal.errors import BadInput
from ppmcal.io import read_poses
from ppmcal.io.grid import metric_length, read_point
from ppmcal.io.results.tolerances import ToleranceResult, TolerancesRecord, slot_table
from ppmcal.io.sidecar import read_instrument
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.partial_pose import pose_motor, pose_vector
from ppmcal.kinematics.tables import inverse_table, refuse_singular_home
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note
from ppmcal.store.provenance import source_of
from ppmcal.wording import number
from ppmcal.wording.told import ShortTable

OF_ACCURACY = 0.1
"""Noise of the default instrument, as a part of the accuracy demanded."""
TASKS = 30
"""Task poses where the user gives none."""
SMALLEST = 1e-9
"""Part of the machine's reach, and of a radian: no accuracy below it is one of a machine."""


@dataclass(frozen=True, eq=False, repr=False)
class TolerancesResult(Result):
    """Tolerances with which a machine keeps an accuracy.

    Attributes:
        mechanism: the machine.
        found: tolerances by each method, and the machines that were simulated with them, SI.
        record: the content of tolerances.json.
    """

    COMMAND: ClassVar[str] = "tolerances"
    TABLE: ClassVar[str] = "tolerances.csv"

    mechanism: Mechanism
    found: ToleranceResult
    record: TolerancesRecord

    def files(self) -> Mapping[str, str | bytes]:
        """Return tolerances.csv, errors.csv, allocated.yaml, yield.png and tolerances.json."""
        return dict(self.record.files(self.found))

    def told(self) -> Iterator[str | ShortTable]:
        """Yield what was found in sentences, and the tolerances by slot."""
        yield from self.record.summary
        slots = slot_table(self.found)
        yield f"{slots.title}:"
        yield ShortTable(
            ["slot", "errors", *slots.columns[3:], "unit"],
            [[r[0], str(r[1]), *(number(v, 3) for v in r[3:]), r[2]] for r in slots.rows],
            (1, 2, 3, 4, 5))


def run(asked: TolerancesArguments) -> TolerancesResult:
    """Find tolerances with which a machine keeps an accuracy, and count the machines that do."""
    machine = load(asked.mechanism)
    found = solve(machine, asked)
    source = source_of("tolerances", [*machine.inputs, *files_of(asked.poses, asked.instrument)],
                       asked.seed)
    record = TolerancesRecord.of(found, machine, source)
    return TolerancesResult(source, tuple(record.findings), machine, found, record)


def solve(mechanism: Mechanism, asked: TolerancesArguments) -> ToleranceResult:
    """Return tolerances, and the machines simulated with those of ``asked.method``."""
    machine = geometry_only(mechanism).nominal()
    refuse_singular_home(machine)
    found = sources(machine)
    if not found:
        raise BadInput("no parameter is free, so there is no tolerance to find",
                       f"{mechanism.source}: free", "Give slots a tolerance, or change `free`")
    demand, instrument = _demand(machine, asked), None
    if asked.instrument is not None:
        instrument = read_instrument(asked.instrument, machine)
        if not instrument.kind.of_poses:
            raise BadInput(f"fleets are not measured with the instrument '{instrument.kind}'",
                           f"{asked.instrument}: instrument.kind", "Use pose, position, plane or "
                           "distance")
    tasks, notes = _tasks(machine, asked, _tool(machine, asked, instrument))
    unit = natural_units(machine, found, metric_length(asked.metric, machine))
    weight, exponent = _costs(machine, found, unit)
    given = stated_tolerances(machine, found)
    _refuse_unknown(machine, found, given, asked.method)
    tau = allocate(machine, found, tasks, demand, unit, weight, exponent, given, asked.seed)
    chosen = tau[asked.method]
    free = tuple(s.parameter for s in found)
    nominal = _with_tolerances(machine, free, chosen.tau)
    setup = _measurement_setup(nominal, asked, instrument, demand)
    fleet = Fleet(nominal, free, chosen.drawn, tasks, setup)
    judged = simulate(fleet, asked.machines, asked.seed, asked.cores or all_cores(),
                      asked.scheduler)
    home = Poses(home_state(machine).q[None], machine.home[None], tasks.tool)

    def deviation() -> float | None:
        index = root_sum_square(covariance(Model(machine), home, free, unit))[0][0]
        return None if demand.position is None else demand.position / float(index)

    mean = secondary("the mean deviation at home", deviation, None, notes)
    expected = secondary("what the linear model expects after calibration",
                         lambda: _expected(setup, tasks), None, notes)
    return ToleranceResult(machine, found, demand, tau, asked.method, fleet, judged,
                           check(fleet, judged.built), mean, expected, tuple(notes))


def _demand(machine: Mechanism, asked: TolerancesArguments) -> Demand:
    if not 0.01 <= asked.share <= 0.999:
        raise BadInput(f"{asked.share:g} is not a share of machines", "--yield",
                       "Write a number from 0.01 to 0.999")
    if asked.accuracy is None and asked.rotation is None:
        raise BadInput("no accuracy is demanded", "--accuracy",
                       f"Write the largest allowed error, such as --accuracy 0.05 (in "
                       f"{machine.units.length})")
    if asked.rotation is not None and not machine.motion.turns:
        raise BadInput("this machine does not turn", "--rotation", "Leave it out")
    for name, value in (("--accuracy", asked.accuracy), ("--rotation", asked.rotation)):
        if value is not None and not 0.0 < value < 1e12:
            raise BadInput(f"{value:g} is not the size of an error", name, "Write one above 0")
    return Demand(_size(asked.accuracy, "length", machine), _size(asked.rotation, "angle", machine),
                  asked.share)


def _size(value: float | None, quantity: str, machine: Mechanism) -> float | None:
    """Return a demanded accuracy in SI; refuse one that no machine has, or every machine."""
    if value is None:
        return None
    size = value * machine.units.factor(quantity)
    largest = machine.reach if quantity == "length" else 1.0
    if not SMALLEST * largest <= size <= largest:
        unit, factor = machine.units.name(quantity), machine.units.factor(quantity)
        raise BadInput(f"{value:g} {unit} is implausible", "--accuracy" if quantity == "length"
                       else "--rotation", f"Write {SMALLEST * largest / factor:.2g} to "
                       f"{largest / factor:.3g} {unit}")
    return size


def _tool(machine: Mechanism, asked: TolerancesArguments, instrument: Instrument | None) -> Array:
    """Return the point at which all stages are judged (3,): the tool, else what is measured."""
    if asked.tool is None:
        return np.zeros(3) if instrument is None else instrument.target.value
    known = machine.motion.turns if instrument is None else (
        instrument.kind.sees_rotation and not instrument.target.fitted)
    tool = read_point(asked.tool, machine)
    if tool.any() and not known:
        raise BadInput("a tool point apart from what is measured is not known after a "
                       "calibration", "--tool", "Leave it out, or use an instrument of kind "
                       "pose whose target is known")
    return tool


def _tasks(machine: Mechanism, asked: TolerancesArguments, tool: Array) -> tuple[Poses, list[Note]]:
    """Return the task poses, and which of the user's cannot be used and why."""
    if asked.poses is None:
        chosen = evenly(machine, region_of(machine), TASKS, asked.seed + 1)
        return Poses(chosen.q, pose_motor(chosen.pose), tool), []
    table = inverse_table(Model(machine), read_poses(asked.poses, machine).poses)
    good = np.array([s == "ok" for s in table.status], dtype=np.bool_)
    place = place_of(asked.poses, "poses")
    notes = [Note(f"{place}, row {n + 1}: {table.reason[n]}; not used as a task pose")
                        for n in np.flatnonzero(~good)]
    if not good.any():
        raise BadInput(f"none of the {len(good)} task poses can be reached "
                       f"({table.reason[0]})", place, "Choose poses within limits")
    return Poses(table.q[good], pose_motor(table.pose[good]), tool), notes


def _refuse_unknown(machine: Mechanism, found: tuple[Source, ...], given: Array, method: str
                    ) -> None:
    """Refuse to draw machines with the file's tolerances where one is not known."""
    lost = [machine.parameters[s.parameter].name for s, t in zip(found, given, strict=True)
            if not t > 0.0]
    if lost and method == "file":
        raise BadInput(f"{lost[0]} has no tolerance to draw from ({len(lost)} without)",
                       f"{machine.source}: tolerances", "Give it a finite tolerance, fix it, or "
                       "choose another --method")


def _costs(machine: Mechanism, found: tuple[Source, ...], unit: Array) -> tuple[Array, Array]:
    """Return weight and exponent of each error (S,), for tolerances in SI.

    Classes that the file gives: of a tolerance in file units. Others: 1 and 1, of a tolerance
    as a length (angles by rho), in file units of length.
    """
    weight, exponent = np.ones(len(found)), np.ones(len(found))
    for i, s in enumerate(found):
        quantity = machine.parameters[s.parameter].quantity
        per = machine.units.factor("length") * unit[i]
        if s.tolerance_class in machine.cost:
            weight[i], exponent[i] = machine.cost[s.tolerance_class]
            per = machine.units.factor(quantity)
        weight[i] *= per ** exponent[i]
    return weight, exponent


def _with_tolerances(machine: Mechanism, free: tuple[int, ...], tau: Array) -> Mechanism:
    """Return the machine with these tolerances; errors without effect are left fixed."""
    parameters = list(machine.parameters)
    for p, t in zip(free, tau.tolist(), strict=True):
        if np.isfinite(t) and t > 0.0:
            parameters[p] = replace(parameters[p], tolerance=t)
    kept = tuple(p for p, t in zip(free, tau.tolist(), strict=True) if np.isfinite(t) and t > 0.0)
    return replace(machine, parameters=tuple(parameters), free=kept)


def _expected(setup: MeasurementSetup, tasks: Poses) -> float | None:
    """Return the rms error after calibration that the linear model expects, m."""
    short = setup.mechanism.dependent > 0
    if short or (tasks.tool != setup.instrument.target.value).any():
        return None
    expected = predicted(setup, tasks.q, pose_vector(tasks.motor))
    known = expected[np.isfinite(expected)]
    return float(np.sqrt(np.mean(known**2))) if known.size else None


def _measurement_setup(
    nominal: Mechanism, asked: TolerancesArguments, instrument: Instrument | None, demand: Demand
) -> MeasurementSetup:
    if instrument is None:
        instrument = default_instrument(nominal)
        sigma = OF_ACCURACY * (demand.position or nominal.length_scale * (demand.rotation or 0.0))
        instrument = replace(instrument, sigma_position=sigma,
                             sigma_rotation=sigma / nominal.length_scale)
    measured = evenly(nominal, region_of(nominal), asked.measure, asked.seed + 2)
    return MeasurementSetup(nominal, instrument, measured.q, measured.pose)
