"""The page of the Python face, from its signatures and docstrings."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import Any

import ppmcal
from generators.markdown import code, fenced, table
from ppmcal.commands import functions
from ppmcal.commands.face import result_of

SECTIONS = ("Args", "Returns", "Raises", "Attributes")
INTRODUCTION = """# Python functions

`import ppmcal` loads neither NumPy nor SciPy; each function is loaded on first use. Functions
accept files, data frames, mappings of columns and arrays. Tables are in the units of the mechanism
file, attributes of results in SI units. [A notebook](calibration.md) goes from a drawing to
corrected commands.

In the signatures `Machine` is a mechanism, its file, the folder of a result or a mapping with the
content of the file; `Measurements` are data sets, or paths of measurement files; `Path_` is a path;
`Table` is the path of a table, a data frame or a mapping of columns; `Progress` is called with
a line of text from time to time.
"""


def api_page() -> str:
    """Return the page: functions, then results, then errors."""
    public = {name: getattr(ppmcal, name) for name in (*ppmcal._HOME, *functions())}
    own = {n: v for n, v in public.items() if inspect.isfunction(v)}
    errors = {n: v for n, v in public.items() if inspect.isclass(v)}
    results = {v.__name__: v for v in map(result_of, functions()) if v is not None}
    listed = table(["function", "what it does"], [
        (f"[`{n}`](#{n.lower()})", first_line(f)) for n, f in sorted(own.items())])
    return "\n".join([
        INTRODUCTION, listed, "## Functions\n",
        *(_function(n, f) for n, f in sorted(own.items())), "## Results\n",
        *(_class(n, c) for n, c in sorted(results.items())), "## Errors\n",
        *(_class(n, c) for n, c in sorted(errors.items()))])


def first_line(thing: object) -> str:
    """Return the first sentence of a docstring."""
    return markup((inspect.getdoc(thing) or "").partition("\n\n")[0])


def markup(text: str) -> str:
    """Return a docstring's text as Markdown: its roles and double backticks."""
    text = re.sub(r":\w+:`~?([^`]+)`", r"`\1`", " ".join(text.split()))
    return text.replace("``", "`")


def _signature(name: str, function: Any, dots: str = "ppmcal.") -> str:
    signature = inspect.signature(function)
    words: list[str] = []
    for one in signature.parameters.values():
        if one.kind is one.KEYWORD_ONLY and "*" not in words:
            words.append("*")
        star = "*" if one.kind is one.VAR_POSITIONAL else ""
        words.append(f"{star}{one.name}: {one.annotation}{_given(one.default)}")
    end = f") -> {signature.return_annotation}"
    text = ", ".join(words)
    if len(text) + len(name) + len(end) > 84:
        text = "\n    " + ",\n    ".join(words).replace("*,\n    ", "*, ")
    return fenced(f"{dots}{name}({text}{end}", "python")


def _given(default: object) -> str:
    if default is inspect.Parameter.empty:
        return ""
    return f" = {default.__name__ if inspect.isfunction(default) else repr(default)}"


def _function(name: str, function: Any) -> str:
    return f"### {name}\n\n{_signature(name, function)}\n{docstring(function)}"


def docstring(thing: object) -> str:
    """Return a docstring's prose, then its sections as tables."""
    parts: dict[str, list[str]] = {"": []}
    section = ""
    for line in (inspect.getdoc(thing) or "").splitlines():
        if line.rstrip(":") in SECTIONS and line.endswith(":"):
            section = line.rstrip(":")
            parts[section] = []
        elif section and line and not line.startswith(" "):
            section = ""
            parts[section].append(line)
        else:
            parts[section].append(line)
    prose, _, session = "\n".join(parts.pop("")).partition(">>> ")
    out = ["\n\n".join(markup(p) for p in prose.split("\n\n") if p.strip()) + "\n"]
    if session:
        out.append(fenced(">>> " + session, "pycon"))
    for heading, lines in parts.items():
        if heading == "Returns":
            out.append(f"**Returns**: {markup(' '.join(lines))}\n")
        else:
            out.append(table([heading.lower(), "meaning"], _entries(lines)))
    return "\n".join(out)


def _entries(lines: list[str]) -> Iterator[tuple[str, str]]:
    """Yield (names, meaning) of ``name: meaning`` lines that may go on, indented further."""
    text = inspect.cleandoc("\n".join(lines))
    for part in re.split(r"\n(?=\S)", text):
        names, _, meaning = part.partition(":")
        yield ", ".join(code(n.strip()) for n in names.split(",")), markup(meaning)


def _class(name: str, kind: type) -> str:
    rows = []
    for own in dir(kind):
        found = inspect.getattr_static(kind, own)
        if own.startswith("_") or own.isupper():
            continue
        function = getattr(found, "func", None) or getattr(found, "fget", None)
        if function is not None:
            rows.append((code(own), first_line(function)))
        elif inspect.isfunction(found) and inspect.getdoc(found):
            arguments = ", ".join(n for n in inspect.signature(found).parameters if n != "self")
            rows.append((code(f"{own}({arguments})"), first_line(found)))
    members = table(["also has", "what it is"], rows) if rows else ""
    return f"### {name}\n\n{docstring(kind)}\n{members}"
