"""The thresholds that decide how a file is read, each with its reason; others only save time."""

from __future__ import annotations

LANDS = 5.0
"""Half of the rows are off by more than this many times what noise and tolerances explain: no fit
with these tolerances gets the machine there, nor are other rows judged by such a fit."""
ALLOWED = 2.0
"""Tolerances, RMS over the geometry, by which a machine may be off if read rightly: one of
dozens of parameters would be at 1."""
TELLING = 2.0
"""Multiple of the residuals of a right file beyond which other readings are tried, which have to
lower them by this factor. Effects of a machine are confounded in part, seldom by more than half."""
FAR = TELLING * ALLOWED
"""Tolerances, RMS, by which no machine is off: files of sister machines move a fit by 5 to 60."""
WORST = 100.0
"""Values beyond this are all alike: a reading has to lower the error by as much as it leaves, so
that the square root of this is the most that hidden effects may leave."""
AS_GOOD = 1.5
"""Readings within this factor of the best are as good: scores of 48 rows scatter by a tenth, and a
machine in an unknown frame may be renumbered in ways that only its errors distinguish."""
LITTLE = 0.05
"""Residuals relative to the range of the measurements; in too small a unit noise explains all."""
MOST = 0.5
"""More rows than this part without a pose, or outside the limits, are not single mistakes."""
HARDLY_LESS = 0.05
"""A fit from far off is still on its way if it has less than this part of the residuals left."""
FEWEST_PARAMETERS = 3
"""Fewest parameters off in the file of another machine: one mistyped point is fewer."""
FEWEST_ROWS = 6
"""Fewest rows that show a mistake together; fewer are single mistyped values."""
AGAINST = 4.0
"""Rows that fit, which one that does not outweighs: four fifths of a stretch must fit."""
CHANCE, SLACK = 1e-3, 2.0
"""A row fits within this chance of the noise, and a factor for what the fit does not know there."""


def explains(before: float, after: float) -> bool:
    """Whether scores fall by more than is left, and enough to be sure."""
    return before >= TELLING * after and min(before, WORST) >= after**2
