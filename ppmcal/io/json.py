"""Reading the JSON that commands wrote; every refusal names file and place.

Nothing here trusts the files: they may be cut off, edited by hand or written by another version.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from ppmcal.codec import AGAIN
from ppmcal.errors import BadInput
from ppmcal.limits import JSON_BYTES, JSON_DEPTH, JSON_NODES
from ppmcal.store.inputs import read_bytes

LONGEST = 300
"""Digits of a number; more do not fit into a float."""


def read_text(path: Path) -> str:
    """Return a file's text in UTF-8, and note it as an input of the run."""
    try:
        return read_bytes(path, JSON_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadInput(f"is not UTF-8 text (byte {error.start})", str(path), AGAIN) from None


def read_object(path: Path, hint: str = AGAIN) -> dict[str, Any]:
    """Return the JSON object in a file.

    Raises:
        BadInput: not readable, cut off, no JSON object, too large or too deep, or with a number
            that is not finite.
    """
    text = read_text(path)
    # commas, colons and brackets in texts count too; no result comes near
    JSON_NODES.refuse(sum(map(text.count, ",:[{")), str(path))
    odd = list[float]()

    def number(word: str) -> float:
        value = float(word)
        if not math.isfinite(value):
            odd.append(value)
        return value

    try:
        content = json.loads(text, parse_int=_whole, parse_float=number, parse_constant=number)
        if not isinstance(content, dict):
            raise BadInput("holds no JSON object", str(path), hint)
    except json.JSONDecodeError as error:
        raise BadInput(f"is not valid JSON ({error.msg}); it may be cut off",
                       f"{path}: line {error.lineno}, column {error.colno}", hint) from None
    except ValueError as error:
        raise BadInput(f"cannot be read as JSON ({str(error).partition(';')[0]})", str(path),
                       hint) from None
    except RecursionError:
        raise JSON_DEPTH.error(str(path)) from None
    _refuse_deep(content, path)
    if odd:
        place = _place_of_odd(content)
        raise BadInput("should be a number that is finite", f"{path}: {place}", hint)
    return content


def _whole(text: str) -> int:
    if len(text) > LONGEST:
        raise ValueError(f"a number of {len(text)} digits")
    return int(text)


def _place_of_odd(node: Any, place: str = "") -> str:
    """Return where the first number stands that is not finite, empty without one."""
    if isinstance(node, float) and not math.isfinite(node):
        return place
    pairs = node.items() if isinstance(node, dict) else (
        enumerate(node) if isinstance(node, list) else ())
    for key, child in pairs:
        part = f"[{key}]" if isinstance(key, int) else f".{key}" if place else str(key)
        if found := _place_of_odd(child, place + part):
            return found
    return ""


def _refuse_deep(content: dict[str, Any], path: Path) -> None:
    """Refuse what is nested deeper than any result."""
    level: list[Any] = [content]
    for _ in range(JSON_DEPTH.most):
        level = [child for node in level
                 for child in (node.values() if isinstance(node, dict) else node)
                 if isinstance(child, dict | list)]
        if not level:
            return
    raise JSON_DEPTH.error(str(path))
