"""What commands rest on that no figure says: events, base axes, places that were not measured."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ppmcal.calibration.compensation import Compensation, ParameterCovariance, own_steps, sent
from ppmcal.calibration.knowledge import extrapolated, measured_ranges
from ppmcal.io.poses import PoseTable
from ppmcal.io.results.units import column_factor, parameter_unit
from ppmcal.linalg import finite_rows
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import FIRST_POSE
from ppmcal.notes import NOTE, Note
from ppmcal.wording import abbreviate_list, number, pluralize


def after_events(machine: Mechanism, frame: str) -> Iterator[Note]:
    """Yield which events of the measurements count as lasting, so which machine commands are for.

    Joints homed anew, reflectors or bases that moved: whether somebody undid that since, no data
    can tell. What befell an instrument's view counts in its own frame.
    """
    for effect in machine.effects:
        if not effect.kind.onset or (effect.kind.instrument and (
                not frame or effect.kind.target not in ("", frame))):
            continue
        by = {s.name: effect.parameters[s.name] for s in effect.kind.parameters(machine.motion)}
        row = machine.values[by.pop(effect.kind.onset)]
        sizes = [f"{name} = {number(machine.values[p] / column_factor(machine, name))} "
                 f"{parameter_unit(machine, name)}"
                 for p in by.values() for name in [machine.names[p]]]
        yield Note(f"commands are for the machine as it was from row {row:.0f} of the measurements "
                   f"on, with {abbreviate_list(sizes)}. If that was undone since (homed anew, put "
                   "back), take the effect out of the mechanism file and run compensate again",
                   NOTE)


def loose_axes(machine: Mechanism, known: ParameterCovariance | None, frame: str) -> Iterator[Note]:
    """Yield that base axes are uncertain themselves, where nothing but tolerances holds them."""
    fitted = [n for n, r in machine.registrations.items() if r.frame_pose.any()]
    if known is not None and not frame and known.base_axes is None and fitted:
        yield Note("where the base axes are, only the tolerances of the base say: the predicted "
                   f"errors hold that too, those in a measuring frame (--frame {fitted[0]!r}) do "
                   "not; `frame: {points: ...}` in a sidecar measures the axes", NOTE)


def defined_axes(known: ParameterCovariance | None, frame: str) -> Iterator[Note]:
    """Yield what a promise in base axes rests on: which of several frames, and a nominal pose."""
    axes = None if known is None or frame else known.base_axes
    if known is None or axes is None:
        return
    name, by = axes
    if len(known.frames) > 1:
        yield Note(f"{len(known.frames)} data sets define the base axes: the least certain counts, "
                   f"{by.by} of {name}; how far they disagree is in no predicted error", NOTE)
    if by.by == FIRST_POSE:
        yield Note(f"the base axes are those in which the nominal machine is right at the first "
                   f"pose of {name}: predicted errors hold how well that pose was measured, and "
                   "not what the nominal machine errs there; against axes that anybody could "
                   "measure on the base all targets are off by that together. "
                   "`frame: {points: ...}` in a sidecar measures them", NOTE)


def beyond_measured(found: Compensation, machine: Mechanism,
                    knowledge: ParameterCovariance | None, poses: PoseTable, path: bool
                    ) -> Iterator[Note]:
    """Yield where commands go beyond what was measured, or step beyond what the targets do."""
    good = sent(found)
    ranges = measured_ranges(machine, None if knowledge is None else knowledge.volume)
    yield from extrapolated(machine, found.pose, good, ranges, poses.environment)
    lost = int(np.sum(good & ~finite_rows(found.command)))
    if lost:
        yield Note(f"{pluralize(lost, 'row')} without a corrected pose command (cmd_): the nominal "
                   "geometry has none; send the joint values there", NOTE)
    steps = own_steps(machine, found) if path else None
    if steps is not None and steps.beyond.any():
        worst = int(steps.beyond.argmax())
        joint = int(steps.joint[worst])
        quantity = machine.actuator_quantity[joint]
        factor, unit = machine.units.factor(quantity), machine.units.name(quantity)
        yield Note(
            f"{pluralize(int(np.sum(steps.beyond > 0.0)), 'row')} step beyond their targets' own "
            f"steps, by {steps.beyond[worst] / factor:.3g} {unit} at most "
            f"({machine.actuators[joint]}, row {steps.rows[worst] + 1}): what the model's effects "
            "do there is another than in the row before", NOTE)


def doubts(found: Compensation, machine: Mechanism,
            knowledge: ParameterCovariance | None) -> list[Note]:
    """Return where targets lead through stretches that the model is known to miss."""
    out = []
    units = machine.units
    q = np.where(np.isfinite(found.q), found.q, found.q_nominal)    # refused rows too, for it
    for d in knowledge.doubtful if knowledge else ():
        joint = machine.actuators.index(d.actuator)
        factor, unit = machine.joint_units[joint]
        rows = int(d.holds(q[:, joint]).sum())
        if rows:
            out.append(Note(
                f"{pluralize(rows, 'row')} with {d.actuator} between {d.low / factor:.6g} and "
                f"{d.high / factor:.6g} {unit}: measurements there missed the model by "
                f"{d.position / units.factor('length'):.2g} {units.length} rms and were left out "
                "of the fit; it is in the uncertainty", NOTE))
    return out
