"""Models that miss the measurements they were made from: nobody is to command a machine by them."""

from __future__ import annotations

from pathlib import Path

from ppmcal.api.inputs import MODELS
from ppmcal.errors import NoResult
from ppmcal.io.results.knowledge import read_noise
from ppmcal.model.measured import MeasurementBasis
from ppmcal.model.mechanism import Mechanism

MEND = ("Look with `ppmcal diagnose` for what the model lacks; if the stated noise is too small, "
        "use `identify --sigma estimated`; --regardless takes the model as it is")


def refuse_missed(mechanism: Mechanism, knowledge: Path | None = None, regardless: bool = False
                  ) -> list[str]:
    """Refuse a model whose residuals are far beyond the noise of its own measurements.

    Args:
        mechanism: the model; its file says how well it fits, whatever lies beside.
        knowledge: identification.json to ask where the file is of an older version  [default:
            beside the file].
        regardless: take it all the same.

    Returns:
        What to warn of.

    Raises:
        NoResult: with how far beyond.
        BadInput: the identification.json that is asked cannot be read.
    """
    seen = mechanism.measured or _of_older(mechanism, knowledge)
    if seen is None or not seen.missed:
        return []
    what = (f"the model misses the measurements that it was made from: residuals are "
            f"{seen.sigma_ratio:.3g} times their noise")
    if not regardless:
        raise NoResult(what, mechanism.source, MEND)
    return [f"{what}; taken all the same, with --regardless"]


def _of_older(mechanism: Mechanism, knowledge: Path | None) -> MeasurementBasis | None:
    """Return the noise check of the identification.json beside a file that has none itself."""
    source = Path(mechanism.source)
    path = knowledge or source.with_name("identification.json")
    if not path.is_file() or (knowledge is None and source.name not in MODELS):
        return None
    return read_noise(path)
