"""How well the model behind a kinematics.csv is known: its columns, its entry, the sentence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ppmcal.io.results.parts import ErrorSize
from ppmcal.io.results.record import Part, Text
from ppmcal.io.results.tables import unit_map
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording import number

COVARIANCE, SIGMAS, TOLERANCES, NONE = "covariance", "sigmas", "tolerances", "none"
"""Where an uncertainty is from: the calibration, the file's sigmas alone, what was designed."""
BASES = {COVARIANCE: "covariance of the calibration",
         SIGMAS: "the file's sigmas, as if independent"}


class KinematicsUncertainty(Part):
    """How well the model is known; ``source``: covariance, sigmas, tolerances or none.

    ``frame``: in which a pose is uncertain so much, ``base`` or a data set; ``sizes`` by column.
    With ``tolerances`` these are not columns of the table but what the design allows.
    """

    source: Text = NONE
    frame: Text = ""
    sizes: Mapping[Text, ErrorSize] = field(default_factory=dict)

    def words(self) -> str:
        """Return one sentence."""
        if self.source == NONE:
            return ("How sure this is is not known: the file carries neither sigmas nor "
                    "tolerances.")
        sizes = {k: f"{number(s.rms)} {s.unit}".strip() for k, s in self.sizes.items()
                 if s.rms is not None}
        if not sizes:
            return "How sure this is is not known: no row has an uncertainty."
        told = ", ".join(v if k in ("sigma_position", "sigma_rotation") else
                         f"{k.removeprefix('sigma_')} {v}" for k, v in sizes.items())
        where = f" in the frame of {self.frame}" if self.frame not in ("", "base") else (
            " in the base frame" if self.frame else "")
        if self.source == TOLERANCES:
            return ("The file is nominal, without sigmas: its tolerances, as if independent, allow "
                    f"one standard deviation of {told}{where} (rms over rows).")
        return (f"The model's own uncertainty: one standard deviation of {told}{where} (rms over "
                f"rows; {BASES[self.source]}).")


@dataclass(frozen=True, eq=False)
class ModelSigma:
    """Columns of standard deviations (N,), file units, and the entry of kinematics.json."""

    columns: Mapping[str, Array] = field(default_factory=dict)
    entry: KinematicsUncertainty = field(default_factory=KinematicsUncertainty)

    @classmethod
    def of(cls, mechanism: Mechanism, columns: Mapping[str, Array], source: str, frame: str
           ) -> ModelSigma:
        """Return the uncertainty of a table; of tolerances the columns are listed by size alone."""
        units = unit_map(mechanism, list(columns))
        sizes = {name: ErrorSize(rms=_rms(values), unit=units.get(name, ""))
                 for name, values in columns.items()}
        return cls({} if source == TOLERANCES else columns,
                   KinematicsUncertainty(source=source, frame=frame, sizes=sizes))


def _rms(values: Array) -> float | None:
    there = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(there**2))) if there.size else None
