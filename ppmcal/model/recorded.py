"""How a measurement file has what the controller was told: names, units, signs, digits and marks.

Commands go back to the controller in the same form, so a data set keeps it beside its SI values.
"""

from __future__ import annotations

from dataclasses import dataclass

LABEL = "pose"
"""The column of rows' names, beside those of joints or of a commanded pose."""


@dataclass(frozen=True)
class RecordedColumn:
    """A column of a file that holds joint values, or a coordinate of the commanded pose.

    Attributes:
        name: ours, ``q_leg1`` or ``cmd_x``; :data:`LABEL` for that of rows' names.
        header: the file's.
        unit: as people know it, empty for a bare number.
        factor: a recorded number times this is the value in the mechanism file's unit; it has
            the sign of a joint that is counted the other way.
        decimals: after the mark, as many as the file has.
    """

    name: str
    header: str
    unit: str = ""
    factor: float = 1.0
    decimals: int = 0


@dataclass(frozen=True)
class RecordedForm:
    """How a file has commands: its columns in their order, separator, and decimal mark."""

    columns: tuple[RecordedColumn, ...] = ()
    separator: str = ","
    decimal: str = "."

    @property
    def as_machine(self) -> bool:
        """Whether it is that of commands.csv: our names, the mechanism file's units, points."""
        return self.separator == "," and self.decimal == "." and all(
            c.header == c.name and c.factor == 1.0 for c in self.columns)

    @property
    def values(self) -> tuple[RecordedColumn, ...]:
        """The columns without that of rows' names."""
        return tuple(c for c in self.columns if c.name != LABEL)
