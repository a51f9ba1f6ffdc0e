"""Run the study and write its tables into the docs.

    PYTHONPATH=benchmarks python -m rates --seeds 901 902 903   # seeds that nobody has looked at
    PYTHONPATH=benchmarks python -m rates --out study --generators wild --seeds 5   # a look only

Without ``--out`` the lines go to docs/rates/, with seeds, version and a digest of the engine, and
the tables into docs/diagnosis.md and README.md. A study that was stopped goes on where it was; one
of another engine is begun anew.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from study_runner import read, remaining, work  # noqa: E402

import ppmcal  # noqa: E402

from .campaigns import Line, jobs, run  # noqa: E402
from .digest import engine_digest  # noqa: E402
from .tables import FOLDER, GENERATORS, PAGES, ROOT, TABLES, about, filled  # noqa: E402


def main() -> None:
    """Run what is missing, then write the tables."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", required=True)
    parser.add_argument("--generators", nargs="+", choices=GENERATORS, default=list(GENERATORS))
    parser.add_argument("--out", type=Path, help="into this folder; the docs stay as they are")
    parser.add_argument("--minutes", type=float, default=0.0, help="stop after this time")
    parser.add_argument("--cores", type=int, default=os.cpu_count() or 1)
    given = parser.parse_args()
    folder = given.out or FOLDER
    path, state = folder / "campaigns.csv", folder / "about.json"
    now = {"version": ppmcal.__version__, "engine": engine_digest(), "seeds": given.seeds}
    if path.exists() and (not state.exists() or json.loads(state.read_text()) != now):
        path.unlink()
    folder.mkdir(parents=True, exist_ok=True)
    state.write_text(json.dumps(now) + "\n", encoding="utf-8")
    end = time.monotonic() + 60.0 * given.minutes if given.minutes else None
    work(path, Line, run, remaining(path, jobs(given.seeds, given.generators)), end, given.cores)
    ordered(path)
    lines = read(path)
    for name, table in TABLES.items():
        (folder / f"{name}.md").write_text(table(lines, now) + "\n", encoding="utf-8")
    print(TABLES["rates"](lines, now))
    if given.out is None:
        write()


def ordered(path: Path) -> None:
    """Put the lines of a study in an order that does not tell which core was faster."""
    head, *lines = path.read_text(encoding="utf-8").splitlines()
    path.write_text("\n".join([head, *sorted(lines)]) + "\n", encoding="utf-8")


def write() -> None:
    """Set the tables of docs/rates into their pages."""
    lines, known = read(FOLDER / "campaigns.csv"), about()
    for page, names in PAGES.items():
        text = (ROOT / page).read_text(encoding="utf-8")
        for name in names:
            text = filled(text, name, TABLES[name](lines, known))
        (ROOT / page).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
