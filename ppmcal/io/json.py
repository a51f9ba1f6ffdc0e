"""Reading the JSON that commands wrote; every refusal names file and place.

Nothing here trusts the files: they may be cut off, edited by hand or written by another
version. A missing key is no error, a value of the wrong kind is.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ppmcal.errors import BadInput
from ppmcal.io.folder import note_read

AGAIN = "Run the command that writes it again"
MAX_DEPTH_MEND = "It is nested too deeply to be one of ppmcal's files"
NUMBER = "number"
"""Any number, nan and inf as well: what is only shown."""
FINITE = "finite"
"""A number to calculate with, at most LARGEST."""
TEXT = "text"
LARGEST = 1e30

Shape = Any


def read_text(path: Path) -> str:
    """Return a file's text in UTF-8, and note it as an input of the run."""
    note_read(path)
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise BadInput(f"cannot be read ({error.strerror or error})", str(path),
                       "Check the path and its permissions") from None
    except UnicodeDecodeError as error:
        raise BadInput(f"is not UTF-8 text (byte {error.start})", str(path), AGAIN) from None


def read_json(path: Path, shape: Shape) -> dict[str, Any]:
    """Return a JSON object whose parts have the kinds that ``shape`` says.

    ``shape`` is NUMBER, FINITE or TEXT, None (anything), ``[shape]`` for a list, ``(shape,)`` for
    one in which nulls may stand, or a dict by key (``"*"``: every other key). Missing keys and
    nulls pass.

    Raises:
        BadInput: not readable, no JSON object, or a part of another kind.
    """
    try:
        record = json.loads(read_text(path))
        if not isinstance(record, dict):
            raise BadInput("holds no JSON object", str(path), AGAIN)
        check_shape(record, shape, str(path), "")
    except json.JSONDecodeError as error:
        raise BadInput(f"is not valid JSON ({error.msg}); it may be cut off",
                       f"{path}: line {error.lineno}, column {error.colno}", AGAIN) from None
    except ValueError as error:
        raise BadInput(f"cannot be read as JSON ({str(error).partition(';')[0]})", str(path),
                       AGAIN) from None
    except RecursionError:
        raise BadInput("cannot be read as JSON", str(path), MAX_DEPTH_MEND) from None
    return record


def check_shape(value: Any, shape: Shape, source: str, place: str) -> None:
    """Refuse a value that is not of the kind that ``shape`` says."""
    if value is None or shape is None:
        return
    if isinstance(shape, dict):
        _expect(isinstance(value, dict), "an object", source, place)
        for key, part in value.items():
            inner = shape.get(key, shape.get("*"))
            check_shape(part, inner, source, f"{place}.{key}" if place else key)
    elif isinstance(shape, list | tuple):
        _expect(isinstance(value, list), "a list", source, place)
        for i, part in enumerate(value):
            _expect(part is not None or isinstance(shape, tuple), "something, not null", source,
                    f"{place}[{i}]")
            check_shape(part, shape[0], source, f"{place}[{i}]")
    elif shape in (NUMBER, FINITE):
        _expect(isinstance(value, int | float) and not isinstance(value, bool), "a number",
                source, place)
        _expect(shape == NUMBER or abs(value) <= LARGEST, f"a number, {LARGEST:g} at most",
                source, place)
    else:
        _expect(isinstance(value, str), "text", source, place)


def _expect(right: bool, kind: str, source: str, place: str) -> None:
    if not right:
        raise BadInput(f"should be {kind}", f"{source}: {place}", AGAIN)
