"""What the console says of a diagnosis."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from ppmcal.diagnosis.hypotheses import SOME_FILES, Untestable
from ppmcal.diagnosis.result import Diagnosis
from ppmcal.io.results.campaign import campaign_sentences
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.diagnosis_parts import EffectValue
from ppmcal.io.results.diagnosis_wording import (
    actuators,
    another_day,
    confounded,
    gap_closed,
    learned,
    learned_gap,
    name_of,
    next_step,
    onset,
    own_values,
    predicted,
    probable,
    rivals,
    side,
    stages,
    together,
    tried_sets,
    unknown_causes,
    verdict,
)
from ppmcal.notes import topic_of
from ppmcal.wording import abbreviate_list, actuator_list, number, rate


def told(result: Diagnosis, record: DiagnosisRecord) -> Iterator[str]:
    """Yield what a person wants to know."""
    yield f"{record.name}: {verdict(record)}"
    yield "Disagreement with geometry alone: " + _where(result)
    yield stages(record)
    yield from (*effects(record), *another_day(record), *_suspected(result), *_left(result))
    yield from filter(None, (
        unknown_causes(record), tried_sets(record), gap_closed(record) if record.effects else "",
        predicted(record), confounded(record), *learned(record), learned_gap(record)))
    if record.not_testable:
        yield "Not testable: " + "; ".join(_lacking(record.not_testable)) + "."
    yield from campaign_sentences(record.campaign)
    yield f"Next: {next_step(record)}"


def _lacking(untestable: Sequence[Untestable]) -> list[str]:
    """Return ``compliance, windup (need payload)``: the kinds by what they lack, and where.

    Of a kind that lacks the same about the base, or in its products with travel, that once.
    """
    kinds: dict[tuple[tuple[str, ...], str], dict[str, None]] = {}
    for u in untestable:
        where = f", {u.reason}" if topic_of(u.reason) == SOME_FILES else ""
        kinds.setdefault((u.missing, where), {})[u.kind] = None
    for alike in kinds.values():
        for kind in [k for k in alike if " " in k and k.partition(" ")[0] in alike]:
            del alike[kind]
    return [f"{', '.join(some)} (need{'s' if len(some) == 1 else ''} "
            f"{', '.join(missing[:2])}{' ...' if len(missing) > 2 else ''}{where})"
            for (missing, where), some in kinds.items()]


def _where(result: Diagnosis) -> str:
    strong = [p for p in result.localised if p.by == "actuator" and p.p_value < 0.01]
    strong.sort(key=lambda p: -p.rms_ratio)
    text = f"residuals are {result.start.ratio:.2f} times the {result.start.source} noise"
    if strong:
        text += ", most at " + ", ".join(f"{p.value} ({p.rms_ratio:.1f} x)" for p in strong[:3])
    return text + "."


def effects(record: DiagnosisRecord) -> list[str]:
    """Return the named effects with their sizes, and what they cannot be told from."""
    out = []
    for group in together(record):
        on = list(dict.fromkeys(a for e in group for a in e.on))
        heads = ["" if list(e.on) == on else f"{actuator_list(e.on, actuators(record))} "
                 for e in group]
        chances = [probable(e.probability) for e in group]
        alone = [f" ({p})" if len(set(chances)) > 1 else "" for p in chances]
        sizes = own_values(record, group) or "; ".join(
            f"{head}{_event(onset(e))}{_values(e.parameters)}{p}"
            for head, e, p in zip(heads, group, alone, strict=True))
        out.append(f"{name_of(record, group[0].called, on)}: {sizes}"
                   + ("." if alone[0] else f"; {chances[0]}."))
        out += [f"  {head}{_values(e.derived)}"
                + (f" at mid-stroke ({number(at.value)} {at.unit})." if at else ".")
                for head, e in zip(heads, group, strict=True) if e.derived
                for at in [e.mid_stroke]]
        out += [f"  {line[0].upper() if line.startswith('the ') else line[0]}{line[1:]}"
                for line in side(group)]
        if others := rivals(record, group[0]):
            out.append(
                f"  Cannot be told from: {abbreviate_list(others, 'effects.csv', joint='; ')}.")
    return out


def _event(when: str) -> str:
    return f"{when}: " if when else ""


def _suspected(result: Diagnosis) -> list[str]:
    names = [f"{c.hypothesis.label} ({probable(c.probability)})"
             for c in sorted(result.suspected, key=lambda c: -c.probability)]
    return [f"Suspected: {abbreviate_list(names, 'effects.csv')}."] if names else []


def _left(result: Diagnosis) -> list[str]:
    """Return what is left, where that is more than noise."""
    left = result.remainder
    if left.adequate or result.unknown:
        return []
    return [f"What is left is {left.ratio:.2f} times the {left.source} noise."]


def _values(values: Mapping[str, EffectValue]) -> str:
    """Return ``width 0.02 +- 0.001 mm`` of all values that have an uncertainty."""
    return ", ".join(
        f"{name.removesuffix('_mid_stroke')} {number(v.value * f)} "
        f"+- {number(v.half * f, 2)} {unit}".rstrip()
        for name, v in values.items() if v.half is not None and v.value is not None
        for f, unit in [rate(v.unit, v.value)])
