"""Objects that several files hold alike: ranges, errors, intervals, weak campaigns, tables.

Keys that a file does not use are not written.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from ppmcal.calibration.fit import WeakCampaign, half_or
from ppmcal.io.results.record import Finite, Part, PlainCell, Record, Text, Whole
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import Key, OfUnit, Units, coordinate_quantity
from ppmcal.wording import number, pluralize

if TYPE_CHECKING:       # few of whom these parts are had anything read wrongly
    from ppmcal.calibration.interpretation import Interpretation


class Range(Part):
    """From where to where something goes, in ``unit``; ``levels``: of a grid, ends included."""

    name: Text = ""
    low: OfUnit[Finite | None] = None
    high: OfUnit[Finite | None] = None
    levels: Whole = 0
    unit: Text = ""


class ErrorSize(Part):
    """Statistics of one kind of error over rows or poses, in ``unit``.

    ``rms_low`` ... ``p95_high``: 95 % intervals of what more poses of the kind would give; None is
    an open end. ``by_chance``: rms that noise alone makes. ``count``: of rows, where they are those
    that a fit had not seen.
    """

    mean: OfUnit[Finite | None] = None
    rms: OfUnit[Finite | None] = None
    rms_low: OfUnit[Finite | None] = None
    rms_high: OfUnit[Finite | None] = None
    p95: OfUnit[Finite | None] = None
    p95_low: OfUnit[Finite | None] = None
    p95_high: OfUnit[Finite | None] = None
    max: OfUnit[Finite | None] = None
    by_chance: OfUnit[Finite | None] = None
    unit: Text = ""
    count: Whole | None = None

    @property
    def of_rows(self) -> str:
        """``" (4 rows, held out once)"``, empty where the file does not say."""
        return "" if self.count is None else f" ({pluralize(self.count, 'row')}, held out once)"


class UncertainValue(Part):
    """A number with its standard deviation, in ``unit``; ``half``: of its 95 % interval, by noise.

    ``session``: the one that it is by alone, prior included.
    """

    name: Text = ""
    session: Text = ""
    value: OfUnit[Finite | None] = None
    sigma: OfUnit[Finite | None] = None
    unit: Text = ""
    half: OfUnit[Finite | None] = None

    @property
    def wide(self) -> float | None:
        """Half of the 95 % interval, None without one."""
        return half_or(self.half, self.sigma)


class ErrorChange(Part):
    """An error ``before`` and ``after`` something, in ``unit``; None: unknown.

    ``sigma``: of commands, the model's own standard deviation; ``machine``, ``frame``: its parts by
    the machine and by what defines the base axes, where something does.
    """

    before: OfUnit[Finite | None] = None
    after: OfUnit[Finite | None] = None
    sigma: OfUnit[Finite | None] = None
    machine: OfUnit[Finite | None] = None
    frame: OfUnit[Finite | None] = None
    unit: Text = ""

    def words(self) -> str:
        """Return ``0.34 mm rms with uncorrected commands, 0.003 mm with these``."""
        if self.before is None:
            return ""
        before = f"{number(self.before)} {self.unit} rms with uncorrected commands"
        if self.after is None:
            return f"{before} if the model is exact, unknown with these"
        return f"{before}, {number(self.after)} {self.unit} with these"


class LeftOutRow(Part):
    """A row that a fit left out, by its number in the CSV, and why.

    Of a gross error, what it says, ``unit``, and what the others predict there; ``times``: how far
    apart, in standard deviations; ``may_be_slack``: ropes that may have been; ``repeats``: it is
    a joint's reading, and those at the same place are the others, whose scatter counts.
    """

    dataset: Text = ""
    row: Whole | None = None
    reason: Text = ""
    coordinate: Text = ""
    value: OfUnit[Finite | None] = None
    predicted: OfUnit[Finite | None] = None
    unit: Text = ""
    times: Finite | None = None
    may_be_slack: tuple[Text, ...] = ()
    repeats: bool = False


FEW = 3


class CampaignSummary(Part):
    """Poses that cannot tell what was fitted.

    ``shapes``: what is weak; ``unknown``: parameters where more than half the tolerance stays
    open, in groups, ``parameters`` by name; ``poses``: how many measurements would tell them, in
    ``file``; ``where``: the coordinates in which they go beyond the campaign.
    """

    shapes: tuple[Text, ...] = ()
    unknown: tuple[Text, ...] = ()
    parameters: tuple[Text, ...] = ()
    poses: Whole = 0
    where: Mapping[Text, Range] = field(default_factory=dict)
    file: Text | None = None
    text: Text = ""

    @classmethod
    def of(cls, found: WeakCampaign | None, units: Units) -> CampaignSummary | None:
        """Return the entry of a campaign, None where it is not weak."""
        if found is None:
            return None
        where = {name: Range.filled(None, units, low=low, high=high,
                                        unit=coordinate_quantity(name))
                 for name, low, high in found.missing.where}
        return cls(shapes=found.shapes, unknown=found.groups, parameters=found.unknown,
                   poses=len(found.missing.q), where=where, file="next.csv",
                   text=_sentence(found, where))


def campaign_sentences(found: CampaignSummary | None) -> list[str]:
    """Return what to say of a weak campaign, nothing of another: no fault of data or machine."""
    return [f"{found.text}."] if found is not None and found.text else []


def _sentence(found: WeakCampaign, where: Mapping[str, Range]) -> str:
    """Return what a campaign leaves unknown and which measurements are missing."""
    first, *more = found.shapes
    shape = "; ".join([first[:1].upper() + first[1:], *more])
    text = (f"{shape}, so these stay unknown to more than half their tolerance: "
            f"{'; '.join(found.groups)}")
    what = "touch" if found.touches else "pose"
    count = len(found.missing.q)
    many = pluralize(count, what) if not found.touches or count == 1 else f"{count} touches"
    ranges = [f"{name} from {r.low:.4g} to {r.high:.4g} {r.unit}"
              for name, r in list(where.items())[:FEW]]
    beyond = f" ({', '.join(ranges)})" if ranges else ""
    return f"{text}. {many} more{beyond} would fix that, see next.csv"


class ShownTable(Part):
    """A table for people; units of its columns are in the record's ``units``, by name."""

    title: Text = ""
    columns: tuple[Text, ...] = ()
    rows: tuple[tuple[PlainCell, ...], ...] = ()
    note: Text = ""


class AnalysisRecord(Record):
    """What the records of sensitivity, tolerances, stiffness and plan begin with."""

    FILE: ClassVar[str] = ""
    FORMAT: ClassVar[str] = ""

    name: Text = ""
    summary: Annotated[tuple[Text, ...], Key("said")] = ()
    units: Mapping[str, Text] = field(default_factory=dict)
    findings: tuple[Text, ...] = ()


def geometry_note(mechanism: Mechanism) -> list[str]:
    """Return that an analysis of geometry leaves the file's effects out, if it has any."""
    kinds = ", ".join(dict.fromkeys(e.kind.name for e in mechanism.effects))
    return [f"Geometry only: the file's effects ({kinds}) are left out."] if kinds else []


MISREAD = "ppmcal/misread/1"
"""Format of what says that files were read wrongly, where there is no result."""


class MisreadingEntry(Part):
    """One mistake in one file.

    ``read``: the sidecar's block that corrects all mistakes of that file; null where only the user
    can; ``sigma``: entries of its ``instrument.sigma`` that belong to that, in its units;
    ``headers``: of the file -> those to write in their place, where the unit stands in them;
    ``at``: the joint to write as its ``instrument.at``, where that is another one. ``rows``: where
    not all; ``residual``: half of the rows miss by more, of the nominal machine at its best
    registration.
    """

    file: Text = ""
    kind: Text = ""
    columns: tuple[Text, ...] = ()
    rows: tuple[Whole, ...] | None = None
    read: Mapping[str, Any] | None = None
    residual: ErrorChange | None = None
    text: Text = ""
    sigma: Mapping[str, float] | None = None
    headers: Mapping[str, str] | None = None
    at: Text | None = None


def misreading_entries(found: Sequence[Interpretation], units: Units
                       ) -> tuple[MisreadingEntry, ...]:
    """Return one entry for each mistake, file units."""
    out = []
    for one in found:
        miss = ErrorChange.filled(None, units, before=one.before, after=one.after,
                                  unit=one.quantity)
        known = np.isfinite(one.after)
        out += [MisreadingEntry.filled(
            m, file=one.source, rows=m.rows or None, read=one.block,
            residual=miss if known else None, text=m.text + one.otherwise * (m is one.mistakes[-1]),
            sigma=dict(one.sigma) or None, headers=dict(one.headers) or None,
            **({"at": one.at} if one.at else {}))
            for m in one.mistakes]
    return tuple(out)
