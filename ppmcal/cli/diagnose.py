"""``ppmcal diagnose``."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ppmcal.cli.common import (
    FILE,
    Console,
    FiniteRange,
    command_line,
    finish,
    json_option,
    leave,
    load,
    number,
    out_option,
    quiet_option,
    seed_option,
    unit_findings_told,
)
from ppmcal.wording import counted, shorter

if TYPE_CHECKING:
    from ppmcal.diagnosis.held_out_blocks import BlockGap
    from ppmcal.diagnosis.hypotheses import Untestable
    from ppmcal.diagnosis.result import Diagnosis, NamedEffect


@click.command("diagnose")
@click.argument("mech", type=FILE)
@click.argument("data", type=FILE, nargs=-1, required=True)
@out_option("diagnosed")
@click.option("--free", "patterns", multiple=True, metavar="PATTERN",
              help="Geometry that the fit may change, in place of the file's choice; frozen slots "
              "are candidates.")
@click.option("--kind", "kinds", multiple=True, metavar="KIND",
              help="Try only these kinds of effect (may be repeated)  [default: all].")
@click.option("--holdout", type=FiniteRange(0.0, 0.9), default=0.27, show_default=True,
              help="Part of the poses that no fit sees, on which the gap is measured.")
@click.option("--draws", type=click.IntRange(200, 100000), default=2000, show_default=True,
              help="Simulated campaigns of noise behind the thresholds.")
@click.option("--png", is_flag=True,
              help="Write the pictures as PNG too (needs the extra 'plots').")
@seed_option
@quiet_option
@json_option
def command(mech: Path, data: tuple[Path, ...], out: Path, patterns: tuple[str, ...],
            kinds: tuple[str, ...], holdout: float, draws: int, png: bool, seed: int | None,
            quiet: bool, as_json: bool) -> None:
    """Find the physical effect that the model of MECH misses in the measurements DATA.

    Names it with its size, adds it to the model and shows on held-out poses how much of the
    gap is gone; or says that nothing is missing, what cannot be told apart and what to
    measure next. Writes model.yaml, effects.csv, residuals.csv, diagnosis.json and the
    pictures gap.svg, actuators.svg, inputs.svg, ranking.svg and, where effects cannot be told
    apart, alternatives.svg.
    """
    from dataclasses import replace

    from ppmcal.calibration.misreading import refuse_misread
    from ppmcal.calibration.problem import Problem
    from ppmcal.diagnosis.diagnose import DiagnosisOptions, diagnose
    from ppmcal.io import Output, provenance
    from ppmcal.io.output import plain
    from ppmcal.io.results.diagnosis import files, summary
    from ppmcal.report.figure_files import diagnosis_files, need_png

    console = Console(quiet, as_json)
    _known_kinds(kinds)
    if png:
        need_png()
    mechanism, datasets = load(mech, data, patterns)
    seed = 0 if seed is None else seed
    problem = Problem(mechanism, datasets, mechanism.free)
    with unit_findings_told(mechanism, datasets) as units, console.progress("Diagnosing") as show:
        show("comparing the measurements with the nominal machine")
        refuse_misread(problem)
        result = diagnose(problem, DiagnosisOptions(holdout, seed, draws, kinds or None), show)
    result = replace(result, findings=(*units, *result.findings))
    inputs = [*mechanism.inputs, *(str(t) for t in data),
              *(str(t.with_suffix(".yaml")) for t in data)]
    source = provenance(inputs, command_line(), seed)
    with Output(out) as output:
        record = summary(result, source)
        for name, text in files(result, source, record).items():
            output.add(name, text)
        for name, drawing in diagnosis_files(plain(record), png).items():
            output.add(name, drawing)
    tell(result, console)
    finish(out, list(output.files), console)
    console.summary(record)
    leave(bool(result.findings) or result.verdict not in ("none", "named"))


def _known_kinds(kinds: tuple[str, ...]) -> None:
    if kinds:
        from ppmcal.errors import unknown
        from ppmcal.model.effects import GEOMETRY, effect_kinds

        for kind in kinds:
            if kind != GEOMETRY and kind not in effect_kinds():
                raise unknown("effect", kind, [*effect_kinds(), GEOMETRY], "--kind")


def tell(result: Diagnosis, console: Console) -> None:
    """Print the story in a few lines."""
    if not console.speaks:
        return
    from ppmcal.report.diagnosis_wording import VERDICTS

    headline = VERDICTS[result.verdict]
    if result.verdict == "named" and len({e.kind for e in result.effects}) > 1:
        headline = "The missing effects are named."
    console.say(f"{result.identification.mechanism.name}: {headline}")
    console.say("Disagreement: " + _where(result))
    for line in _what(result):
        console.say(line)
    gap = result.gap
    if gap is not None and result.effects:
        closed = "nothing exceeded the noise before" if gap.closed is None else (
            f"{gap.closed:.0%} of the gap closed" + (
                f" ({gap.interval[0]:.0%} to {gap.interval[1]:.0%})" if gap.interval else ""))
        console.say(f"Held-out poses ({gap.poses}): {gap.before:.2f} -> {gap.after:.2f} times the "
                    f"noise, {closed}.")
    for line in _worst_block(result.blocks):
        console.say(line)
    if result.swallowed:
        worst = result.swallowed[0]
        console.say(f"Geometry had swallowed part of it: "
                    f"{counted(len(result.swallowed), 'parameter')} moved beyond tolerance, most "
                    f"{worst.name}.")
    if result.untestable:
        console.say("Not testable: " + "; ".join(_lacking(result.untestable)) + ".")
    console.say(f"Next: {result.proposal.reason}."
                + (" See next.csv." if result.proposal.rows else ""))
    console.warn(result.findings)


def _worst_block(blocks: Sequence[BlockGap]) -> list[str]:
    """Return how much of the gap is closed where that is least, a third being left out."""
    judged = [(b.gap.closed, b) for b in blocks if b.gap.closed is not None and b.gap.interval]
    if not judged:
        return []
    closed, worst = min(judged, key=lambda pair: pair[0])
    low, high = worst.gap.interval or (closed, closed)
    by = ", ".join(b.by for b in blocks)
    return [f"A third of the rows left out at a time, by {by}: {closed:.0%} of the gap closed "
            f"where that is least, by {worst.by} ({low:.0%} to {high:.0%})."]


def _lacking(untestable: Sequence[Untestable]) -> list[str]:
    """Return ``compliance, windup (need payload)``: the kinds by what they lack."""
    kinds: dict[tuple[str, ...], list[str]] = {}
    for u in untestable:
        kinds.setdefault(u.missing, []).append(u.kind)
    return [f"{', '.join(some)} (need{'s' if len(some) == 1 else ''} "
            f"{', '.join(missing[:2])}{' ...' if len(missing) > 2 else ''})"
            for missing, some in kinds.items()]


def _where(result: Diagnosis) -> str:
    strong = [p for p in result.localised if p.by == "actuator" and p.p_value < 0.01]
    strong.sort(key=lambda p: -p.rms_ratio)
    text = f"residuals are {result.start.ratio:.2f} times the {result.start.source} noise"
    if strong:
        text += ", most at " + ", ".join(f"{p.value} ({p.rms_ratio:.1f} x)" for p in strong[:3])
    return text + "."


def _what(result: Diagnosis) -> list[str]:
    total = len(result.identification.mechanism.actuators)
    out = []
    for group in _together(result.effects):
        first, several = group[0], len(group) > 1
        on = [a for e in group for a in e.on]
        name = shorter(f"{first.kind} on {', '.join(on)}" if on else first.kind, total)
        values = "; ".join((f"{e.on[0]} " if several else "") + _values(result, e) for e in group)
        out.append(f"{name}: {values}; p = {_p(first.log_p)}.")
        out += [text for e in group if (text := _derived(result, e, several))]
        if first.alternatives:
            others = "; ".join(shorter(a, total) for a in first.alternatives)
            out.append(f"  Cannot be told from: {others}.")
    out += [f"Suspected: {c.form.label} (p = {c.p_value:.1g})." for c in result.possible
            if c.status == "weak"]
    left = result.remainder
    if not left.adequate:
        follows = f" and follows {left.follows} (p = {left.p_value:.2g})" if (
            left.p_value < 0.05) else ""
        out.append(f"What is left is {left.ratio:.2f} times the {left.source} noise{follows}.")
    return out


def _together(effects: Sequence[NamedEffect]) -> list[list[NamedEffect]]:
    """Return the effects, those that are one hypothesis on several actuators in one list."""
    return [list(g) for _, g in groupby(effects, lambda e: (
        e.kind, e.log_p, e.alternatives, e.parameters if len(e.on) != 1 else ()))]


def _values(result: Diagnosis, effect: NamedEffect) -> str:
    from ppmcal.io.results.diagnosis import parameter_entries

    return ", ".join(_value(n, v) for n, v in parameter_entries(result, effect).items()
                     if v["sigma"] is not None)


def _derived(result: Diagnosis, effect: NamedEffect, several: bool) -> str:
    """Return ``  amplitude 0.02 +- 0.001 mm, phase 35 +- 3 deg at mid-stroke (250 mm).``."""
    from ppmcal.io.results.diagnosis import derived_entries

    found = derived_entries(result, effect)
    if not found:
        return ""
    figures = ", ".join(_value(n.removesuffix("_mid_stroke"), v)
                        for n, v in found["derived"].items() if v["sigma"] is not None)
    at = found["mid_stroke"]
    on = f"{effect.on[0]} " if several else ""
    return (f"  {on}{figures} at mid-stroke ({number(at['value'])} {at['unit']}).")


def _value(name: str, entry: dict[str, Any]) -> str:
    return (f"{name} {number(entry['value'])} +- {number(1.96 * entry['sigma'], 2)} "
            f"{entry['unit']}").rstrip()


def _p(log_p: float) -> str:
    import math

    power = log_p / math.log(10.0)
    return f"1e{power:.0f}" if power < -3.0 else f"{10.0**power:.2g}"
