"""The studies whose figures the docs state: what each runs, what decides it, where it stands."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import ppmcal

from .digest import engine_digest

ROOT = Path(__file__).resolve().parents[2]
SPENT = re.compile(r"^\d+ s( on .*)?$")
"""Lines that only say how long a study took."""


@dataclass(frozen=True)
class Study:
    """A study whose output stands in a page.

    ``engine``: packages of ppmcal that decide its figures; ``but``: modules of them that run once
    all is decided, or before anything is; ``command``: script of benchmarks/
    with its options, without the seed; ``pages``: path to names of the places in it, each between
    ``<!-- rates: NAME -->`` and ``<!-- end of rates -->``; ``option``: what takes the seed.
    """

    name: str
    engine: tuple[str, ...]
    pages: dict[str, tuple[str, ...]]
    command: tuple[str, ...] = ()
    option: str = "--seed"
    but: tuple[str, ...] = ()

    @property
    def digest(self) -> str:
        """Of the code that decides the figures."""
        return engine_digest(self.engine, self.but)

    def made(self, seeds: list[int]) -> str:
        """Return the line that says of what a table is."""
        word = "seed" if len(seeds) == 1 else "seeds"
        return (f"Version {ppmcal.__version__}, engine {self.digest} "
                f"({', '.join(self.engine)}), {word} {', '.join(map(str, seeds))}")


DIAGNOSIS = ("diagnosis", "inference")
AFTERWARDS = ("diagnosis/equations.py", "diagnosis/session_effects.py")
"""What runs once the names stand: equations of what was learned, sizes by session, of which no rate
is made."""
BEFOREHAND = tuple(f"calibration/interpretation/{name}.py" for name in (
    "copies", "plausibility", "clock_offset"))
"""What is asked of files as they are read, before any fit."""

STUDIES = (
    Study("diagnosis", DIAGNOSIS,
          {"docs/diagnosis.md": ("rates", "reliability", "rates-by-case")},
          but=AFTERWARDS),
    Study("next", DIAGNOSIS, {"docs/diagnosis.md": ("next",)},
          ("next_study.py", "--count", "20", "--minutes", "20"), but=AFTERWARDS),
    Study("odd", DIAGNOSIS, {"docs/diagnosis.md": ("odd",)}, ("odd_physics.py",), "--seeds",
          AFTERWARDS),
    Study("weak", DIAGNOSIS, {"docs/campaigns.md": ("weak",)},
          ("weak_campaigns.py", "--seeds", "2"), "--first", AFTERWARDS),
    Study("ropes", DIAGNOSIS, {"docs/without-instrument.md": ("ropes",)},
          ("ropes_study.py", "--count", "2"), but=AFTERWARDS),
    Study("ropes-coverage", ("calibration",), {"docs/without-instrument.md": ("ropes-coverage",)},
          ("ropes_study.py", "--coverage", "200"), but=BEFOREHAND),
    Study("coverage", ("calibration",), {"docs/campaigns.md": ("coverage",)},
          ("campaigns.py", "--campaigns", "50"), but=BEFOREHAND),
    Study("compare", ("calibration",), {"docs/campaigns.md": ("compare",)},
          ("compare_study.py", "--quiet", "--pairs", "60", "--none", "60"), but=BEFOREHAND),
    Study("intervals", ("calibration",), {"docs/campaigns.md": ("intervals",)},
          ("interval_study.py", "--quick", "--machines", "6"), but=BEFOREHAND),
    Study("safe", ("calibration",), {"docs/trust.md": ("safe",)},
          ("safe_commands.py", "--machines", "44"), but=BEFOREHAND),
    Study("numbers", ("controllers",), {"docs/controllers.md": ("numbers",)},
          ("number_coverage.py", "--campaigns", "16")),
    Study("plan", ("design/plan",), {"docs/plan.md": ("plan",)},
          ("plan_study.py", "--campaigns", "30")),
)


def filled(page: str, name: str, text: str) -> str:
    """Return a page with a text in its place.

    Raises:
        ValueError: if the page has no place of that name.
    """
    start, end = f"<!-- rates: {name} -->", "<!-- end of rates -->"
    found = re.subn(f"({re.escape(start)}\n).*?({re.escape(end)})",
                    lambda m: f"{m[1]}\n{text}\n\n{m[2]}", page, flags=re.S)
    if found[1] != 1:
        raise ValueError(f"no {start} ... {end}")
    return found[0]


def place(study: Study, name: str, text: str) -> None:
    """Write a text into the pages that have a place for it."""
    for path, names in study.pages.items():
        if name in names:
            page = (ROOT / path).read_text(encoding="utf-8")
            (ROOT / path).write_text(filled(page, name, text), encoding="utf-8")


def printed(study: Study, seed: int, output: str) -> str:
    """Return what stands in a page of a command's output: Markdown as it is, else as text."""
    lines = [line.rstrip() for line in output.splitlines() if not SPENT.match(line)]
    body = "\n".join(lines).strip()
    if "|---" not in body:
        body = f"```\n{body}\n```"
    command = " ".join(("python", f"benchmarks/{study.command[0]}", *study.command[1:],
                        study.option, str(seed)))
    return f"{study.made([seed])}: `{command}`\n\n{body}"
