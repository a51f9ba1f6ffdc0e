"""How long a diagnosis takes, how that grows with the rows, and how much memory it needs.

    python benchmarks/test_diagnose_speed.py

CPU seconds beyond imports, one process for each size: a small campaign is diagnosed first, which
imports (and compiles) what is needed, then the one that counts. Peak memory is the process's. The
campaigns are those of `benchmarks/wild`: a hexapod measured in full, 5700 columns of hypotheses,
once with backlash and heat and once with nothing wrong.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import pytest  # noqa: E402
from wild.catalogue import write  # noqa: E402

from ppmcal import diagnose  # noqa: E402
from ppmcal.kinematics.compiled_limbs import MANY  # noqa: E402

MACHINE, SEED = "hexapod", 7
CASES = {"none": "none", "backlash-and-heat": "named"}
"""Cases, and the verdict that each deserves."""
SIZES = (160, 1000, 10_000)
MOST_MEMORY = 1000.0
"""MB that a diagnosis may take at any size."""


@dataclass(frozen=True)
class Spent:
    """What one diagnosis took: CPU seconds beyond imports, and MB at the most."""

    rows: int
    verdict: str
    seconds: float
    memory: float


def diagnosed(case: str, rows: int) -> tuple[str, float]:
    """Return the verdict on a campaign of so many rows, and the CPU time that it took."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        write(case, MACHINE, rows, SEED, folder, 1.0)
        begin = time.process_time()
        found = diagnose(folder / "mechanism.yaml", [folder / "data.csv"])
        return found.record.entries()["verdict"], time.process_time() - begin


def alone(case: str, rows: int) -> Spent:
    """Return what a diagnosis takes in a process of its own."""
    path = [*sys.path, os.environ.get("PYTHONPATH", "")]
    out = subprocess.run(
        [sys.executable, __file__, case, str(rows)], check=True, text=True, capture_output=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path)})
    return Spent(**json.loads(out.stdout.splitlines()[-1]))


@pytest.mark.parametrize("case", list(CASES))
def test_a_diagnosis_is_bounded_in_time_and_memory(benchmark, case: str) -> None:  # type: ignore[no-untyped-def]
    few, many = benchmark.pedantic(lambda: [alone(case, rows) for rows in (SIZES[0], SIZES[-1])],
                                   rounds=1, iterations=1)
    print(f"\n{case}: {few.rows} rows {few.seconds:.2f} s, {many.rows} rows {many.seconds:.2f} s: "
          f"factor {many.seconds / few.seconds:.1f}; {many.memory:.0f} MB")
    assert (few.verdict, many.verdict) == (CASES[case], CASES[case])
    assert many.memory < MOST_MEMORY


def main() -> None:
    """Diagnose one campaign, or all of them and print the table."""
    if len(sys.argv) > 1:
        case, rows = sys.argv[1], int(sys.argv[2])
        # compiled kernels are for many rows only; what is kept of them may be of another processor
        diagnosed("none", 2 * MANY if rows >= MANY else 60)
        verdict, seconds = diagnosed(case, rows)
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        print(json.dumps(asdict(Spent(rows, verdict, seconds, memory))))
        return
    print("| campaign | rows | verdict | CPU, s | times 160 rows | peak, MB |")
    print("|---|---|---|---|---|---|")
    for case in CASES:
        first = None
        for rows in SIZES:
            one = alone(case, rows)
            first = first or one.seconds
            print(f"| {case} | {rows} | {one.verdict} | {one.seconds:.1f} | "
                  f"{one.seconds / first:.1f} | {one.memory:.0f} |", flush=True)


if __name__ == "__main__":
    main()
