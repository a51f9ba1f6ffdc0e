"""Sentences about entries of identification.json, the same on the console and in the report.

The entries are what the other modules here write, in the units of the files; numbers that
JSON holds as null are None. Nothing else is needed to say what they say.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

Entry = Mapping[str, Any]

Z95 = 1.96
SMOOTH = 0.01
"""A flat has a shape where chance would show one as strong this rarely."""
ROWS = 8


def scale(entry: Entry) -> str:
    """Return how well a distance is known, and what to measure to know it better."""
    unit, sigma, alone = entry["unit"], entry["sigma"], entry["sigma_data"]
    size = f"{entry['distance']:.4g} {unit}"
    if sigma is None:
        return (f"Scale is not told at all: nothing holds the distance of {size} between the "
                "measured positions that lie farthest apart. Measure one distance.")
    text = f"Scale: a distance of {size} is known to +- {Z95 * sigma:.3g} {unit} (95 %)"
    if entry["held"]:
        left = (f"+- {Z95 * alone:.2g} {unit}"
                if alone is not None and alone < entry["distance"] else "it open")
        text += f" from the tolerances; the data alone leave {left}"
    needed, caliper = entry["measure_at_least"], entry["measure_to"]
    if needed <= entry["distance"]:
        return (f"{text}. One distance of at least {needed:.3g} {unit}, measured to "
                f"{caliper:.2g} {unit} (one sigma), would halve that.")
    return (f"{text}. That distance measured to {caliper * entry['distance'] / needed:.2g} {unit} "
            "(one sigma) would halve it.")


def twins(entry: Entry) -> str:
    """Return which two kinds of parameter act as one."""
    how = "limb by limb" if entry["limb_by_limb"] else "all limbs alike"
    return (f"{entry['a']} and {entry['b']}, {how}, are one direction to these data (correlation "
            f"{entry['correlation']:+.3f}); only the drawing tells them apart.")


def flat(entry: Entry) -> str:
    """Return which part of the residuals of touches is smooth over the flat."""
    unit = entry["unit"]
    return (f"{entry['dataset']}: {entry['smooth']:.2g} {unit} rms of what is left is smooth over "
            "the flat: its own shape, or what the model misses; touches scatter "
            f"{entry['scatter']:.2g} {unit} about it (p = {entry['p_value']:.1g}).")


def zero_moved(entry: Entry) -> str:
    """Return which joint's zero moved in which session, by how much."""
    return (f"the zero of {entry['actuator']} moved in {entry['session']}: by "
            f"{entry['value']:+.4g} +- {Z95 * entry['sigma']:.2g} {entry['unit'] or '(bare)'} "
            "against the others; give that session a file of its own with `homing: per-file`")


def unchecked(entry: Entry) -> str:
    """Return which rows nothing else checks."""
    rows = entry["rows"]
    some = ", ".join(str(r) for r in rows[:ROWS]) + (" ..." if len(rows) > ROWS else "")
    return (f"Unchecked: in {entry['dataset']} row{'s' if len(rows) > 1 else ''} {some}: nothing "
            "else tells what they tell, so a wrong value there would not show. Measure one more.")
