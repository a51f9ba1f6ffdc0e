"""A campaign of fuzzing: inputs that reach new lines or new refusals are kept and changed again."""

import hashlib
import os
import random
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from fuzz.judge import judged
from fuzz.mutations import fewer_rows, mutated, smaller
from fuzz.readers import CORPUS, folder
from fuzz.tracing import Lines

CRASHES = Path(os.environ.get("PPMCAL_FUZZ_CRASHES", CORPUS.parent / "crashes"))
LARGEST_KEPT = 6_000
POOL = 400
SMALL, FEW = 2000, 8
"""Bytes of an input, and inputs of a reader, that the corpus takes."""


@dataclass
class Tally:
    """What came of the inputs of one reader."""

    inputs: int = 0
    outcomes: Counter = field(default_factory=Counter)
    lines: int = 0
    slowest: float = 0.0
    faults: dict = field(default_factory=dict)
    fed: set = field(default_factory=set, repr=False)
    """Hashes of the inputs: none is fed twice."""

    def row(self, name):
        """Return one line of the table."""
        return (f"{name:22s}{self.inputs:10d}{len(self.outcomes):9d}{self.lines:8d}"
                f"{self.slowest:8.2f}{len(self.faults):7d}")


HEAD = f"{'reader':22s}{'inputs':>10s}{'outcomes':>9s}{'lines':>8s}{'s most':>8s}{'faults':>7s}"


def fuzz(reader, seconds, seed, tally=None, lines=None, most=None, keep=()):
    """Feed a reader changed inputs, none twice; return the tally and the inputs of use.

    ``seconds``: of processor time; ``most``: inputs at most.
    """
    rng = random.Random(seed)
    tally, lines = tally or Tally(), lines or Lines()
    pool = [*reader.seeds, *keep]
    form, largest = reader.form, max(LARGEST_KEPT, *map(len, reader.seeds), 0)
    stop, seeds = time.process_time() + seconds, list(reader.seeds)
    most = None if most is None else tally.inputs + most
    while time.process_time() < stop and (most is None or tally.inputs < most):
        data = (seeds.pop() if seeds else reader.draw(rng) if reader.draw
                else mutated(rng.choice(pool), pool, rng, form))
        if hash(data) in tally.fed:
            continue
        tally.fed.add(hash(data))
        begun = time.process_time()
        with lines.watching(always=bool(seeds)):
            outcome = judged(reader.read, data, reader.seconds)
        tally.slowest = max(tally.slowest, time.process_time() - begun)
        tally.inputs += 1
        fresh = outcome.key not in tally.outcomes
        tally.outcomes[outcome.key] += 1
        tally.lines += lines.new
        if outcome.fault and outcome.fault not in tally.faults:
            tally.faults[outcome.fault] = (data, outcome.detail)
        if (fresh or lines.new) and len(data) <= largest:
            pool.append(data)
            if len(pool) > POOL:
                pool.pop(rng.randrange(len(reader.seeds) or 1, len(pool)))
    return tally, pool[len(reader.seeds):]


def minimised(reader, fault, data):
    """Return a shorter input with the same fault."""
    def fails(shorter):
        return judged(reader.read, shorter, reader.seconds).fault == fault

    if reader.draw:
        return fewer_rows(data, fails, tries=15)
    # each try of a slow one costs seconds
    return smaller(data, fails, tries=15 if fault.startswith("slow") else 300)


def keep_crash(name, data):
    """Write an input that failed into the corpus of regressions."""
    home = CRASHES / name
    home.mkdir(parents=True, exist_ok=True)
    path = home / hashlib.sha256(data).hexdigest()[:12]
    path.write_bytes(data)
    return path


def grow(reader, kept):
    """Write the shortest inputs that reach lines beyond the reader's own into the corpus."""
    lines, home = Lines(), CORPUS / reader.name
    for data in [*reader.seeds, *sorted(kept, key=len)]:
        with lines.watching(always=True):
            judged(reader.read, data, reader.seconds)
        if lines.new and data not in reader.seeds and len(data) <= SMALL:
            home.mkdir(parents=True, exist_ok=True)
            if len(list(home.iterdir())) < FEW:
                (home / hashlib.sha256(data).hexdigest()[:12]).write_bytes(data)


def crashes():
    """Return reader and input of everything that failed once."""
    return [(p.parent.name, p) for p in sorted(CRASHES.glob("*/*"))]


def clean():
    """Remove the files of this process."""
    home = folder()
    for path, folders, files in os.walk(home, topdown=False):
        for name in files:
            os.unlink(os.path.join(path, name))
        for name in folders:
            os.rmdir(os.path.join(path, name))
    home.rmdir()
