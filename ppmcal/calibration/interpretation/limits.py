"""The numbers that decide how a file is read, each with its reason; the others only save time."""

from __future__ import annotations

LANDS = 5.0
"""Half of the rows are farther off than so many times what noise and tolerances explain: no fit
with these tolerances brings the machine there, nor are other rows judged by such a fit."""
ALLOWED = 2.0
"""Tolerances, RMS over the geometry, by which a machine may be off that is read rightly: one of
dozens of parameters comes to 1."""
TELLING = 2.0
"""Times what a right file leaves: more is worth a look at other ways to read it, which have to
lower it by this factor. Effects of a machine are imitated in part, seldom by more than half."""
FAR = TELLING * ALLOWED
"""Tolerances, RMS, that no machine is off: files of sister machines move a fit by five to sixty."""
WORST = 100.0
"""More than that says no more: a way to read a file has to lower what is wrong by as much as it
leaves, so that the square root of this is the most that hidden effects may leave."""
AS_GOOD = 1.5
"""Ways within this factor of the least are as good as it: scores of 48 rows scatter by a tenth,
and a machine in an unknown frame may be renumbered in ways that only its errors tell apart."""
LITTLE = 0.05
"""What is left of how far measurements go; in a unit that makes all small, noise explains all."""
MOST = 0.5
"""Of rows: more without a pose, or outside the limits, than this are not single mistakes."""
HARDLY_LESS = 0.05
"""A fit from far off is still on its way where it left less than this part of what there was."""
FEWEST_PARAMETERS = 3
"""Parameters that are off in the file of another machine: one point typed wrong is none."""
FEWEST_ROWS = 6
"""Rows that show a mistake together; fewer are single values typed wrong."""
AGAINST = 4.0
"""Rows that fit, which one that does not outweighs: of a stretch four fifths have to."""
CHANCE, SLACK = 1e-3, 2.0
"""A row fits within this chance of the noise, and a factor for what the fit does not know there."""
