"""A mechanism file, alone or with its measurements, before anything is fitted."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ppmcal.calibration.fit import Unidentifiable
from ppmcal.calibration.interpretation import Check, unit_findings
from ppmcal.calibration.interpretation import check as checked
from ppmcal.calibration.knowledge import Scale
from ppmcal.codec import encoded, in_units
from ppmcal.commands.check.options import CheckArguments
from ppmcal.commands.inputs import data_files, prepared
from ppmcal.commands.spec import Path_, Refusal
from ppmcal.errors import BadInput, PpmcalError
from ppmcal.io.results.identification_parts import summaries
from ppmcal.io.results.identification_wording import (
    open_sentences,
    sets_of,
    unidentifiable_words,
)
from ppmcal.io.results.parts import ErrorSize, misreading_entries
from ppmcal.io.results.scene import Scene
from ppmcal.io.sidecar import sidecar_path
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import has_findings
from ppmcal.wording import number, pluralize
from ppmcal.wording.told import Findings, ShortTable, Told


@dataclass(frozen=True)
class CheckResult(Check):
    """What check found, with the machine, so that it can be drawn.

    Attributes:
        mechanism: the machine that was checked.
        inputs: the files that it and its measurements were read from.
        measured: whether there are measurements.
        drawn: where it was drawn.
    """

    warnings: ClassVar[tuple[str, ...]] = ()
    row_failures: ClassVar[tuple[str, ...]] = ()

    mechanism: Mechanism | None = None
    inputs: tuple[str, ...] = ()
    measured: bool = False
    drawn: Path | None = None

    @classmethod
    def of_machine(cls, mechanism: Mechanism, datasets: Sequence[Dataset] = ()) -> CheckResult:
        """Return a machine that nothing is found of, to be drawn: it may not reach home."""
        return cls((), (), float("nan"), np.full(len(mechanism.actuators), np.nan),
                   mechanism=mechanism, inputs=(*mechanism.inputs, *data_files(datasets)))

    @cached_property
    def scene(self) -> Scene:
        """The machine at home and at poses about it, in the units of its file."""
        return Scene.of(self.of)

    @property
    def exit_code(self) -> int:
        """1 where something needs a look; what always holds of such a machine does not."""
        return int(has_findings(self.findings))

    @property
    def _sets(self) -> tuple[Unidentifiable, ...]:
        return sets_of(self.unidentifiable, self.of)

    @property
    def _scale(self) -> Scale | None:
        return in_units(self.identifiability.scale if self.identifiability else None,
                        self.of.units)

    @property
    def _misses(self) -> Mapping[str, ErrorSize]:
        return summaries(self.misses, self.of.units)

    @property
    def of(self) -> Mechanism:
        """The machine."""
        assert self.mechanism is not None
        return self.mechanism

    def told(self) -> Iterator[Told]:
        """Yield the machine in a line, its home, and what can be seen of its parameters."""
        mechanism = self.of
        factor, unit = mechanism.units.factor("length"), mechanism.units.length
        yield (f"{mechanism.name}: {mechanism.motion}, {len(mechanism.limbs)} limbs "
               f"({', '.join(dict.fromkeys(limb.kind.name for limb in mechanism.limbs))}), "
               f"{len(mechanism.actuators)} actuators, {len(mechanism.free)} free parameters.")
        yield ShortTable(["joint", "at home", "unit"], [
            [name, number(q / f, 7), u or "units"] for name, q, (f, u) in
            zip(mechanism.actuators, self.q_home, mechanism.joint_units, strict=True)], (1,))
        if self.gaps:
            yield ShortTable(["limb", "gap at home", "allowed", "unit"], [
                [g.limb, number(g.gap / factor), number(g.allowed / factor, 2), unit]
                for g in self.gaps], (1, 2))
        against = (f" (rotation against {mechanism.length_scale / factor:.4g} {unit})"
                   if mechanism.motion.turns else "")
        yield f"Smallest singular value at home: {self.singular_value:.3g}{against}."
        if self.columns:
            seen = "the measurements" if self.measured else "full-pose measurements about home"
            yield f"Rank with {seen}: {self.rank} of {self.columns}."
        if misses := [f"{k} {number(v.rms, 3)} {v.unit}".rstrip()
                      for k, v in self._misses.items() if v.rms is not None]:
            yield ("Errors of the nominal machine before any fit of its geometry: "
                   f"{', '.join(misses)} (rms; frame and target fitted where they are unknown).")
        if sets := self._sets:
            yield (
                f"{pluralize(sum(s.combinations for s in sets), 'combination')} of parameters not "
                   f"determined by {seen}: {unidentifiable_words(sets)}.")
        known = self.identifiability
        open_ = open_sentences(known.collinear, self._scale) if known else []
        yield from open_
        yield Findings(self.findings)
        if not (self.findings or self.unseen or open_):
            yield "No findings."

    def write(self, _: CheckArguments) -> list[Path]:
        """Return the drawing, which is there already."""
        return [] if self.drawn is None else [self.drawn]

    def finished(self, written: Sequence[Path], _: CheckArguments) -> Iterator[Told]:
        """Yield where the drawing is."""
        yield f"The machine, drawn: {written[0]}"

    def summary_of(self, written: Sequence[Path]) -> Mapping[str, Any]:
        """Return where the drawing is."""
        return {"drawing": str(written[0])}

    def summary(self) -> Mapping[str, Any]:
        """Return what ``--json`` prints."""
        mechanism, known, scale = self.of, self.identifiability, self._scale
        factor, unit = mechanism.units.factor("length"), mechanism.units.length
        return {
            "format": "ppmcal/check/1", "name": mechanism.name, "findings": list(self.findings),
            "gaps": [{"limb": g.limb, "gap": g.gap / factor, "allowed": g.allowed / factor,
                      "unit": unit, "open": g.open} for g in self.gaps],
            "condition": self.singular_value, "rank": self.rank, "columns": self.columns,
            "unseen": list(self.unseen), "redundant": list(self.redundant),
            "unidentifiable": encoded(self._sets), "misses": encoded(self._misses),
            "identifiability": None if known is None else {
                "collinear": encoded(known.collinear),
                **({"scale": encoded(scale)} if scale else {})},
            "misreadings": [m.entries() for m in
                            misreading_entries(self.misreadings, mechanism.units)]}

    def draw(self, path: Path_) -> Path:
        """Write the machine, drawn to scale: one HTML page that needs no network.

        Args:
            path: the page; an earlier drawing there is replaced.

        Raises:
            BadInput: it cannot be written, or something other than a drawing is there.
        """
        from ppmcal.report.drawing import drawing_page, write_drawing

        target = Path(path)
        write_drawing(target, drawing_page(self.scene, self.of.source), self.inputs)
        return target


def run(asked: CheckArguments) -> CheckResult:
    """Check a machine, and what measurements can tell of it."""
    machine, datasets = prepared(asked.mechanism, asked.data, needed=False)
    found = checked(machine, datasets, unit_findings(machine, datasets, sidecar_path))
    result = CheckResult(**{f.name: getattr(found, f.name) for f in fields(found)},
                         mechanism=machine, inputs=(*machine.inputs, *data_files(datasets)),
                         measured=bool(datasets))
    return result if asked.draw is None else replace(result, drawn=result.draw(asked.draw))


def when_refused(error: PpmcalError, asked: CheckArguments, _: Path | None) -> Refusal | None:
    """Draw what cannot be checked: it can still be looked at."""
    if asked.draw is None or not isinstance(error, BadInput):
        return None
    try:
        machine, datasets = prepared(asked.mechanism, asked.data, needed=False)
    except PpmcalError:
        return None
    shown = CheckResult.of_machine(machine, datasets).draw(asked.draw)
    return Refusal(told=(f"The machine, drawn as far as it goes: {shown}",))
