"""Models that no machine is to be commanded by: of an unfinished fit, or that miss their data."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ppmcal.commands.inputs import MODELS
from ppmcal.errors import NoResult
from ppmcal.io.results.knowledge import read_basis
from ppmcal.model.measured import MeasurementBasis
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note

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
    path = knowledge or source.with_name("identification.json")
    if not path.is_file() or (knowledge is None and source.name not in MODELS):
        return own or MeasurementBasis()
    beside = read_basis(path)
    return beside if own is None else replace(own, converged=beside.converged)
