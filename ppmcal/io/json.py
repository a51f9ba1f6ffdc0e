"""Reading the JSON that commands wrote; every refusal names file and place.

Nothing here trusts the files: they may be cut off, edited by hand or written by another version.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ppmcal.errors import BadInput
from ppmcal.io.folder import note_read

AGAIN = "Run the command that writes it again"
MAX_DEPTH_MEND = "It is nested too deeply to be one of ppmcal's files"
LARGEST = 1e30


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


def read_object(path: Path, mend: str = AGAIN) -> dict[str, Any]:
    """Return the JSON object in a file.

    Raises:
        BadInput: not readable, cut off, or no JSON object.
    """
    try:
        content = json.loads(read_text(path))
        if not isinstance(content, dict):
            raise BadInput("holds no JSON object", str(path), mend)
    except json.JSONDecodeError as error:
        raise BadInput(f"is not valid JSON ({error.msg}); it may be cut off",
                       f"{path}: line {error.lineno}, column {error.colno}", mend) from None
    except ValueError as error:
        raise BadInput(f"cannot be read as JSON ({str(error).partition(';')[0]})", str(path),
                       mend) from None
    except RecursionError:
        raise BadInput("cannot be read as JSON", str(path), MAX_DEPTH_MEND) from None
    return content
