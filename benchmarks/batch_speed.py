"""How much faster two processes run a batch of small campaigns than one.

    python benchmarks/batch_speed.py [--campaigns 200] [--rows 40]

One run, so that the two figures are of one machine under one load. By wall clock, and by CPU
time, where others use the cores too: time in one process over (time here + time of two
workers / 2), which is what the clock would say on two free cores.
"""

import argparse
import resource
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "tests")]

from helpers.fleets import write_fleet  # noqa: E402

import ppmcal  # noqa: E402


def cpu():
    """Return the CPU seconds of this process and of its children that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time(), used.ru_utime + used.ru_stime


def timed(manifest, out, processes, scheduler=None):
    """Return wall seconds, CPU seconds here and of the workers of one batch."""
    wall, (here, there) = time.monotonic(), cpu()
    found = ppmcal.batch(manifest, out, cores=processes, scheduler=scheduler)
    assert not found.failed, found.failed[0].message
    wall = time.monotonic() - wall
    return wall, *(b - a for a, b in zip((here, there), cpu(), strict=True))


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--campaigns", type=int, default=200)
    options.add_argument("--rows", type=int, default=40)
    chosen = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        manifest = write_fleet(Path(folder) / "fleet", machines=chosen.campaigns,
                               dates=("2026-01-10",), rows=chosen.rows)
        ppmcal.batch(write_fleet(Path(folder) / "first", machines=1), Path(folder) / "o", cores=1)
        one = timed(manifest, Path(folder) / "one", 1)
        two = timed(manifest, Path(folder) / "two", 2)
    print(f"{chosen.campaigns} campaigns of {chosen.rows} rows, identify")
    for name, (wall, here, there) in (("one process", one), ("two workers", two)):
        print(f"{name}: {wall:.1f} s by the clock, CPU {here:.1f} s here, {there:.1f} s in workers")
    print(f"two workers are {one[0] / two[0]:.2f} times as fast by the clock, "
          f"{one[1] / (two[1] + two[2] / 2):.2f} times by CPU time")


if __name__ == "__main__":
    main()
