"""The hidden file of a folder of results: what ppmcal wrote there, and where that comes from.

It may come from anywhere, with the folder: nothing in it is trusted.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

RECORD = ".ppmcal.json"
FORM = "ppmcal/folder/1"


@dataclass(frozen=True)
class Written:
    """What the record says of one file: the command that wrote it, and the SHA-256."""

    command: str
    digest: str


def read_runs(folder: Path) -> dict[str, dict[str, Any]]:
    """Return command -> where its results in a folder come from, as far as that is recorded."""
    runs = _content(folder).get("runs")
    return ({str(k): v for k, v in runs.items() if isinstance(v, dict)}
            if isinstance(runs, dict) else {})


def read_record(folder: Path) -> dict[str, Written] | None:
    """Return what ppmcal wrote into a folder, None where there is no sound record.

    A record may come from anywhere: what it says of other places than the folder is left out.
    """
    try:
        return {name: Written(str(entry["command"]), str(entry["sha256"]))
                for name, entry in _content(folder)["files"].items()
                if name not in ("", ".", "..") and Path(name).name == name}
    except (TypeError, KeyError, AttributeError):
        return None


def owners_of(folder: Path) -> list[str]:
    """Return the commands that wrote into a folder, none where there is no sound record."""
    files, named = read_record(folder), _content(folder).get("commands")
    if files is None:
        return []
    return list(dict.fromkeys([*(map(str, named) if isinstance(named, list) else ()),
                               *(w.command for w in files.values())]))


def _content(folder: Path) -> dict[str, Any]:
    """Return what the record of a folder holds, nothing where it is not there or none of ours."""
    path = folder / RECORD
    try:
        content = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) and content.get("format") == FORM else {}


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a plain file, empty where there is none: a pipe would never end."""
    try:
        if not path.is_file():
            return ""
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except (OSError, ValueError):
        return ""
