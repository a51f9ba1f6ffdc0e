"""What files of controllers have in common: text, decimal numbers, comments."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Self

from ppmcal.errors import BadInput
from ppmcal.limits import CONFIG_BYTES, Limit
from ppmcal.store.inputs import read_bytes

NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
DECIMAL = re.compile(NUMBER, re.ASCII)


def read_text(path: str | os.PathLike[str], hint: str = "", limit: Limit = CONFIG_BYTES) -> str:
    """Return a file's text; bytes that are none of UTF-8 become replacement characters.

    Args:
        path: the file.
        hint: what to give instead where it is not text; empty where that is seen later.
        limit: of its size.

    Raises:
        BadInput: it cannot be read, is too large, or holds zero bytes where there is a hint.
    """
    data = read_bytes(Path(path), limit)
    if hint and b"\0" in data:
        raise BadInput("is not a text file", str(path), hint)
    return data.decode("utf-8-sig", errors="replace")


def exact_text(path: Path) -> str:
    """Return a file's text that is to be written again, but for the mark that it begins with.

    Raises:
        BadInput: it is not UTF-8 throughout.
    """
    try:
        return read_bytes(path, CONFIG_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise BadInput("is not UTF-8 throughout, and a copy would not be the same", str(path),
                       "Save it as UTF-8, or leave out --write and paste the lines") from None


def commented(text: str, sign: str = "#") -> list[str]:
    """Return the lines of a text as comments."""
    return [f"{sign} {line}".rstrip() for line in text.splitlines()]


class Rounded:
    """A dataclass of numbers, and tuples of them, that are written with so many ``digits``."""

    DIGITS: ClassVar[int]

    def __init_subclass__(cls, digits: int) -> None:
        cls.DIGITS = digits

    def rounded(self) -> Self:
        """Return what is left of it after writing and reading; no zero is negative."""
        def cut(value: Any) -> Any:
            if isinstance(value, tuple):
                return tuple(map(cut, value))
            return round(value, self.DIGITS) + 0.0 if isinstance(value, int | float) else value

        return replace(self, **{k: cut(v) for k, v in vars(self).items()})  # type: ignore[type-var]
