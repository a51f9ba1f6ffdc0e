"""A mechanism file, alone or with its measurements, before anything is fitted."""

from __future__ import annotations

from ppmcal.api.inputs import Machine, Measurements, prepared
from ppmcal.calibration.check import Check
from ppmcal.calibration.check import check as checked
from ppmcal.io import unit_findings


def check(mechanism: Machine, data: Measurements = ()) -> Check:
    """Check a machine, and what measurements can tell of it.

    Args:
        mechanism: the machine, or its file.
        data: data sets, or paths of measurement files; none: the file alone.

    Returns:
        Gaps and conditioning at home, rank, and findings that need a look.

    Raises:
        BadInput: anything wrong in the files, with file, place and mend.
    """
    machine, datasets = prepared(mechanism, data)
    return checked(machine, datasets, unit_findings(machine, datasets))
