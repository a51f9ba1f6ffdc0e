"""The form of commands in a measurement file: names, units, signs, digits and marks.

Commands go back to the controller in the same form, so a data set keeps it with its SI values.
"""

from __future__ import annotations

from dataclasses import dataclass

LABEL = "pose"
"""The column of row names, next to those of joints or of a commanded pose."""


@dataclass(frozen=True)
class RecordedColumn:
    """A column of a file that holds joint values, or a coordinate of the commanded pose.

    Attributes:
        name: ours, ``q_leg1`` or ``cmd_x``; :data:`LABEL` for that of row names.
        header: the file's.
        unit: its usual name, empty for a bare number.
        factor: a recorded number times this is the value in the mechanism file's unit; negative
            for a joint that counts the other way.
        decimals: digits after the decimal mark, as in the file.
    """

    name: str
    header: str
    unit: str = ""
    factor: float = 1.0
    decimals: int = 0


@dataclass(frozen=True)
class RecordedForm:
    """The form of commands in a file: columns in order, separator, and decimal mark."""

    columns: tuple[RecordedColumn, ...] = ()
    separator: str = ","
    decimal: str = "."

    @property
    def as_machine(self) -> bool:
        """Whether it is the form of commands.csv: our names, mechanism file units, points."""
        return self.separator == "," and self.decimal == "." and all(
            c.header == c.name and c.factor == 1.0 for c in self.columns)

    @property
    def values(self) -> tuple[RecordedColumn, ...]:
        """The columns without that of row names."""
        return tuple(c for c in self.columns if c.name != LABEL)
