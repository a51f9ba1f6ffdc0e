"""What type checkers and editors see of the Python face: ``ppmcal/__init__.pyi``.

``python -m generators.stub`` in ``docs`` writes it; a test sees that it is as it would be written.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from pathlib import Path

import ppmcal
from ppmcal.commands import command, functions, work
from ppmcal.commands.face import function

TARGET = Path(ppmcal.__file__).with_suffix(".pyi")
HEAD = '"""What type checkers see of the Python face; names are loaded on first use."""\n'
PLACES = {"Mapping": "collections.abc", "Sequence": "collections.abc", "Any": "typing",
          "Machine": "ppmcal.commands.inputs", "CalibratedMachine": "ppmcal.commands.result",
          "Progress": "ppmcal.commands.result", "Measurements": "ppmcal.commands.spec",
          "Path_": "ppmcal.commands.spec", "Table": "ppmcal.commands.spec"}
"""Names of annotations, and where they are."""


def stub() -> str:
    """Return the text of the file."""
    made = "\n".join(map(_function, sorted(functions())))
    words = set(re.findall(r"[A-Za-z_]+", made))
    used: dict[str, list[str]] = {}
    for name, module in (*PLACES.items(), *_results()):
        if name in words:
            used.setdefault(module, []).append(name)
    for name, module in ppmcal._HOME.items():
        used.setdefault(f"ppmcal.{module}", []).append(f"{name} as {name}")
    lines = [one for module, names in sorted(used.items()) for one in _imports(module, names)]
    own = [one for one in lines if one.startswith("from ppmcal")]
    others = [one for one in lines if one not in own]
    return "\n".join([HEAD, *others, "", *own, "", "__version__: str",
                      "__all__: list[str]", "_HOME: dict[str, str]", "", made, ""])


def _imports(module: str, names: list[str]) -> Iterator[str]:
    """Yield the imports from a module; each name that is handed on in a line of its own."""
    if own := sorted(n for n in names if " as " not in n):
        yield f"from {module} import {', '.join(own)}"
    for name in sorted(n for n in names if " as " in n):
        yield f"from {module} import {name}"


def _results() -> Iterator[tuple[str, str]]:
    """Yield what functions return, and where it is."""
    for one in dict.fromkeys(one for one, _ in functions().values()):
        if kind := getattr(work(one), command(one).result, None):
            yield kind.__name__, kind.__module__


def _function(name: str) -> str:
    """Return a function, an argument on each line where one line is too short for all."""
    signature = inspect.signature(function(name))
    words: list[str] = []
    for one in signature.parameters.values():
        if one.kind is one.KEYWORD_ONLY and "*" not in words and not any(
                w.startswith("*") for w in words):
            words.append("*")
        star = "*" if one.kind is one.VAR_POSITIONAL else ""
        given = "" if one.default is one.empty else " = ..."
        words.append(f"{star}{one.name}: {one.annotation}{given}")
    end = f") -> {signature.return_annotation}: ..."
    line = f"def {name}({', '.join(words)}{end}"
    return line if len(line) <= 100 else (
        f"def {name}(\n" + "".join(f"    {word},\n" for word in words) + end)


if __name__ == "__main__":
    TARGET.write_text(stub(), encoding="utf-8")
