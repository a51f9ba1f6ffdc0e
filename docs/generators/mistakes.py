"""A stranger's usual mistakes, each with the words by which the answer has to name cause and hint.

A mistake is one edit of the files in `docs/stranger`, then one command.
"""

from __future__ import annotations

import csv
import math
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from generators.pages import Ran, Run
from generators.paths import DOCS

STRANGER = DOCS / "stranger"
Row = dict[str, str]


@dataclass(frozen=True)
class Mistake:
    """One mistake.

    ``title``: what went wrong; ``story``: how it came about; ``edit``: does it in a folder;
    ``line``: the command that meets it; ``code``: how it ends; ``cause``, ``hint``: patterns that
    the answer must hold, line breaks taken for spaces; ``lines``: how many of them the page shows,
    the last ones where it is negative.
    """

    title: str
    story: str
    edit: Callable[[Path], None]
    line: str
    code: int
    cause: str
    hint: str
    lines: int = 14


def _rows(change: Callable[[list[Row]], list[Row] | None]) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        path = folder / "run1.csv"
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        rows = change(rows) or rows
        with path.open("w", newline="", encoding="utf-8") as file:
            table = csv.DictWriter(file, list(rows[0]))
            table.writeheader()
            table.writerows(rows)
    return edit


def _scaled(names: str, factor: float) -> Callable[[Path], None]:
    def change(rows: list[Row]) -> None:
        for row in rows:
            row.update({n: f"{float(row[n]) * factor:.9g}" for n in names.split()})
    return _rows(change)


def _swapped(rows: list[Row]) -> None:
    for row in rows:
        row["q_leg2"], row["q_leg3"] = row["q_leg3"], row["q_leg2"]


def _euler(rows: list[Row]) -> None:
    """Write the rotations as angles about the fixed x, y, z, as many trackers do."""
    for row in rows:
        x, y, z = (math.radians(float(row[n])) for n in ("rx", "ry", "rz"))
        angle = math.sqrt(x * x + y * y + z * z)
        k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) / angle
        r = np.eye(3) + math.sin(angle) * k + (1 - math.cos(angle)) * k @ k
        angles = (math.atan2(r[2, 1], r[2, 2]), -math.asin(r[2, 0]), math.atan2(r[1, 0], r[0, 0]))
        row.update(zip(("rx", "ry", "rz"), (f"{math.degrees(a):.6f}" for a in angles), strict=True))


def _header_again(folder: Path) -> None:
    lines = (folder / "run1.csv").read_text(encoding="utf-8").splitlines()
    (folder / "run1.csv").write_text("\n".join([*lines[:31], lines[0], *lines[31:]]) + "\n",
                                     encoding="utf-8")


def _commas(folder: Path) -> None:
    text = (folder / "run1.csv").read_text(encoding="utf-8")
    head, _, body = text.partition("\n")
    (folder / "run1.csv").write_text(f"{head}\n{body.replace('.', ',')}", encoding="utf-8")


def _text(name: str, old: str, new: str) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        text = (folder / name).read_text(encoding="utf-8")
        assert old in text, f"{name} has no {old!r}"
        (folder / name).write_text(text.replace(old, new, 1), encoding="utf-8")
    return edit


def _diameters(folder: Path) -> None:
    text = (folder / "mine.yaml").read_text(encoding="utf-8")

    def twice(found: re.Match[str]) -> str:
        return f"base: {{point: [{2 * float(found[1]):g}, {2 * float(found[2]):g}, 0]}}"

    (folder / "mine.yaml").write_text(
        re.sub(r"base: \{point: \[([-\d.]+), ([-\d.]+), 0\]\}", twice, text), encoding="utf-8")


IDENTIFY, CHECK = "ppmcal identify mine.yaml run1.csv", "ppmcal check mine.yaml"
MISTAKES = (
    Mistake("Wrong unit", "The tracker wrote metres; the sidecar says mm.",
            _scaled("x y z", 1e-3), IDENTIFY, 3, r"in m\b|metres|unit", r"units: \{"),
    Mistake("Swapped columns", "The cables of legs 2 and 3 were swapped at the logger.",
            _rows(_swapped), IDENTIFY, 3, "q_leg2.*q_leg3", r"columns: *\{? *q_leg2: q_leg3"),
    Mistake("No sidecar", "The CSV was copied, its YAML was not.",
            lambda folder: (folder / "run1.yaml").unlink(), IDENTIFY, 2, r"run1\.yaml",
            "format: ppmcal/dataset/1"),
    Mistake("Degrees for radians", "The tracker wrote radians; the sidecar says deg.",
            _scaled("rx ry rz", math.pi / 180.0), IDENTIFY, 3, "rad", r"units: *\{"),
    Mistake("Wrong sign", "The tracker's rx has the opposite sign.",
            _scaled("rx", -1.0), IDENTIFY, 3, "rx", r"signs: *\{? *rx: -1"),
    Mistake("Decimal commas",
            "The spreadsheet wrote decimal commas, and commas between columns as well.",
            _commas, IDENTIFY, 2, "decimal comma", "point|semicolon|separat"),
    Mistake("Wrong branch", "Home was entered with its z below the base.",
            _text("mine.yaml", "z: 310", "z: -310"), IDENTIFY, 3,
            "mirror image of the machine .home", "correct the mechanism file"),
    Mistake("A second header", "Two files were concatenated with their headers.",
            _header_again, IDENTIFY, 2, "row 31, column q_leg1",
            "header stands again.*take the line out"),
    Mistake("Too few poses", "Six poses, for a quick try.",
            _rows(lambda rows: rows[:6]), IDENTIFY, 1, "36 numbers for 51 unknowns",
            r"poses more .* would fix that, see next\.csv", lines=-11),
    Mistake("A typo in a key", "`platfrom` in leg 4.",
            _text("mine.yaml", "platform: {point: [-120.7, -2",
                  "platfrom: {point: [-120.7, -2"),
            CHECK, 2, "unknown key 'platfrom'", "Did you mean 'platform'"),
    Mistake("Diameters for radii", "The drawing gave diameters; they were entered as radii.",
            _diameters, IDENTIFY, 3, "twice|half|diameter|radius", "radius|diameter|half"),
    Mistake("Euler angles", "The tracker wrote angles about x, y, z, not a rotation vector.",
            _rows(_euler), IDENTIFY, 3, "euler-xyz", "rotation: euler-xyz"),
    Mistake("A tab in the YAML", "An editor put a tab in front of `home`'s pose.",
            _text("mine.yaml", "home: {pose", "home:\n\t{pose"), CHECK, 2,
            "mine.yaml:.*a tab stands", "spaces"),
)


def happen(mistake: Mistake, folder: Path, run: Run) -> Ran:
    """Lay out the stranger's files, make the mistake, and return the answer to its command."""
    lay_out(folder)
    mistake.edit(folder)
    return run(shlex.split(mistake.line)[1:], folder)


def lay_out(folder: Path) -> None:
    """Put the stranger's files into a folder, and measure there."""
    shutil.copytree(STRANGER, folder, dirs_exist_ok=True)
    subprocess.run([sys.executable, "measure.py"], cwd=folder, check=True)


def sections(run: Run, scratch: Path) -> str:
    """Return the part of the page that shows each mistake, its answer and the time taken."""
    out = []
    for i, mistake in enumerate(MISTAKES, 1):
        folder = scratch / str(i)
        began = time.perf_counter()
        ran = happen(mistake, folder, run)
        seconds = time.perf_counter() - began
        lines = [line.rstrip() for line in ran.text.strip().splitlines()]
        shown = (["...", *lines[mistake.lines:]] if mistake.lines < 0
                 else lines[:mistake.lines] + ["..."] * (len(lines) > mistake.lines))
        out.append(f"### {i}. {mistake.title}\n\n{mistake.story} Exit code {ran.code}, "
                   f"{seconds:.0f} s.\n\n```text\n$ {mistake.line}\n"
                   + "\n".join(shown) + "\n```\n")
    return "\n".join(out)
