"""The commands and files that a page shows, and how to run them.

A page shows files as blocks with a title (```` ```yaml title="mine.yaml" ````), and commands in two
ways. Lines of a plain block that begin with a command are commands; ``#`` begins a remark. In a
``console`` block lines behind ``$`` are commands, and what follows is what they print: ``make
docs-output`` writes it anew. A line ``...`` stands for the rest of it; ``... 12`` in its
first line asks for twelve lines of it. A remark ``# exit code 2``
says how a command ends; without one it ends with 0 or 1.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from generators.paths import ROOT

FENCE = re.compile(r"^```(?P<head>[^\n`]*)\n(?P<body>.*?)^```$", re.M | re.S)
COMMAND = re.compile(r"(ppmcal|make|python|pytest|pip|pipx|eval|cat|head|cp)\b")
WHOLE = "<!-- one folder -->"
"""Begins a page whose blocks belong together: they run in one folder, which has `sample_data`."""
DONE = (0, 1)
"""Exit codes of what is done, with or without findings."""


@dataclass(frozen=True)
class Step:
    """A file to write (``name``, ``text``) or a command to run (``line``), in its block.

    ``output``: the lines that a console block shows; ``codes``: how the command may end.
    """

    block: int
    line: str = ""
    name: str = ""
    text: str = ""
    codes: tuple[int, ...] = DONE
    output: tuple[str, ...] = ()


@dataclass(frozen=True)
class Ran:
    """How a command ended and what it printed."""

    code: int
    text: str


Run = Callable[[list[str], Path], Ran]


def steps(page: str) -> Iterator[Step]:
    """Yield the files and commands of a page in order; blocks are numbered by their lines."""
    for found in FENCE.finditer(page):
        number = page.count("\n", 0, found.start()) + 1
        language, _, _ = found["head"].partition(" ")
        title = re.search(r'title="([^"]+)"', found["head"])
        if title:
            yield Step(number, name=title[1], text=found["body"])
        elif language == "console":
            yield from _console(found["body"], number)
        elif language in ("", "sh"):
            for line in re.sub(r"\\\n\s*", "", found["body"]).splitlines():
                if COMMAND.match(line):
                    yield _command(line, number)


def _console(body: str, number: int) -> Iterator[Step]:
    parts = re.split(r"^\$ ", re.sub(r"\\\n\s*", "", body), flags=re.M)
    for part in parts[1:]:
        line, _, output = part.partition("\n")
        yield replace(_command(line, number), output=tuple(output.splitlines()))


def _command(line: str, number: int) -> Step:
    command, _, remark = re.sub(r"\s+#", " #", line).partition(" #")
    code = re.search(r"exit code (\d)", remark)
    return Step(number, line=command.strip(), codes=(int(code[1]),) if code else DONE)


def units(page: str) -> list[list[Step]]:
    """Return the steps that share a folder: those of the page, or of each block.

    Files that a page shows are there in every block after them.
    """
    found = list(steps(page))
    if page.startswith(WHOLE):
        return [found]
    files = [s for s in found if s.name]
    return [[*(f for f in files if f.block < block), *(s for s in found if s.block == block)]
            for block in dict.fromkeys(s.block for s in found if s.line)]


def perform(step: Step, folder: Path, run: Run) -> Ran:
    """Write a step's file, or run its command in the folder.

    Args:
        step: what to do.
        folder: where.
        run: runs ``ppmcal`` with these arguments in a folder.
    """
    if step.name:
        target = folder / step.name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(step.text, encoding="utf-8")
        return Ran(0, "")
    verb, *words = shlex.split(step.line)
    if verb == "ppmcal":
        return run(words, folder)
    if verb == "cat":
        return Ran(0, "".join((folder / w).read_text(encoding="utf-8") for w in words))
    if verb == "head":
        count, name = int(words[0].lstrip("-")), words[1]
        lines = (folder / name).read_text(encoding="utf-8").splitlines()[:count]
        return Ran(0, "\n".join(lines) + "\n")
    if verb == "cp":
        shutil.copy(folder / words[0], folder / words[1])
        return Ran(0, "")
    if verb == "python" and (folder / words[0]).exists():
        return _process([sys.executable, *words], folder)
    return stands(step)


def stands(step: Step) -> Ran:
    """Return whether a command that is not run here names what is there: a target, a script."""
    verb, *words = shlex.split(step.line)
    if verb == "make":
        targets = re.findall(r"^(\S+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)
        good = words[0] in targets
    elif verb in ("python", "pytest"):
        good = all((ROOT / w).exists() for w in words if w.endswith(".py"))
    else:
        good = verb in ("pip", "pipx", "eval")
    return Ran(0 if good else 2, "" if good else f"{step.line}: there is no such thing")


def _process(command: list[str], folder: Path) -> Ran:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False,
                          env={**os.environ, "COLUMNS": "80", "NO_COLOR": "1"})
    return Ran(done.returncode, done.stdout + done.stderr)


def own_process(words: list[str], folder: Path) -> Ran:
    """Run ``ppmcal`` as a process of its own."""
    return _process([sys.executable, "-m", "ppmcal", *words], folder)


def with_output(page: str, folder: Path) -> str:
    """Return a page of one folder with what its commands print now.

    Raises:
        RuntimeError: a command ends otherwise than the page says.
    """
    printed: dict[int, list[str]] = {}
    for step in steps(page):
        ran = perform(step, folder, own_process)
        if ran.code not in step.codes:
            raise RuntimeError(f"{step.line}: exit code {ran.code}\n{ran.text}")
        if step.line:
            printed.setdefault(step.block, []).append(ran.text)
    return FENCE.sub(lambda m: _refreshed(m, printed.get(page.count("\n", 0, m.start()) + 1, [])),
                     page)


def _refreshed(found: re.Match[str], printed: list[str]) -> str:
    if not found["head"].startswith("console"):
        return found[0]
    out = []
    for part, text in zip(re.split(r"^\$ ", found["body"], flags=re.M)[1:], printed, strict=True):
        command = re.match(r"(?:.*\\\n)*.*\n", part)
        assert command is not None
        shown = part[command.end():].splitlines()
        lines = [line.rstrip() for line in text.rstrip().splitlines()]
        asked = re.fullmatch(r"\.\.\. (\d+)", shown[0]) if shown else None
        if asked or "..." in shown:
            kept = int(asked[1]) if asked else shown.index("...")
            lines = [*lines[:kept], "..."] if len(lines) > kept else lines
        out.append("$ " + command[0] + "".join(f"{line}\n" for line in lines))
    return f"```{found['head']}\n{''.join(out)}```"
