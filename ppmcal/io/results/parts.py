"""Objects that several files hold alike: a range, the size of an error, a value with its interval.

Keys that a file does not use are not written.
"""

from __future__ import annotations

from ppmcal.calibration.fit import half_or
from ppmcal.io.results.record import Finite, Part, Text, Whole
from ppmcal.units import OfUnit
from ppmcal.wording import number, pluralize


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
