"""Run the studies whose figures the docs state, and write them into the docs.

    PYTHONPATH=benchmarks python -m rates --seeds 901 902 903     # all, on seeds never seen
    PYTHONPATH=benchmarks python -m rates --seeds 904 --only safe # the others stay as they are
    PYTHONPATH=benchmarks python -m rates --seeds 5 --out study   # a look at `diagnose` alone

The campaigns of `diagnose` are run for every seed, the other studies for the first. A study of
campaigns that was stopped goes on where it was; one of another engine is begun anew.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from study_runner import read, remaining, work  # noqa: E402

from .campaigns import Line, jobs, run  # noqa: E402
from .studies import ROOT, STUDIES, place, printed  # noqa: E402
from .tables import FOLDER, GENERATORS, TABLES  # noqa: E402


def main() -> None:
    """Run what is missing, then write the tables."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", required=True)
    parser.add_argument("--only", nargs="+", choices=[s.name for s in STUDIES],
                        default=[s.name for s in STUDIES])
    parser.add_argument("--generators", nargs="+", choices=GENERATORS, default=list(GENERATORS))
    parser.add_argument("--out", type=Path, help="into this folder; the docs stay as they are")
    parser.add_argument("--minutes", type=float, default=0.0, help="stop after this time")
    parser.add_argument("--cores", type=int, default=os.cpu_count() or 1)
    given = parser.parse_args()
    for study in STUDIES:
        if study.name == "diagnosis" and study.name in given.only:
            tables = diagnosis(given, study.made(given.seeds))
            if given.out is None:
                for name, text in tables.items():
                    place(study, name, text)
        elif study.name in given.only and given.out is None:
            command = [sys.executable, str(ROOT / "benchmarks" / study.command[0]),
                       *study.command[1:], study.option, str(given.seeds[0])]
            print(f"{study.name}: {' '.join(study.command)}", file=sys.stderr)
            ran = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
            if ran.stdout:  # a figure outside of what is wanted ends with 1, and is told too
                place(study, study.name, printed(study, given.seeds[0], ran.stdout))


def diagnosis(given: argparse.Namespace, made: str) -> dict[str, str]:
    """Run the campaigns of `diagnose` that have no line yet; return the tables by name."""
    folder: Path = given.out or FOLDER
    path, state = folder / "campaigns.csv", folder / "about.json"
    now = {"made": made, "seeds": given.seeds}
    if path.exists() and (not state.exists() or json.loads(state.read_text()) != now):
        path.unlink()
    folder.mkdir(parents=True, exist_ok=True)
    state.write_text(json.dumps(now) + "\n", encoding="utf-8")
    end = time.monotonic() + 60.0 * given.minutes if given.minutes else None
    work(path, Line, run, remaining(path, jobs(given.seeds, given.generators)), end, given.cores)
    head, *lines = path.read_text(encoding="utf-8").splitlines()
    # which core was faster is not told
    path.write_text("\n".join([head, *sorted(lines)]) + "\n", encoding="utf-8")
    tables = {name: table(read(path), now) for name, table in TABLES.items()}
    print(tables["rates"])
    return tables


if __name__ == "__main__":
    main()
