"""``python -m fuzz --minutes M``: fuzz every reader and command, print what came of it."""

import argparse
import gc
import json
import signal
import sys
import time
import warnings

from fuzz.campaign import HEAD, Tally, clean, fuzz, grow, keep_crash, minimised
from fuzz.judge import limit_memory
from fuzz.readers import readers
from fuzz.tracing import Lines

TURN, INPUTS = 0.6, 1000
"""Seconds of processor time and inputs that one reader has at a time."""


def main():
    """Run the campaign."""
    words = argparse.ArgumentParser(description="Fuzz the readers and the commands.")
    words.add_argument("--minutes", type=float, default=10.0)
    words.add_argument("--seed", type=int, default=0)
    words.add_argument("--only", action="append", default=[], metavar="READER")
    words.add_argument("--commands", action="store_true", help="commands end to end, not readers")
    words.add_argument("--campaigns", action="store_true", help="poor campaigns, end to end")
    words.add_argument("--json", dest="record", help="file for the figures")
    words.add_argument("--grow", action="store_true", help="keep what reached far in the corpus")
    words.add_argument("--show", action="store_true", help="print the errors in full")
    given = words.parse_args()
    if given.commands:
        from fuzz.commands import commands as made
    elif given.campaigns:
        from fuzz.campaigns import campaigns as made
    else:
        made = readers
    chosen = {n: r for n, r in made().items() if not given.only or n in given.only}
    limit_memory()
    gc.freeze()    # the package and its libraries need no more looking through
    warnings.simplefilter("error")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        tallies = _run(chosen, given)
    finally:
        clean()
    print(HEAD)
    for name, tally in sorted(tallies.items()):
        print(tally.row(name))
    whole = sum(t.inputs for t in tallies.values())
    faults = sum(len(t.faults) for t in tallies.values())
    print(f"{whole} inputs, {faults} faults")
    sys.exit(1 if faults else 0)


def _run(chosen, given):
    stop = time.monotonic() + 60.0 * given.minutes
    tallies = {name: Tally() for name in chosen}
    lines = {name: Lines() for name in chosen} if not hasattr(sys, "monitoring") else dict.fromkeys(
        chosen, Lines())
    kept, turn = {name: [] for name in chosen}, 0
    while time.monotonic() < stop:
        for name, reader in chosen.items():
            known = set(tallies[name].faults)
            seconds = min(TURN, max(0.0, stop - time.monotonic()))
            _, kept[name] = fuzz(reader, seconds, f"{given.seed}/{turn}/{name}", tallies[name],
                                 lines[name], INPUTS, kept[name])
            for fault in set(tallies[name].faults) - known:
                data, detail = tallies[name].faults[fault]
                path = keep_crash(name, minimised(reader, fault, data))
                print(f"{name}: {fault}\n  {path}", flush=True)
                if given.show:
                    print(detail, flush=True)
        turn += 1
        if given.record:
            with open(given.record, "w", encoding="utf-8") as stream:
                json.dump({n: {"inputs": t.inputs, "outcomes": len(t.outcomes), "lines": t.lines,
                               "slowest": t.slowest, "faults": list(t.faults)}
                           for n, t in tallies.items()}, stream, indent=1)
    for name in chosen if given.grow else ():
        grow(chosen[name], kept[name])
    return tallies


if __name__ == "__main__":
    main()
