"""``extends``: one mechanism file laid over another."""

from __future__ import annotations

import ntpath
import os
import posixpath
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ppmcal.errors import BadInput
from ppmcal.io.schema import show
from ppmcal.io.yaml import read_yaml

MAX_FILES = 20
IN_MEMORY = "mapping"
"""What a file that is given as a mapping is called in messages."""


def read_merged(source: str | os.PathLike[str] | Mapping[str, Any]
                ) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return the mapping of a mechanism file with the files that it extends under it.

    The second result names all files that were read, this one first. A mapping that is in
    memory extends files relative to the working directory.

    Maps are merged by key and limbs by name; lists and numbers are replaced. All files must
    be in the same units; one that declares none is in those of the file that it extends.

    Raises:
        BadInput: a circle, differing units, a file that cannot be read, or is named by a path
            that leads out of the folder of the file that extends it.
    """
    files: list[str] = []
    if isinstance(source, Mapping):
        return _laid_over(dict(source), Path(IN_MEMORY), (), files), tuple(files)
    return _read(Path(source), (), files), tuple(files)


def _read(path: Path, above: tuple[Path, ...], files: list[str]) -> dict[str, Any]:
    here = Path(os.path.realpath(path))    # of links in a circle too, where resolve raises
    if here in above or len(above) >= MAX_FILES:
        names = " -> ".join(p.name for p in (*above, here))
        raise BadInput(f"the files extend each other in a circle ({names})",
                       f"{above[-1]}: extends", "Remove one `extends`")
    tree = read_yaml(path)
    files.append(str(path))
    return _laid_over(tree, path, (*above, here), files)


def _inside(name: str) -> bool:
    r"""Whether a relative path stays in its folder, by the rules of POSIX and by Windows' own.

    A file that is sound on one system is then the same file on the other: ``C:x.yaml`` is a file of
    another drive there, and ``..\x.yaml`` one of the folder above.
    """
    drive, rest = ntpath.splitdrive(name)
    return not (drive or rest.startswith(("/", "\\"))) and all(
        path.normpath(name).split(path.sep)[0] != os.pardir for path in (posixpath, ntpath))


def _laid_over(tree: dict[str, Any], path: Path, above: tuple[Path, ...], files: list[str]
               ) -> dict[str, Any]:
    """Return a mapping with the file that it extends, relative to ``path``, under it."""
    other = tree.get("extends")
    if other is None:
        return tree
    if not isinstance(other, str) or not other or "\x00" in other:
        raise BadInput(f"{show(other)} is not a file name", f"{path}: extends",
                       "Write the path of a mechanism file, relative to this one")
    # a mapping, above which no file is, is the caller's own; files come from others, and are moved
    if above and not _inside(other):
        raise BadInput(f"{show(other)} leads out of the folder of this file", f"{path}: extends",
                       "Put a copy of that file, or a link to it, beside this one")
    try:
        under = _read(path.parent / other, above, files)
    except BadInput as error:
        raise BadInput(error.what, f"{path}: extends: {error.where}", error.hint) from None
    if "units" in tree and tree["units"] != under.get("units"):
        raise BadInput(f"the units {show(tree['units'])} differ from those of {other}, "
                       f"{show(under.get('units'))}", f"{path}: units",
                       "Write both files in the same units")
    merged = merge({k: v for k, v in under.items() if k != "extends"},
                   {k: v for k, v in tree.items() if k != "extends"})
    return merged


def merge(under: dict[Any, Any], over: dict[Any, Any]) -> dict[Any, Any]:
    """Return ``over`` laid over ``under``: maps by key, ``limbs`` by name.

    A bare number under a mapping counts as its ``value``, so that a file can add a tolerance
    to a slot of the file that it extends.
    """
    out = dict(under)
    for key, value in over.items():
        old = out.get(key)
        if key == "limbs" and isinstance(old, list) and isinstance(value, list):
            out[key] = _limbs(old, value)
        elif isinstance(old, dict) and isinstance(value, dict):
            out[key] = merge(old, value)
        elif (isinstance(value, dict) and "value" not in value and "share" not in value
              and isinstance(old, int | float) and not isinstance(old, bool)):
            out[key] = {"value": old, **value}
        else:
            out[key] = value
    return out


def _limbs(under: list[Any], over: list[Any]) -> list[Any]:
    out = list(under)
    named = {limb["name"]: i for i, limb in enumerate(under)
             if isinstance(limb, dict) and isinstance(limb.get("name"), str | int)}
    for limb in over:
        name = limb.get("name") if isinstance(limb, dict) else None
        if isinstance(name, str | int) and name in named:
            out[named[name]] = merge(out[named[name]], limb)
        else:
            out.append(limb)
    return out
