"""``ppmcal compensate``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from ppmcal.cli.common import (
    FILE,
    Console,
    command_line,
    finish,
    input_columns,
    json_option,
    leave,
    number,
    out_option,
    quiet_option,
)

if TYPE_CHECKING:
    from ppmcal.calibration.compensation import Compensation, Knowledge
    from ppmcal.io.poses import PoseTable
    from ppmcal.model.mechanism import Mechanism, Registration


@click.command("compensate")
@click.argument("model", type=FILE)
@click.argument("targets", type=FILE)
@out_option("compensated")
@click.option("--frame", metavar="NAME", default=None,
              help="Data set whose measuring frame the targets are in, or 'base' for platform "
              "poses in the base frame  [default: the model's only data set].")
@click.option("--knowledge", type=FILE, default=None,
              help="identification.json of MODEL  [default: beside it].")
@click.option("--approach", type=click.Choice(["columns", "sequence"]), default="columns",
              show_default=True, help="Directions of approach: from dir_ columns, or from the "
              "order of the targets.")
@quiet_option
@json_option
def command(model: Path, targets: Path, out: Path, frame: str | None, knowledge: Path | None,
            approach: str, quiet: bool, as_json: bool) -> None:
    """Turn the wanted poses TARGETS into corrected commands of the identified MODEL.

    Rows outside limits, across singularities or far outside the measured volume are refused,
    each with its reason. Writes commands.csv and commands.json.
    """
    from ppmcal.calibration.compensation import compensate
    from ppmcal.calibration.model_averaging import Targets, averaged
    from ppmcal.io import Output, provenance, read_mechanism, read_poses
    from ppmcal.io.results.knowledge import read_knowledge
    from ppmcal.io.results.other_models import read_other_models
    from ppmcal.io.results.tables import command_files

    console = Console(quiet, as_json)
    mechanism = read_mechanism(model)
    registration, name = _frame(mechanism, frame)
    path = knowledge or model.with_name("identification.json")
    known: Knowledge | None = None
    notes = list(mechanism.findings)
    if knowledge is not None or path.exists():
        known = read_knowledge(path, mechanism)
    else:
        notes.append(f"{path} is not there: uncertainties and the measured volume are unknown, "
                     "so poses far outside it are not refused")
    poses = read_poses(targets, mechanism)
    _enough(mechanism, poses, targets, approach == "sequence")
    result = compensate(mechanism, poses.poses, registration, known, name, poses.conditions,
                        approach == "sequence")
    readings, more = read_other_models(model, mechanism)
    wanted = Targets(poses.poses, name, poses.conditions, approach == "sequence")
    result, told = averaged(mechanism, result, readings, known, wanted)
    _refuse_worse(mechanism, result, model)
    notes += told
    header, columns = input_columns(targets)
    inputs = [*mechanism.inputs, str(targets), *([str(path)] if known else []), *more]
    source = provenance(inputs, command_line(), None)
    with Output(out) as output:
        for file, text in command_files(mechanism, result, header, columns, source,
                                        notes).items():
            output.add(file, text)
    refused = [(n + 1, r) for n, (s, r) in enumerate(zip(result.status, result.reason, strict=True))
               if s != "ok"]
    total = len(result.status)
    factor, unit = mechanism.units.factor("length"), mechanism.units.length
    console.say(f"{mechanism.name}: {total - len(refused)} of {total} targets have commands, in "
                f"the frame of {name or 'the base'}.")
    before, after = (None if e is None else e / factor for e in _rms_errors(result))
    if before is not None:
        console.say(f"Predicted position error: {number(before)} {unit} rms with uncorrected "
                    f"commands. Corrected: {number(after)} {unit} rms, which is how well the "
                    f"measurements know the machine in the frame of {name or 'its base'}"
                    f"{', with what they leave unexplained' * _unexplained(known)}.")
    console.warn_rows(notes, [f"row {n} refused: {r}" for n, r in refused])
    finish(out, list(output.files), console)
    console.summary({"format": "ppmcal/commands/1", "rows": total, "refused": len(refused),
                     "notes": notes, "provenance": source})
    leave(bool(refused))


def _unexplained(known: Knowledge | None) -> bool:
    return known is not None and any(known.unexplained)


def _rms_errors(result: Compensation) -> tuple[float | None, float | None]:
    """Return the rms position errors predicted without and with correction, m; None if unknown."""
    import numpy as np

    good = np.isfinite(result.q).all(axis=1) & np.isfinite(result.position_before)
    if not good.any():
        return None, None
    before = float(np.sqrt(np.mean(result.position_before[good] ** 2)))
    left = np.hypot(np.nan_to_num(result.position_after[good]), result.sigma_position[good])
    return before, float(np.sqrt(np.mean(left**2))) if np.isfinite(left).all() else None


def _refuse_worse(mechanism: Mechanism, result: Compensation, model: Path) -> None:
    """Refuse corrections that are predicted to be worse than none.

    Raises:
        NoResult: with both predictions.
    """
    from ppmcal.errors import NoResult

    before, after = _rms_errors(result)
    if before is None or after is None or after <= before:
        return
    factor, unit = mechanism.units.factor("length"), mechanism.units.length
    raise NoResult(
        f"these corrections are predicted to be worse than none: {after / factor:.3g} {unit} rms "
        f"with them, {before / factor:.3g} {unit} without", str(model),
        "Send the uncorrected commands; or measure more, or at these poses, and identify again")


def _enough(mechanism: Mechanism, poses: PoseTable, targets: Path, sequence: bool) -> None:
    """Refuse targets that lack a column which the machine's effects depend on."""
    import numpy as np

    from ppmcal.errors import BadInput
    from ppmcal.kinematics.effect_response import missing_columns
    from ppmcal.model.dataset import environment

    n = len(poses.rows)
    # in a sequence every joint's direction follows from the order
    joints = np.tile(np.arange(n, dtype=float)[:, None], (1, len(mechanism.actuators)))
    rows = environment(poses.conditions, mechanism.actuators, mechanism.gravity, joints, sequence)
    missing = missing_columns(mechanism, rows)
    if missing:
        raise BadInput(f"the model's effects depend on {', '.join(missing)}, which is not there",
                       f"{targets}: header", f"Add the column {missing[0]}")


def _frame(mechanism: Mechanism, frame: str | None) -> tuple[Registration | None, str]:
    """Return the registration that the targets are in, and its name."""
    from ppmcal.errors import BadInput, unknown

    names = list(mechanism.registrations)
    if frame == "base":
        return None, ""
    if frame is None:
        if len(names) == 1:
            return mechanism.registrations[names[0]], names[0]
        what = f"the model knows {len(names)} measuring frames" if names else (
            "the model knows no measuring frame: it was not identified")
        raise BadInput(what, f"{mechanism.source}: measurement.datasets",
                       f"Choose with --frame: {', '.join([*names, 'base'])}")
    if frame not in names:
        raise unknown("data set", frame, [*names, "base"], "--frame")
    return mechanism.registrations[frame], frame
