"""A diagnosis in sentences: what the console and the report both say stands here once.

At the end: how well it predicts what its fits were not made from.
"""

from __future__ import annotations

from collections.abc import Sequence

from ppmcal.diagnosis.left_out_schemes import SESSION
from ppmcal.diagnosis.result import LeftOutBlocks
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.diagnosis_parts import DiagnosedEffect, HeldOutGap
from ppmcal.model.effects import GEOMETRY, effect_kinds
from ppmcal.wording import (
    actuator_list,
    causes,
    known,
    number,
    percent,
    pluralize,
    rate,
    shorten_label,
)

VERDICTS = {
    "misread": "The measurements were read wrongly; nothing was diagnosed.",
    "none": "No missing effect is detectable in {data}.",
    "weak": "Something may be missing, but it is too weak to be named.",
    "named": "The missing effect is named.",
    "named-set": "Something is missing; {data} cannot tell a few effects apart.",
    "partial": "Part of what is missing is named; something else is left.",
    "unnamed": "Something is missing that ppmcal does not know.",
}
SHORT = 100
"""A list of rivals with more letters is shortened in a headline; the page has all."""
Group = Sequence[DiagnosedEffect]


def verdict(record: DiagnosisRecord) -> str:
    """Return the verdict as a sentence, empty where there is none."""
    unknown = f"Verdict: {record.verdict}." if record.verdict else ""
    several = record.verdict == "named" and len(together(record)) > 1
    text = "The missing effects are named." if several else VERDICTS.get(record.verdict, unknown)
    said = text.format(data="the other data" if record.unused else "these data")
    return " ".join([*(f"{sentence}." for sentence in record.unused), said]).strip()


def headline(record: DiagnosisRecord) -> str:
    """Return the verdict and what was named."""
    groups, text = together(record), verdict(record)
    names = [group_name(record, g) for g in groups]
    if not names:
        return text
    if record.verdict == "named":
        return f"{text.removesuffix('.')}: {'; '.join(names)}."
    if record.verdict == "named-set":
        return f"{text.removesuffix('.')}: {_apart(record, groups, names)}."
    return f"{text} Named: {'; '.join(names)}."


def _apart(record: DiagnosisRecord, groups: Sequence[Group], names: Sequence[str]) -> str:
    """Return what cannot be told apart: of short names each, else the causes without the joints."""
    rival = [[n, *rivals(record, g[0])] for n, g in zip(names, groups, strict=True)]
    rival = [own for own in rival if len(own) > 1] or rival
    whole = "; ".join(" or ".join(own) for own in rival)
    if len(whole) <= SHORT:
        return whole
    return "; ".join(" or ".join(dict.fromkeys(map(causes, own))) for own in rival)


def lead(record: DiagnosisRecord) -> str:
    """Return the machine, the verdict, what was named, and the error at each stage."""
    first = f"{record.name}, diagnosed: " if record.name else ""
    text = headline(record)
    if not text:
        return ""
    sizes = record.residual.sizes(bool(record.effects or record.learned))
    return f"{first}{text[0].lower() if first else text[0]}{text[1:]} {sizes}".strip()


def together(record: DiagnosisRecord) -> list[Group]:
    """Return the named effects, those of one kind and with the same alternatives as one group.

    Of geometry only those of the same parameters are together.
    """
    groups: dict[tuple[str, ...], list[DiagnosedEffect]] = {}
    for e in record.effects:
        key = (e.called, *_geometry(e), "|", *e.alternatives_on)
        groups.setdefault(key, []).append(e)
    return list(groups.values())


def rivals(record: DiagnosisRecord, effect: DiagnosedEffect) -> list[str]:
    """Return the names of an effect's alternatives."""
    return [shorten_label(name, actuators(record))
            for name in effect.alternatives_on or effect.alternatives]


def group_name(record: DiagnosisRecord, group: Group) -> str:
    """Return ``backlash on leg2, leg5`` for effects that are reported as one."""
    on = dict.fromkeys(a for e in group for a in e.on)
    return name_of(record, " ".join([group[0].called, *_geometry(group[0])]), list(on))


def stages(record: DiagnosisRecord) -> str:
    """Return the rms error of the nominal machine, of geometry alone and with what was found."""
    return record.residual.sentence(bool(record.effects or record.learned))


FEW = 2
"""So many values of one effect are given one by one."""


def own_values(group: Group) -> str:
    """Return in one line the values of one effect on more than a few actuators, each its own.

    ``expansion 1.1e-06 to 2.3e-05 1/K (leg1 1.1e-06, leg2 ...; +- 4e-07 at most)``; empty where
    they are few, or not of one hypothesis.
    """
    names = [n for n, v in group[0].parameters.items() if v.sigma is not None]
    if len(group) <= FEW or len({e.probability for e in group}) > 1 or any(
            len(e.on) != 1 or set(e.parameters) != set(group[0].parameters) for e in group):
        return ""
    return ", ".join(_own(group, n) for n in names)


def _own(group: Group, name: str) -> str:
    """Return the range of one parameter, and all its values."""
    values = [e.parameters[name] for e in group]
    factor, unit = rate(values[0].unit, max((abs(v.value) for v in values if v.value is not None),
                                            default=0.0))
    values = [v if factor == 1.0 else v.changed(**{
        k: None if size is None else factor * size
        for k in ("value", "sigma", "low", "high") for size in [getattr(v, k)]}) for v in values]
    known = [v.value for v in values if v.value is not None]
    widest = max((v.half for v in values if v.half is not None), default=None)
    each = ", ".join(f"{e.on[0]} {number(v.value)}" for e, v in zip(group, values, strict=True))
    if not known:
        return f"{name}: {each}"
    unit = f" {unit}".rstrip()
    low, high = (number(end(known), 3) for end in (min, max))
    if low == high:
        low, high = (number(end(known)) for end in (min, max))
    return (f"{name} {low} to {high}{unit} ({each}; "
            f"+- {number(widest, 2)} at most)")


def onset(effect: DiagnosedEffect) -> str:
    """Return ``from row 76 of day2 on (95 %: 60 to 77)`` of an event, else nothing."""
    if effect.row is None:
        return ""
    row = effect.row
    sure = f" (95 %: {row.low} to {row.high})" if row.low < row.high else ""
    return f"from row {row.row}{f' of {row.dataset}' if row.dataset else ''} on{sure}"


def side(group: Group) -> list[str]:
    """Return where the encoders of effects that are reported as one sit, from the values' signs.

    ``leg2: the joint lags its reading: its encoder sits before the play``, without the joint where
    all are alike; empty where an effect has no such sides.
    """
    on: dict[str, list[str]] = {}
    for effect in group:
        if effect.side:
            on.setdefault(effect.side, []).extend(effect.on)
    kind = effect_kinds().get(group[0].kind)
    if kind is None or kind.reversal is None:
        return []
    what = kind.reversal.what
    place = {"lags": f"before the {what}", "leads": f"behind the {what}"}
    other = ", or dir_ tells the side it came from" if "dir" in kind.needs else ""
    return [(f"{', '.join(joints)}: " if len(on) > 1 else "")
            + f"the joint {way} its reading: its encoder sits {place[way]}"
            + (other if way == "leads" else "") + "."
            for way, joints in on.items() if way in place]


def effect_name(record: DiagnosisRecord, effect: DiagnosedEffect) -> str:
    """Return ``backlash on leg2``; geometry with the names of its parameters."""
    return group_name(record, [effect])


def name_of(record: DiagnosisRecord, kind: str, on: Sequence[str]) -> str:
    """Return ``backlash on leg2, leg5`` or ``gain on all 6 actuators``."""
    place = actuator_list(on, actuators(record))
    return f"{kind or '?'} on {place}" if place else kind or "?"


def _geometry(effect: DiagnosedEffect) -> list[str]:
    return list(effect.parameters) if effect.kind == GEOMETRY else []


def actuators(record: DiagnosisRecord) -> int:
    """Return the number of actuators, 0 where the record does not say."""
    return len(record.plot_data.actuators)


LIKELY, FEW_SETS = 0.01, 4
"""Sets of effects that are reported have at least this probability; so many are reported."""


def unknown_causes(record: DiagnosisRecord) -> str:
    """Return what is there without a name, empty where nothing is."""
    each = [" or ".join(f"{name} ({probable(p)})" for name, p in zip(
        (u.looks_like, *u.alternatives), (u.probability, *u.probabilities), strict=False))
        for u in record.unknown]
    return f"Without a name: {'; '.join(each)}." if each else ""


def probable(probability: float | None) -> str:
    """Return ``probability 0.97``, never one of 1."""
    p = known(probability)
    if p is None:
        return ""
    return "probability above 0.999" if p > 0.999 else f"probability {max(p, 0.001):.3g}"


def cause_probability(record: DiagnosisRecord) -> str:
    """Return how probable what is named is, of all that may be there instead; else empty."""
    each = [s.probability for s in record.sets[:1]] or [e.probability for e in record.effects]
    told = [p for v in each if (p := known(v)) is not None]
    what = "cause has" if len(together(record)) == 1 else "causes have"
    return f"the named {what} {probable(min(told))}" if told and record.effects else ""


def tried_sets(record: DiagnosisRecord) -> str:
    """Return the explanations that compete, likeliest first; empty where one is likely."""
    each = sorted(((p, s) for s in record.sets if (p := known(s.probability)) is not None),
                  key=lambda pair: -pair[0])
    told = [(p, s) for p, s in each if p >= LIKELY][:FEW_SETS]
    if not told:
        return ""
    total = actuators(record)
    common = [e for e in told[0][1].effects if all(e in s.effects for _, s in told)]
    beside = f" beside {', '.join(shorten_label(e, total) for e in common)}" if common else ""
    named = dict[str, float]()      # of the same joints, alike or each its own size
    for p, s in told:
        name = ", ".join(shorten_label(e, total) for e in s.effects
                         if e not in common) or "nothing more"
        named[name] = named.get(name, 0.0) + p
    if len(named) < 2:
        return ""
    return (f"{len(named)} explanations{beside}: " + "; ".join(
        f"({n}) {name}, {percent(p)}" for n, (name, p) in enumerate(named.items(), 1)) + ".")


def learned(record: DiagnosisRecord) -> list[str]:
    """Return a sentence for each shape that was learned."""
    return [e.sentence(actuators(record)) for e in record.learned]


def confounded(record: DiagnosisRecord) -> str:
    """Return how many parameters had moved to imitate what is missing, empty where none had.

    By more than their tolerance from where they are with it: they need not have left that range.
    """
    moved = record.absorbed_by_geometry
    return "" if not moved else (
        f"Without what is named, {pluralize(len(moved), 'parameter')} moved by more than "
        f"{'their' if len(moved) > 1 else 'its'} tolerance to imitate it, most {moved[0].name}.")


def next_step(record: DiagnosisRecord) -> str:
    """Return what to measure next, and what that should settle; empty where it is not said."""
    reason = record.next_reason.rstrip(".")
    out = [f"{reason}."] if reason else []
    if record.next_file:
        much = f" ({pluralize(record.next_rows, 'row')})" if record.next_rows else ""
        out.append(f"They are in {record.next_file}{much}.")
        before, after = known(record.odds_before), known(record.odds_after)
        if before and after and (before, after) != (1.0, 1.0):  # else there are no two
            lead = max(before, 1.0 / before)
            out.append(f"The likelier of the two is ahead by odds of {_odds(lead)} to 1 now. With "
                       "these rows the true one, even if it is the other, should be ahead by "
                       f"{_odds(after)} to 1 or more.")
    return " ".join(out)


def _odds(odds: float) -> str:
    if odds >= 1e6:
        return "over a million"
    return f"{odds:.2g}" if odds < 100.0 else f"{float(f'{odds:.1e}'):.0f}"


def gap_closed(record: DiagnosisRecord) -> str:
    """Return how much of the gap is closed on held-out poses, empty where that is unknown."""
    gap = record.gap
    before, after = known(gap.before), known(gap.after)
    if before is None or after is None:
        return ""
    if not record.effects and abs(before - after) < 1e-9:
        return f"On {left_out_poses(gap)}, residuals are {_ratio(before)} times the noise."
    text = (f"On {left_out_poses(gap)} (though used to choose the names), residuals "
            f"{'drop' if after <= before else 'rise'} from {_ratio(before)} to {_ratio(after)} "
            "times the noise")
    closed = known(gap.closed)
    if closed is None:
        return f"{text}; nothing exceeded the noise before."
    return f"{text}: {percent(closed)} of the excess error is explained{_interval(gap)}."


def predicted(record: DiagnosisRecord) -> str:
    """Return how rows left out are predicted, empty where geometry is all that is likely."""
    told = [b for b in record.predictive if b.gain_sigma > 0.0]
    if not told:
        return ""
    first, least = told[0], min(told, key=lambda b: b.gain)
    text = (f"Cross-validation error, {_portion(first.by)} left out at a time: "
            f"{_ratio(first.averaged.error)} times the noise with all likely effects, "
            f"{_ratio(first.geometry.error)} with geometry alone; log score {_gain(first)}")
    return text + (f", by {least.by} {_gain(least)}" if least is not first else "") + "."


def left_out_error(record: DiagnosisRecord) -> str:
    """Return how well rows are predicted that were left out, empty where that is not known."""
    now, then = known(record.gap.after), known(record.gap.before)
    where = f"error on {left_out_poses(record.gap)}"
    if record.predictive:
        found = record.predictive[0]
        now, then = known(found.averaged.error), known(found.geometry.error)
        where = f"cross-validation error ({_portion(found.by)} left out at a time)"
    if now is None:
        return ""
    alone = "" if then is None or then == now else f", {_ratio(then)} with geometry alone"
    return f"{where} {_ratio(now)} times the noise{alone}"


def another_day(record: DiagnosisRecord) -> list[str]:
    """Return how each session is predicted from the others, or that none shows what is named."""
    if record.effects and not record.validation:
        return ["No second session here shows whether this holds on another day: measure one "
                "(ppmcal validate)."]
    return [f"From the other sessions, {day.prediction()}" for day in record.validation]


def _portion(by: str) -> str:
    return f"one {by}" if by in ("pose", SESSION) else f"a third of the rows by {by}"


def _gain(found: LeftOutBlocks) -> str:
    return f"{found.gain:+.1f} +- {found.gain_sigma:.1f}"


def left_out_poses(gap: HeldOutGap) -> str:
    """Return ``16 poses kept out of the fits``: those that sizes were not fitted to.

    What is named, or learned, was chosen with their help, so they are not called unseen.
    """
    return f"{gap.poses or ''} poses kept out of the fits".strip()


def learned_gap(record: DiagnosisRecord) -> str:
    """Return what held-out poses say of all that was learned, empty where nothing was."""
    if not record.learned:
        return ""
    gap = record.learned[0].gap
    before, after, closed = (known(v) for v in (gap.before, gap.after, gap.closed))
    if before is None or after is None:
        return ""
    tail = "" if closed is None else f": {percent(closed)} of the excess error is explained"
    return (f"With what was learned, residuals on {left_out_poses(gap)} (though used to choose "
            f"what is kept) go from {_ratio(before)} to {_ratio(after)} times the noise"
            f"{tail}{_interval(gap)}.")


def unconfirmed(record: DiagnosisRecord) -> str:
    """Return that what was left out of the fits does not bear the effects out."""
    return ("Sessions left out of the fits in turn do not bear the effects out."
            if record.validation else "The held-out poses alone do not prove the improvement.")


def _interval(gap: HeldOutGap) -> str:
    ends = [end for v in gap.interval or () if (end := known(v)) is not None]
    return (f" (95 % interval: {percent(ends[0])} to {percent(ends[1])})" if len(ends) == 2
            else "")


def _ratio(value: float) -> str:
    """Return three digits: ``0.940``, ``3.10``, ``21.9``."""
    return f"{value:#.3g}".rstrip(".")
