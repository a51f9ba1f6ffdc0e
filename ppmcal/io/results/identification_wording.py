"""What console and report say of a fit: noise, rows left out, what the data cannot identify.

A sentence about an entry in which a number is missing is empty.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import (
    LARGER,
    SMALLER,
    Flat,
    GrossError,
    GrossErrors,
    HomingShift,
    Noise,
    UncheckedRows,
    Unidentifiable,
    half_or,
)
from ppmcal.calibration.knowledge import CollinearParameters, Scale
from ppmcal.calibration.validation import Dependence
from ppmcal.io.results.parts import LeftOutRow
from ppmcal.io.results.units import JOINT, MachineUnits, column_factor, parameter_unit
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.wording import MOST, abbreviate_list, chance, number, pluralize

TERMS = 6


def noise_verdict(noise: Noise) -> tuple[str, bool]:
    """Return what the residuals say about the noise, and whether that is fine."""
    words, state = noise_words(noise), noise.state
    if words and state == LARGER:
        return f"{words}: something is missing in the model, or sigma is too small", False
    if words and state == SMALLER:
        return f"{words}: sigma looks too large", False
    return words, True


def noise_words(noise: Noise) -> str:
    """Return the same without what it means, empty where the noise was not checked."""
    ratio, p = noise.sigma_ratio, noise.chi2_p
    tail = ", ".join([f"ratio {ratio:.3g}"] * math.isfinite(ratio)
                     + [chance(p)] * math.isfinite(p))
    are = {LARGER: "exceed", SMALLER: "are below"}.get(noise.state, "are consistent with")
    return f"residuals {are} the {noise.source} noise ({tail})" if tail else ""


SHORT = {
    "gcv": "95 % intervals take the prior scale that cross-validation chose as known: in simulated "
           "campaigns they held the truth 83 to 91 % of the time",
    "damped": "95 % intervals do not count what damping leaves near nominal: in simulated "
              "campaigns they held the truth 88 % of the time"}
"""What the intervals of a method leave out, and how often they hold."""


def short_intervals(method: str) -> list[str]:
    """Return that the 95 % intervals of a method are too short, if they are."""
    return [SHORT[method]] if method in SHORT else []


def combination(entry: Dependence) -> str:
    """Return what acts like one unit of a redundant quantity: ``0.5*leg2.offset - frame.x``."""
    terms = sorted(((k, v) for k, v in entry.depends_on.items() if abs(v) > 0.0),
                   key=lambda t: -abs(t[1]))
    if not terms:
        return "nothing: no effect on these measurements"
    shown = "".join((" - " if v < 0 else " + " if i else "")
                    + ("" if abs(abs(v) - 1) < 5e-4 else f"{abs(v):.3g}*") + k
                    for i, (k, v) in enumerate(terms[:TERMS])).strip()
    return shown + (f" and {pluralize(len(terms) - TERMS, 'smaller part')}"
                    if len(terms) > TERMS else "")


SHOWN = 3
CHANGED = 3
ROWS = 8


def shift_sentence(shift: HomingShift) -> str:
    """Return which joint's homing offset shifted in which session, by how much."""
    half = half_or(shift.half if math.isfinite(shift.half) else None, shift.sigma)
    if half is None or not (math.isfinite(shift.value + half) and shift.actuator and shift.session):
        return ""
    return (f"the homing offset of {shift.actuator} shifted in {shift.session}: by "
            f"{shift.value:+.4g} +- {half:.2g} {shift.unit or 'units'} against the "
            "others; give that session a file of its own with `homing: per-file`")


def unchecked_sentences(found: Iterable[UncheckedRows]) -> list[str]:
    """Return which rows nothing else checks, one sentence for each data set."""
    out = []
    for u in found:
        if u.dataset and u.rows:
            some = abbreviate_list([str(r) for r in u.rows], most=ROWS)
            rows = f"rows {some} have" if len(u.rows) > 1 else f"row {some} has"
            out.append(f"{u.dataset}: {rows} no backup: a wrong reading there would go unnoticed. "
                       "Measure one more.")
    return out


def would_be(found: GrossErrors, mechanism: Mechanism) -> dict[str, dict[str, float]]:
    """Return what rows left out would change: value ``now`` and ``with_them``, file units."""
    return {name: {"now": now / f, "with_them": then / f}
            for name, (now, then) in found.would.items()
            for f in [column_factor(mechanism, name)]}


def row_sentences(rows: Sequence[LeftOutRow],
                  would: Mapping[str, Mapping[str, float | None]], mechanism: Mechanism
                  ) -> list[str]:
    """Return which rows were left out, what for, and what they would change."""
    out = [f"  {r.dataset}, row {r.row}: {r.coordinate} {_of(r.value, r)}, where "
           + (f"its repeats say {_of(r.predicted, r)} ({number(r.times, 3)} times their scatter)."
              if r.repeats else
              f"the others say {_of(r.predicted, r)} (the whole row is off by {number(r.times, 3)} "
              "times the noise).")
           + _slack(r)
           for r in sorted(rows, key=lambda r: -(r.times or 0.0))[:SHOWN]]
    if len(rows) > SHOWN:
        out.append(f"  ... and {len(rows) - SHOWN} more rows, see residuals.csv.")
    out += slack_in_common(rows)
    return out + [f"  With them {name} would be {number(e.get('with_them'), 6)} in place of "
                  f"{number(e.get('now'), 6)} {parameter_unit(mechanism, name)}."
                  for name, e in list(would.items())[:CHANGED]]


def gross_rows(found: GrossErrors, mechanism: Mechanism) -> tuple[LeftOutRow, ...]:
    """Return the rows that were left out in file units."""
    return tuple(_left_out(r, mechanism) for r in found.rows)


def _left_out(error: GrossError, mechanism: Mechanism) -> LeftOutRow:
    unit = JOINT + error.joint if error.joint else (
        "length" if error.coordinate < 3 else "angle")
    return LeftOutRow.filled(error, MachineUnits.of(mechanism),
                             coordinate=error.number or POSE_COORDINATES[error.coordinate],
                             unit=unit, **({"may_be_slack": error.slack} if error.slack else {}),
                             **({"repeats": True} if error.joint else {}))


def _of(value: float | None, row: LeftOutRow) -> str:
    return f"{number(value, 6)} {row.unit}".rstrip()


def _slack(row: LeftOutRow) -> str:
    if not row.may_be_slack:
        return ""
    return f" It may be {' or '.join(row.may_be_slack)} that was slack."


def slack_in_common(left_out: Sequence[LeftOutRow]) -> list[str]:
    """Return which ropes may have been slack in all rows left out where one may have been.

    One contradiction a row has a sign, and no more: in many rows it leaves fewer ropes.
    """
    rows = [r.may_be_slack for r in left_out if r.may_be_slack]
    if len(rows) < 2:
        return []
    common = [name for name in rows[0] if all(name in r for r in rows)]
    every = len({n for r in rows for n in r}) == len(common)
    if not common:
        return [f"  In {len(rows)} of these rows ropes may have been slack, but no rope in all."]
    also = "" if every else ", and no other"
    return [f"  In all {len(rows)} rows where ropes may have been slack it may be "
            f"{' or '.join(common)}{also}. Of one contradiction a row the sign alone tells."]


SMOOTH = 0.01
"""A flat has a shape where chance would show one as strong this rarely."""
EXACT = 0.9995
"""A correlation that is written as 1."""


def pair_sentence(pair: CollinearParameters) -> str:
    """Return which two kinds of parameter act as one."""
    if not (math.isfinite(pair.correlation) and pair.one and pair.other):
        return ""
    how = "limb by limb" if pair.each else "all limbs alike"
    exactly = "exactly" if abs(pair.correlation) >= EXACT else "almost exactly"
    return (f"{pair.one} and {pair.other}, {how}, are {exactly} correlated (correlation "
            f"{pair.correlation:+.3f}); constrained by the prior.")


def strongest(found: Sequence[CollinearParameters]) -> list[CollinearParameters]:
    """Return pairs by their correlation, those last that a file does not say it of."""
    return sorted(found, key=lambda p: -abs(float(np.nan_to_num(p.correlation))))


def scale_sentence(scale: Scale) -> str:
    """Return how well a distance, file units, is known, and what to measure to know it better."""
    if not (scale.open and scale.length > 0.0):
        return ""
    unit, size = scale.unit, f"{scale.length:.4g} {scale.unit}"
    if not math.isfinite(scale.sigma):
        return (f"Scale is unobservable: nothing constrains the distance of {size} between "
                "the measured positions that lie farthest apart. Measure one distance.")
    needed, caliper = scale.needed, scale.measure_to
    if not (needed > 0.0 and caliper > 0.0):
        return ""
    text = (f"Scale: a distance of {size} is known to "
            f"+- {scale.times * scale.sigma:.3g} {unit} (95 %)")
    if scale.prior_dominated:
        left = (f"+- {scale.times * scale.sigma_data:.2g} {unit}"
                if scale.sigma_data < scale.length else "it open")
        text += f", constrained by the prior; the data alone leave {left}"
    if needed <= scale.length:
        return (f"{text}. One distance of at least {needed:.3g} {unit}, measured to "
                f"{caliper:.2g} {unit} (one sigma), would halve that.")
    return (f"{text}. That distance measured to {caliper * scale.length / needed:.2g} {unit} "
            "(one sigma) would halve it.")


def sets_of(found: Sequence[Unidentifiable], mechanism: Mechanism) -> tuple[Unidentifiable, ...]:
    """Return sets that say whose limbs' they are."""
    names = [limb.name for limb in mechanism.limbs]
    return tuple(replace(s, of_limbs=len(names), limbs=tuple(
        n for n in names if n in {slot.partition(".")[0] for slot in s.slots})) for s in found)


def _paths(found: Unidentifiable) -> dict[str, tuple[str, ...]]:
    """Return path within the limb -> the limbs that have it; nothing of what is not a limb's."""
    out: dict[str, tuple[str, ...]] = {}
    for slot in found.slots:
        limb, _, path = slot.partition(".")
        if limb in found.limbs:
            out[path] = (*out.get(path, ()), limb)
    return out


def _words(found: Unidentifiable) -> str:
    """Return the slots, those of all limbs as one."""
    shared: dict[tuple[str, ...], list[str]] = {}
    for path, limbs in _paths(found).items():
        shared.setdefault(limbs, []).append(path)
    each = [" and ".join(sorted(paths)) + " of " + (
                limbs[0] if len(limbs) == 1 else
                "all limbs" if len(limbs) == found.of_limbs else ", ".join(limbs))
            for limbs, paths in shared.items()]
    other = [s for s in found.slots if s.partition(".")[0] not in found.limbs]
    return ", ".join([*sorted(each), *sorted(other)])


def unidentifiable_words(found: Sequence[Unidentifiable]) -> str:
    """Return what cannot be told apart: ``6 of base.point of all limbs; ...``.

    Limbs that have the same are one.
    """
    alike: dict[tuple[object, ...], list[Unidentifiable]] = {}
    for one in found:
        key = tuple(sorted(_paths(one))) if len(one.limbs) == 1 and len(_paths(one)) == len(
            one.slots) else _words(one)
        alike.setdefault((key, one.combinations, one.unseen), []).append(one)
    out = []
    for (_, combinations, unseen), sets in alike.items():
        first = sets[0]
        limbs = [limb for s in sets for limb in s.limbs]
        words = _words(first) if len(sets) == 1 else (
            f"{' and '.join(sorted(_paths(first)))} of each of "
            f"{'the limbs' if len(limbs) == first.of_limbs else ', '.join(limbs)}")
        total = int(str(combinations)) * len(sets)
        out.append((-total, f"{total} of {words}{' (no effect at all)' if unseen else ''}"))
    return "; ".join(words for _, words in sorted(out))


def open_sentences(collinear: Sequence[CollinearParameters], scale: Scale | None) -> list[str]:
    """Return what a person should know before believing every digit; ``scale``: file units."""
    pairs = [s for p in strongest(collinear) if (s := pair_sentence(p))]
    return list(filter(None, [scale_sentence(scale) if scale else "",
                              *gathered_pairs(collinear, pairs)]))


def gathered_pairs(found: Sequence[CollinearParameters], each: Sequence[str]) -> list[str]:
    """Return the sentences of pairs, of many one with a count and the strongest."""
    if len(each) <= MOST:
        return list(each)
    names = abbreviate_list([f"{p.one} and {p.other}" for p in strongest(found)],
                            "identification.json, identifiability", joint="; ")
    return [f"{len(each)} pairs of kinds of parameter are correlated exactly or almost exactly: "
            f"{names}; constrained by the prior."]


def flat_sentences(found: Sequence[Flat]) -> Iterator[str]:
    """Yield which parts of the residuals of touches are smooth over the flat, beyond chance."""
    for f in found:
        if f.p_value < SMOOTH and f.dataset and math.isfinite(f.smooth + f.scatter):
            yield (f"{f.dataset}: {f.smooth:.2g} {f.unit} rms of what is left is smooth over the "
                   "flat: its own shape, or what the model misses; touches scatter "
                   f"{f.scatter:.2g} {f.unit} about it (p = {f.p_value:.1g}).")
