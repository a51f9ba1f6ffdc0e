"""YAML text to plain data and back: duplicate keys refused, numbers as YAML 1.2 has them.

PyYAML follows YAML 1.1, where ``1e-3`` is a string, ``on`` is true, ``010`` is eight and
``1:30`` is ninety. Calibration files mean none of that, so this loader knows only the core
types of YAML 1.2: null, true/false, decimal numbers and strings.

``extends`` lays one mechanism file over another.
"""

from __future__ import annotations

import math
import ntpath
import os
import posixpath
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from ppmcal.errors import BadInput
from ppmcal.io.schema import show
from ppmcal.io.tables import SUFFIXES
from ppmcal.limits import YAML_BYTES, YAML_DEPTH, YAML_NODES
from ppmcal.store.inputs import read_bytes

MAX_FILES = 20
IN_MEMORY = "mapping"
"""What a file that is given as a mapping is called in messages."""
_FLOAT = re.compile(r"^[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?$"
                    r"|^[-+]?\.(inf|Inf|INF)$|^\.(nan|NaN|NAN)$")
_INT = re.compile(r"^[-+]?[0-9]+$")
_BOOL = re.compile(r"^(true|True|TRUE|false|False|FALSE)$")
_NULL = re.compile(r"^(~|null|Null|NULL|)$")
_TAB = re.compile(rb" *\t")
_TAG = "tag:yaml.org,2002:"


class _Loader(yaml.CSafeLoader):
    """Safe loader that refuses duplicate keys."""


_Loader.yaml_implicit_resolvers = {}
_Loader.yaml_constructors = {
    tag: build for tag, build in yaml.CSafeLoader.yaml_constructors.items()
    if tag is None or tag in {_TAG + name for name in ("null", "bool", "str", "seq")}}


class _Twice(yaml.constructor.ConstructorError):
    """A key that stands twice in one mapping."""


def _mapping(loader: yaml.CSafeLoader, node: yaml.Node) -> dict[Any, Any]:
    if not isinstance(node, yaml.MappingNode):
        raise yaml.constructor.ConstructorError(
            None, None, "a mapping was announced here", node.start_mark)
    seen: dict[Any, Any] = {}
    for key_node, value_node in node.value:
        key = loader.construct_object(key_node, deep=True)
        if not isinstance(key, str | int | float | bool) and key is not None:
            raise yaml.constructor.ConstructorError(
                None, None, "a key must be a plain word", key_node.start_mark)
        if key in seen:
            raise _Twice(
                None, None, f"the key '{key}' stands twice in one mapping", key_node.start_mark)
        seen[key] = loader.construct_object(value_node, deep=True)
    return seen


def _scalar(node: yaml.Node) -> str:
    if not isinstance(node, yaml.ScalarNode):
        raise yaml.constructor.ConstructorError(
            None, None, "a number was announced here", node.start_mark)
    return str(node.value)


def _int(loader: yaml.CSafeLoader, node: yaml.Node) -> int | float:
    text = _scalar(node)
    return int(text) if len(text) < 300 else float(text)


def _float(loader: yaml.CSafeLoader, node: yaml.Node) -> float:
    return float(_scalar(node).lower().replace(".inf", "inf").replace(".nan", "nan"))


for _tag, _pattern, _first in (("float", _FLOAT, "-+0123456789."), ("int", _INT, "-+0123456789"),
                               ("bool", _BOOL, "tTfF"), ("null", _NULL, ["~", "n", "N", ""])):
    _Loader.add_implicit_resolver(_TAG + _tag, _pattern, list(_first))
_Loader.yaml_implicit_resolvers = {  # an integer also reads as a float: the integer first
    first: sorted(rules, key=lambda rule: rule[0] == _TAG + "float")
    for first, rules in _Loader.yaml_implicit_resolvers.items()}
_Loader.add_constructor(_TAG + "map", _mapping)
_Loader.add_constructor(_TAG + "int", _int)
_Loader.add_constructor(_TAG + "float", _float)


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the mapping that a YAML file holds.

    Raises:
        BadInput: unreadable, not YAML (with line and column), or not a mapping.
    """
    data = read_bytes(path, YAML_BYTES)
    if b"\x00" in data[:4096] and not data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise BadInput("is not a text file", str(path), "Give a YAML file")
    try:
        _check_events(data, path)
        tree = yaml.load(data, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        raise _syntax(path, error, data) from None
    except (yaml.YAMLError, LookupError, ValueError, RecursionError, OverflowError) as error:
        what = " ".join(str(error).split())[:200]
        raise BadInput(f"is not YAML ({what})", str(path),
                       "Give a UTF-8 text file with `key: value` lines") from None
    if tree is None:
        raise BadInput("is empty", str(path), "It must hold at least `format:` and `units:`")
    if not isinstance(tree, dict):
        raise BadInput("is not a mapping of keys to values", str(path),
                       "This looks like a table: the mechanism file comes first, then the tables"
                       if path.suffix.lower() in SUFFIXES else
                       "Begin it with a line such as `format: ppmcal/mechanism/1`")
    _check_size(tree, path)
    return tree


def _syntax(path: Path, error: yaml.MarkedYAMLError, data: bytes) -> BadInput:
    mark = error.problem_mark or error.context_mark
    where = f"{path}:{mark.line + 1}:{mark.column + 1}" if mark else str(path)
    what = error.problem or error.context or "not YAML"
    if "recursive" in what:
        return BadInput("an alias refers to itself: an endless structure", where,
                        "Remove the alias (`*name`)")
    if isinstance(error, _Twice):
        return BadInput(what, where, "Remove one of the two")
    if mark and _TAB.match(b"".join(data.splitlines()[mark.line:mark.line + 1])):
        return BadInput("a tab stands in the indentation", where, "Indent with spaces")
    return BadInput(f"YAML error: {what}", where, "Check indentation, brackets and quotes there")


def _check_events(data: bytes, path: Path) -> None:
    """Refuse what is too deep or too much before anything is built of it."""
    depth = count = 0
    for event in yaml.parse(data, Loader=yaml.CSafeLoader):
        if isinstance(event, yaml.NodeEvent):
            count += 1
            if isinstance(event, yaml.MappingStartEvent | yaml.SequenceStartEvent):
                depth += 1
        elif isinstance(event, yaml.MappingEndEvent | yaml.SequenceEndEvent):
            depth -= 1
        if depth > YAML_DEPTH.most or count > YAML_NODES.most:
            limit = YAML_DEPTH if depth > YAML_DEPTH.most else YAML_NODES
            mark = event.start_mark
            raise limit.error(f"{path}:{mark.line + 1}" if mark else str(path))


def _check_size(tree: Any, path: Path) -> None:
    """Refuse what aliases unfold to too much."""
    stack, count = [(tree, 0)], 0
    while stack:
        node, depth = stack.pop()
        count += 1
        if count > YAML_NODES.most or depth > YAML_DEPTH.most:
            raise BadInput("unfolds to a huge or endless structure", str(path),
                           "Remove the aliases (`*name`) from the file")
        children = node.values() if isinstance(node, dict) else node
        if isinstance(node, dict | list):
            stack.extend((child, depth + 1) for child in children)


class _Dumper(yaml.SafeDumper):
    """Emitter whose plain words stay words for this loader and for YAML 1.1 readers."""

    def ignore_aliases(self, data: Any) -> bool:
        """Never write anchors."""
        return True


_Dumper.add_implicit_resolver(_TAG + "float", _FLOAT, list("-+0123456789."))


def number_text(value: float) -> str:
    """Return the shortest text that reads back as exactly ``value`` (at most 17 digits)."""
    if not math.isfinite(value):
        return {"inf": ".inf", "-inf": "-.inf"}.get(repr(value), ".nan")
    if value == int(value) and abs(value) < 1e15:
        return "0" if value == 0.0 and repr(value)[0] != "-" else repr(value).removesuffix(".0")
    text = repr(value)
    if "e" in text and "." not in text:
        text = text.replace("e", ".0e")
    return text


def _represent_float(dumper: yaml.SafeDumper, value: float) -> yaml.Node:
    text = number_text(value)
    tag = "int" if _INT.match(text) else "float"
    return dumper.represent_scalar(_TAG + tag, text)


_Dumper.add_representer(float, _represent_float)


def printable(text: str) -> str:
    r"""Return text as UTF-8 can hold it: a byte of a file's name in another code is ``\udcff``."""
    return text.encode("utf-8", "backslashreplace").decode()


_Dumper.add_representer(str, lambda dumper, text: dumper.represent_str(printable(text)))


def dump_yaml(tree: dict[str, Any], comment: str = "") -> str:
    """Return the YAML text of plain data, innermost mappings and lists on one line."""
    head = "".join(f"# {line}".rstrip() + "\n" for line in comment.splitlines())
    body = yaml.dump(tree, Dumper=_Dumper, sort_keys=False, default_flow_style=None,
                     allow_unicode=True, width=110)
    return head + body


def decimals(value: float) -> int:
    """Return how many decimals the shortest text of a number has (``-69.282``: 3)."""
    if not math.isfinite(value):
        return 0
    digits, _, exponent = repr(float(value)).partition("e")
    after = digits.partition(".")[2].rstrip("0")
    return max(0, len(after) - int(exponent or 0))


# ---- files that extend others


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
    return merge(*({k: v for k, v in one.items() if k != "extends"} for one in (under, tree)))


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
