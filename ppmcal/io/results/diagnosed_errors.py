"""Errors of a diagnosis at three stages: the nominal machine, geometry alone, what was found."""

from __future__ import annotations

from dataclasses import field

from ppmcal.calibration.validation import definition, residuals
from ppmcal.diagnosis.result import Diagnosis
from ppmcal.io.results.identification_parts import Summaries, before_words, summaries
from ppmcal.io.results.record import Part, Text
from ppmcal.wording import number


class DiagnosedErrors(Part):
    """Errors by kind in the rows in use: as ``before_is`` says, of geometry alone, of the model."""

    before_is: Text = ""
    before: Summaries = field(default_factory=dict)
    geometry: Summaries = field(default_factory=dict)
    after: Summaries = field(default_factory=dict)

    @classmethod
    def of(cls, result: Diagnosis) -> DiagnosedErrors:
        """Return the entry in file units."""
        found, units = result.identification, result.identification.mechanism.units
        alone = residuals(result.before.problem, result.before.state)
        before, geometry, after = (summaries(errors.figures(found.fit.keep), units)
                                   for errors in (found.before, alone, found.after))
        return cls(before_is=definition(found.fit.problem.blind), before=before, geometry=geometry,
                   after=after)

    def sentence(self, more: bool) -> str:
        """Return the sizes and what before is, empty where the file does not say."""
        sizes = self.sizes(more)
        return sizes + before_words(self.before_is) if sizes else ""

    def sizes(self, more: bool) -> str:
        """Return the rms error at each stage, empty where the file does not say.

        Args:
            more: whether the model has more than geometry.
        """
        kind = next((k for k in ("position", *self.after) if k in self.after), "")
        stages = [("before", self.before), ("geometry alone", self.geometry),
                  ("with what was found", self.after)][:3 if more else 2]
        sizes = [f"{name} {number(s[kind].rms)} {s[kind].unit}" for name, s in stages
                 if kind in s and s[kind].rms is not None]
        return f"{kind.capitalize()} error, rms: {', '.join(sizes)}." if sizes else ""
