"""``export joints``: LinuxCNC's compensation files, one for each actuator."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ppmcal.controllers.export import (
    Exported,
    NotExpressed,
    Number,
    effect_lacking,
    misread,
    refuse,
)
from ppmcal.controllers.joints.tables import (
    MOST,
    CorrectionTable,
    drives_of_unequal_limbs,
    format_triplets,
    joint_effects,
    joint_parameters,
    joint_tables,
    known_limits,
    parse_triplets,
    table_command,
)
from ppmcal.controllers.pose_errors import ErrorSummary, pose_errors
from ppmcal.controllers.pose_grid import at_rest, completed_poses, default_grid, instrument_notes
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.kinematics.partial_pose import inverse_partial, pose_motor
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import NOTE, Note

SEED = 1
MOST_TRIED = 500
"""Poses of the grid at which tables are tried, each in two directions."""


def export(mechanism: Mechanism, old: Path | None, poses: Path | None) -> Exported:
    """Return the machine's joints as tables; see :class:`ppmcal.controllers.export.Exporter`."""
    refuse(old, "--old", "joint tables replace the present ones, whatever they hold",
           "Leave it out; measure with the present tables switched off")
    refuse(poses, "--poses", "joint tables go along the joints, not over poses",
           "Leave it out, or export `grid`")
    tables = joint_tables(mechanism)
    trial = trial_commands(mechanism, SEED)
    after = predicted_errors(mechanism, trial, tables)
    return Exported(
        "joints", "joint table", _files(tables),
        "the tables hold what each joint does by itself", tuple(_numbers(mechanism, tables)),
        f"{len(trial.q) // 2} poses of a box about home, each come to in two directions",
        predicted_errors(mechanism, trial), after, tuple(_not_expressed(mechanism, tables, trial)),
        tuple(_notes(mechanism, tables)), tuple(_advice(tables)),
        {"type": 0, "seed": SEED, "rows": after.count,
         "tables": {t.actuator: {"file": file_name(t), "points": len(t.table.nominal),
                                 "unit": t.unit, "interpolation_error": t.error}
                    for t in tables}}, trial.asked)


def file_name(table: CorrectionTable) -> str:
    """Return the name of an actuator's file."""
    return f"{table.actuator}.comp"


def _files(tables: tuple[CorrectionTable, ...]) -> dict[str, str]:
    """Return the files, read back."""
    out = {}
    for own in tables:
        text = format_triplets(own.table)
        if parse_triplets(text, file_name(own)) != own.table:
            raise misread(file_name(own), "the lines read back as another table")
        out[file_name(own)] = text
    return out


def _numbers(mechanism: Mechanism, tables: tuple[CorrectionTable, ...]) -> Iterator[Number]:
    """Yield what the tables add at most, how much directions differ, and how many points."""
    for own in tables:
        n, forward, reverse = (np.array(c) for c in (own.table.nominal, own.table.forward,
                                                     own.table.reverse))
        added = np.concatenate([n - forward, n - reverse])
        yield Number(f"{own.actuator} added", None, float(added[np.argmax(np.abs(added))]),
                     own.unit)
        apart = forward - reverse
        yield Number(f"{own.actuator} forward - reverse", None,
                     float(apart[np.argmax(np.abs(apart))]), own.unit)
        yield Number(f"{own.actuator} points", None, float(len(n)), "")


def _not_expressed(mechanism: Mechanism, tables: tuple[CorrectionTable, ...], trial: TrialCommands
           ) -> Iterator[NotExpressed]:
    """Yield what tables of single joints cannot hold."""
    names = mechanism.names
    drives = joint_parameters(mechanism)
    others = {*drives, *(p for e in mechanism.effects for p in e.parameters.values())}
    changed = [i for i, p in enumerate(mechanism.parameters)
               if i not in others and p.value != p.nominal]
    if changed:
        g = mechanism.values.copy()
        g[drives] = mechanism.nominals[drives]
        alone = replace(mechanism.with_values(g), effects=())
        yield NotExpressed(f"the geometry beside the joints, {len(changed)} changed numbers",
                           tuple(names[p] for p in changed),
                           predicted_errors(alone, trial))
    shared, short = drives_of_unequal_limbs(mechanism), [t for t in tables if t.coarse]
    if shared or short:
        cost = predicted_errors(joints_alone(mechanism), trial, tables)
        if shared:
            yield NotExpressed(
                f"limbs on one drive, {', '.join(shared)}, with joint errors of their own: the "
                "table has their mean",
                tuple(names[p] for p in drives), cost)
        if short:
            yield NotExpressed(f"what {MOST} points cannot follow of "
                               f"{', '.join(t.actuator for t in short)}", (), cost)
    held = joint_effects(mechanism)
    for effect in mechanism.effects:
        if effect not in held and not effect.kind.instrument:
            needs = effect.kind.needs
            why = (f"which depends on {', '.join(needs)} and is not in the figures either"
                   if needs else "which acts on more than the joints")
            yield effect_lacking(mechanism, effect, f", {why}")


def joints_alone(mechanism: Mechanism) -> Mechanism:
    """Return the nominal machine with the real drives: ratios, offsets and joint effects."""
    g = mechanism.nominals.copy()
    drives = joint_parameters(mechanism)
    g[drives] = mechanism.values[drives]
    effects = joint_effects(mechanism)
    own = [p for e in effects for p in e.parameters.values()]
    g[own] = mechanism.values[own]
    return replace(mechanism.with_values(g), effects=effects)


def _notes(mechanism: Mechanism, tables: tuple[CorrectionTable, ...]) -> Iterator[Note]:
    """Yield what a user should know of the numbers."""
    worst = max(tables, key=lambda t: t.error * t.factor)
    size = f"{worst.error:.2g} {worst.unit}".rstrip()
    yield Note(f"between its points a table is off by {size} at most ({worst.actuator})", NOTE)
    yield Note("forward is written so that the command plus nominal - forward is right; it differs "
               "from the joint's actual position there by errors times slopes", NOTE)
    known = known_limits(mechanism)
    for t, have, want in zip(tables, known, mechanism.limits, strict=True):
        if have[0] > want[0] or have[1] < want[1]:
            yield Note(f"the table of {t.actuator} ends at {have[0] / t.factor:.6g} and "
                       f"{have[1] / t.factor:.6g} {t.unit}".rstrip() + ": beyond, an effect of the "
                       "model is not known", NOTE)
    bare = [t.actuator for t in tables if not t.unit]
    if bare:
        yield Note(f"{', '.join(bare)} counts in the mechanism file's bare numbers: so must the "
                   "controller's joint", NOTE)
    yield from instrument_notes(mechanism)


def _advice(tables: tuple[CorrectionTable, ...]) -> Iterator[Note]:
    """Yield what LinuxCNC's own documents and source ask for."""
    units = sorted({t.unit for t in tables if t.unit})
    name = file_name(tables[0])
    yield Note(f"For each joint, in its section [JOINT_n]: COMP_FILE = {name} (and so on), "
               "COMP_FILE_TYPE = 0. BACKLASH is not used then."
               + (f" The numbers are in {' and '.join(units)}." if units else ""), NOTE)
    yield Note(
        "LinuxCNC uses the tables while it homes. After homing to a switch, without an index "
        "or an absolute encoder, it counts from the table's value there: lower HOME_OFFSET by "
        "nominal - forward at the switch (reverse, if the last approach goes down), and home "
        "twice after switching on.", NOTE)
    yield Note("Where the directions differ the joint makes a jump on reversal: leave the step "
               "generator or drive 1.5 to 2 times MAX_ACCELERATION.", NOTE)


@dataclass(frozen=True, eq=False)
class TrialCommands:
    """Commands to try tables with.

    ``asked``: commanded poses (N, 6), nan where open; ``q``: nominal joint values for them
    (N, k); ``way``: direction in which each joint comes (N, k).
    """

    asked: Array
    q: Array
    way: Array


def trial_commands(mechanism: Mechanism, seed: int) -> TrialCommands:
    """Return the poses of the default grid, thinned, each with drawn and opposite directions."""
    poses = default_grid(mechanism).poses(mechanism)
    rng = np.random.default_rng(seed)
    if len(poses) > MOST_TRIED:
        poses = poses[np.sort(rng.choice(len(poses), MOST_TRIED, replace=False))]
    q = inverse_partial(Model(mechanism.nominal()), poses).q
    way = rng.choice([-1.0, 1.0], q.shape)
    return TrialCommands(np.tile(poses, (2, 1)), np.tile(q, (2, 1)), np.concatenate([way, -way]))


def predicted_errors(mechanism: Mechanism, trial: TrialCommands,
                     tables: Sequence[CorrectionTable] = ()) -> ErrorSummary:
    """Return how far the machine, driven with tables or without, is from what was asked."""
    q = trial.q.copy()
    for a, own in enumerate(tables):
        q[:, a] = table_command(own.table, own.factor, q[:, a], trial.way[:, a])
    rows = replace(at_rest(mechanism, len(q)), approach=trial.way)
    return pose_errors(mechanism, reached_poses(Model(mechanism), q, rows).pose,
                       pose_motor(completed_poses(mechanism, trial.asked)))
