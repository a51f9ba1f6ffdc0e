"""What the functions take: machines, measurements and tables, from files or from memory."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ppmcal.calibration.fit import with_gauge, with_unknown_directions
from ppmcal.calibration.interpretation import without_stale
from ppmcal.commands.spec import Measurements, Path_
from ppmcal.errors import BadInput, NoResult, unknown
from ppmcal.io import read_campaign, read_mechanism
from ppmcal.io.campaign import datasets_in, joined
from ppmcal.io.dataset_reader import may_be_words, read_files
from ppmcal.io.header import ReadFile
from ppmcal.io.results.knowledge import KNOWLEDGE, MODELS, model_in, read_basis
from ppmcal.io.sidecar import read_sidecar, sidecar_of, sidecar_path
from ppmcal.io.tables import as_table, is_path, read_table
from ppmcal.io.templates import find_template
from ppmcal.kinematics.effect_response import environment_of, with_strokes
from ppmcal.kinematics.needed_columns import ORDER, missing_columns
from ppmcal.kinematics.tables import with_joints
from ppmcal.model.dataset import Dataset, Environment
from ppmcal.model.measured import MeasurementBasis
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.parameters import unmatched
from ppmcal.notes import FINDING, NOTE, Note
from ppmcal.store.inputs import path_errors
from ppmcal.store.runs import RecordedRun, runs_of
from ppmcal.store.transaction import recover
from ppmcal.wording import abbreviate_list

Machine = Mechanism | Path_ | Mapping[str, Any]
"""A mechanism, the path of its file, or what such a file holds."""


def shipped(kind: str, scenario: bool = False) -> Path:
    """Return the path of a mechanism file that comes with ppmcal, or of its scenario.

    Args:
        kind: as ``ppmcal init`` lists them, such as ``6-UPS``.
        scenario: the scenario of that machine in place of the machine.

    Raises:
        BadInput: there is no such kind; the text lists them.
    """
    path = find_template(kind)
    return path.parent / "scenarios" / path.name if scenario else path


def load(source: Machine) -> Mechanism:
    """Return the mechanism of a file, everything in SI.

    Args:
        source: path of a mechanism file, or of a folder that ``identify`` or ``diagnose`` wrote, or
            a mapping with the keys of a file; a mechanism is handed back as it is.

    Raises:
        BadInput: anything wrong in the file, with file, place and hint.

    >>> load(shipped("3-RPR"))
    <mechanism 3-RPR: planar, 3 limbs R(P)R, 12 free parameters>
    """
    if isinstance(source, Mechanism):
        return source
    if not isinstance(source, str | os.PathLike | Mapping):
        raise BadInput(f"a machine is given as {type(source).__name__}", "mechanism",
                       "Give the path of its file, a mapping with its keys, or what load returned")
    with path_errors():
        return read_mechanism(source if isinstance(source, Mapping) else _model_file(Path(source)))


def parameters_of(source: Machine) -> tuple[str, ...]:
    """Return the names of a machine's parameters."""
    return load(source).names


def _model_file(path: Path) -> Path:
    """Return the machine's file of a folder; a file as it is."""
    if not path.is_dir():
        return path
    recover(path)
    if (found := model_in(path)) is None:
        raise BadInput("holds no calibrated machine", str(path),
                       f"Give a folder with {' or '.join(MODELS)}, or a mechanism file")
    return found


def read_data(mechanism: Machine, *sources: Any, sidecar: Mapping[str, Any] | Path_ | None = None,
              name: str = "") -> tuple[Dataset, ...]:
    """Return the data sets of one campaign, everything in SI.

    Args:
        mechanism: the machine that was measured.
        *sources: CSV files with their sidecars beside them; or tables that are in memory: data
            frames or mappings with the columns of such a file (``q_<actuator>``, ``x``, ``y``,
            ``z``, ``rx``, ``ry``, ``rz``, ``height``, ``distance``, ...).
        sidecar: what the YAML beside a file says, for tables in memory: ``units``, ``instrument``,
            ``frame``, ``target``, ...  Left out, units are the mechanism file's, frame and target
            unknown. Or the path of such a YAML.
        name: of a table in memory  [default: table, or table1, table2, ...].

    Raises:
        BadInput: anything wrong in a table or in its sidecar.
    """
    with path_errors():
        return _read_data(load(mechanism), sources, sidecar, name)


def _read_data(machine: Mechanism, sources: Sequence[Any],
               sidecar: Mapping[str, Any] | Path_ | None, name: str) -> tuple[Dataset, ...]:
    paths = [s for s in sources if is_path(s)]
    if len(paths) == len(sources) and sidecar is None:
        found = read_campaign(paths, machine)
    else:
        many = sum(not is_path(s) for s in sources) > 1
        made, count = list[Dataset](), 0
        for source in sources:
            count += not is_path(source)
            label = (name or "table") + (str(count) if many else "")
            made += _of_one(machine, source, sidecar, label)
        found = joined(made)
    return tuple(with_joints(machine, d) for d in found)


def _of_one(machine: Mechanism, source: Any, sidecar: Mapping[str, Any] | Path_ | None,
            label: str) -> list[Dataset]:
    """Return one table with its sidecar as a data set, or as one for each of its targets."""
    loose = may_be_words(ReadFile(), machine)
    if is_path(source):
        path = Path(source)
        if sidecar is None:
            return datasets_in(*read_files(path, machine), machine)
        table = read_table(path, loose=loose)
    else:
        table = as_table(source, (), label, loose)
        if sidecar is None:
            raise BadInput("a table in memory needs its sidecar", label,
                           'Give it, such as sidecar={"instrument": {"kind": "pose", "sigma": '
                           '{"position": 0.01, "rotation": 0.002}}}')
    if not isinstance(sidecar, Mapping):
        return datasets_in(table, *read_sidecar(Path(sidecar)), machine)
    return datasets_in(table, sidecar_of(sidecar, machine), "sidecar", machine)


def prepared(mechanism: Machine, data: Measurements, free: Sequence[str] | str = (),
             needed: bool = True) -> tuple[Mechanism, tuple[Dataset, ...]]:
    """Return machine and data sets of a fit.

    Args:
        mechanism: as in :func:`load`.
        data: data sets (:func:`read_data`), or paths of measurement files; one or several.
        free: patterns of the parameters that may change, in place of the file's; ``none`` for
            frames only: nothing of the machine, effects included.
        needed: whether there have to be measurements.

    Raises:
        BadInput: no measurements, a pattern without a parameter, data without a column that an
            effect needs, or any fault of the files.
    """
    machine = load(mechanism)
    patterns = (free,) if isinstance(free, str) else tuple(free)
    if patterns == ("none",):
        # what a file marks as free is not either
        machine = replace(machine, free=(), optional=())
    elif patterns:
        for pattern in unmatched(machine.parameters, patterns):
            raise unknown("parameter", pattern, machine.names, "--free")
        machine = machine.with_free(patterns)
    datasets = without_stale(datasets_of(machine, data), machine)
    machine = with_gauge(machine, datasets)
    if needed and not datasets:
        raise BadInput("there are no measurements", "data", "Give a data set or a file, or several")
    if machine.effects and datasets:
        machine = with_strokes(machine, np.concatenate([d.q for d in datasets]))
        datasets = with_unknown_directions(machine, datasets, [
            environment_of(machine, d) for d in datasets])
        for d in datasets:
            refuse_unrecorded(machine, environment_of(machine, d),
                              f"the effects of {machine.source}", d.source,
                              lambda _: ", or take the effect out")
        # a machine that came here before says so already
        machine = replace(machine, findings=tuple(dict.fromkeys(
            (*machine.findings, *_of_no_target(machine, datasets)))))
    return machine, datasets


def _of_no_target(machine: Mechanism, datasets: Sequence[Dataset]) -> Iterator[Note]:
    """Yield which effects are of a target that was not measured, so that they do nothing."""
    names = [d.name for d in datasets]
    for i, effect in enumerate(machine.effects):
        target = effect.kind.target
        if target and target not in names:
            hint = unknown("data set", target, names).hint
            yield Note(f"{machine.source}: effects[{i + 1}].target: no data set is called "
                       f"'{target}', so {effect.kind.title} does nothing here. {hint}",
                       FINDING if set(effect.parameters.values()) & {*machine.free} else NOTE)


def datasets_of(mechanism: Mechanism, data: Measurements) -> tuple[Dataset, ...]:
    """Return data sets as they are, and files as data sets."""
    several = [data] if isinstance(data, Dataset) or is_path(data) else list(data)
    if all(is_path(d) for d in several):
        return read_data(mechanism, *several)
    for d in several:
        if not isinstance(d, Dataset):
            raise BadInput(f"measurements are given as {type(d).__name__}", "data",
                           "Give paths, or what read_data returns")
    return joined([d for d in several if isinstance(d, Dataset)])


def refuse_unrecorded(mechanism: Mechanism, rows: Environment, owner: str, place: str,
                      instead: Callable[[str], str] = lambda _: "") -> None:
    """Refuse rows without a column that the effects of ``owner`` depend on.

    Raises:
        BadInput: at ``place``, with the column to add, or what to do ``instead`` of adding it.
    """
    missing = missing_columns(mechanism, rows)
    if missing:
        if ORDER in missing:
            raise BadInput(f"{owner} depend on the order of the rows, each joint moving straight "
                           "from one to the next", place,
                           f"Say `{ORDER}`, or add a column `time`{instead(ORDER)}")
        raise BadInput(f"{owner} depend on {', '.join(missing)}, which is not there",
                       f"{place}: header", f"Add the column {missing[0]}{instead(missing[0])}")


def data_files(datasets: Sequence[Dataset]) -> list[str]:
    """Return the files behind data sets: tables and sidecars, as far as they are files."""
    tables = [Path(d.source) for d in datasets]
    return [str(p) for p in (*tables, *map(sidecar_path, tables)) if p.is_file()]


def place_of(source: Any, what: str) -> str:
    """Return what messages call a table: its path, or ``what`` where it is in memory."""
    return str(source) if is_path(source) else what


def files_of(*sources: Any) -> list[Path_]:
    """Return those of the inputs that are files."""
    return [s for s in sources if s is not None and is_path(s)]


def imports_behind(model: Path) -> Iterator[RecordedRun]:
    """Yield the runs of ``import`` whose files a model, or a folder of results, came from.

    What is recorded of each folder's inputs leads to the folder before.
    """
    folders, seen = [model if model.is_dir() else model.parent], set[str]()
    while folders:
        folder = folders.pop()
        if os.path.realpath(folder) in seen or not folder.is_dir():
            continue
        seen.add(os.path.realpath(folder))
        for run in runs_of(folder):
            if run.command == "import":
                yield run
            else:
                folders += [Path(run.working_folder, name).parent for name in run.source.inputs]


def started(mechanism: Mechanism, start: Path) -> tuple[Mechanism, list[Note]]:
    """Return the machine with the free values of an earlier calibration, and what was odd.

    What that one had measured goes with them.
    """
    other = read_mechanism(start)
    notes = same_machine(mechanism, other, start)
    found = dict(zip(other.names, other.values.tolist(), strict=True))
    g = mechanism.values.copy()
    for p in mechanism.free:
        g[p] = found.get(mechanism.names[p], g[p])
    return replace(mechanism.with_values(g), measured=other.measured), notes


def same_machine(mechanism: Mechanism, other: Mechanism, source: Path) -> list[Note]:
    """Return which fixed values differ between a machine and an earlier file of it.

    Raises:
        BadInput: the limbs are not the same.
    """
    kinds = [{limb.name: limb.kind.name for limb in m.limbs} for m in (mechanism, other)]
    if kinds[0] != kinds[1]:
        raise BadInput("is of another machine: its limbs are not those of "
                       f"{mechanism.source}", str(source),
                       "Give the identified.yaml of an earlier calibration of this machine")
    found = dict(zip(other.names, other.values.tolist(), strict=True))
    free = {mechanism.names[p] for p in mechanism.free}
    apart = [name for i, name in enumerate(mechanism.names)
             if name not in free and found.get(name, mechanism.values[i]) != mechanism.values[i]]
    if not apart:
        return []
    return [Note(
        f"{len(apart)} fixed value{'s' if len(apart) > 1 else ''} are not as in {source}: "
        f"{abbreviate_list(apart)}; use one mechanism file for both")]


HINT = ("Use `ppmcal diagnose` to find what the model lacks; if the stated noise is too small, "
        "use `identify --sigma estimated`; --regardless uses the model as it is")
UNENDED = ("the fit of this model did not converge: its values are where the search stopped, and "
           "commands may be far off")
HINT_UNENDED = ("Run identify again without --iterations, or with more; measure poses that tell "
                "the parameters apart, or free fewer; --regardless uses the model as it is")


def refuse_unfit(mechanism: Mechanism, knowledge: Path | None = None, regardless: bool = False
                 ) -> list[Note]:
    """Refuse a model whose fit had not converged, or whose residuals are far beyond their noise.

    Args:
        mechanism: the model; its file says how well it fits, whatever lies beside.
        knowledge: identification.json to ask where the file is of an older version  [default:
            beside the file].
        regardless: take it all the same.

    Returns:
        What to warn of.

    Raises:
        NoResult: with what is wrong.
        BadInput: the identification.json that is asked cannot be read.
    """
    seen = _basis(mechanism, knowledge)
    refusals = []
    if seen.converged is False:
        refusals.append((UNENDED, HINT_UNENDED))
    if seen.missed:
        refusals.append((f"the model does not fit its own calibration data: residuals are "
                         f"{seen.sigma_ratio:.3g} times the noise", HINT))
    if refusals and not regardless:
        what, hint = refusals[0]
        raise NoResult(what, mechanism.source, hint)
    return [Note(f"{what}; used anyway, because of --regardless") for what, _ in refusals]


def _basis(mechanism: Mechanism, knowledge: Path | None) -> MeasurementBasis:
    """Return what the model's file says of its fit, else the identification.json beside it."""
    own = mechanism.measured
    if own is not None and own.converged is not None:
        return own
    source = Path(mechanism.source)
    path = knowledge or source.with_name(KNOWLEDGE)
    if not path.is_file() or (knowledge is None and source.name not in MODELS):
        return own or MeasurementBasis()
    beside = read_basis(path)
    return beside if own is None else replace(own, converged=beside.converged)
