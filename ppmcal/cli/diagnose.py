"""``ppmcal diagnose``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ppmcal.cli import completion
from ppmcal.cli.common import (
    FILE,
    MODEL,
    Console,
    FiniteRange,
    console_options,
    examples,
    finish,
    leave,
    leave_out_option,
    out_option,
    refuse_two_holdouts,
    seed_option,
)
from ppmcal.wording import number, rate, some, where

if TYPE_CHECKING:
    from ppmcal.calibration.interpretation import Misread
    from ppmcal.diagnosis.hypotheses import Untestable
    from ppmcal.diagnosis.result import Diagnosis
    from ppmcal.io.results.diagnosis import DiagnosisRecord
    from ppmcal.io.results.diagnosis_parts import EffectValue


def _priors(ctx: click.Context, _: click.Parameter, asked: bool) -> None:
    """Print the numbers that decide, and leave."""
    if not asked or ctx.resilient_parsing:
        return
    import textwrap

    from ppmcal.inference.priors import CORRELATIONS, table

    several = ", ".join(f"{c:g}" for c in CORRELATIONS)
    for name, value, reason in (
            *((name, f"{p.value:.4g}", p.reason) for name, p in table().items()),
            ("correlations", several, "noise from row to row may have, each as often")):
        click.echo(f"{name.lower().replace('_', ' ')}: {value}")
        click.echo(textwrap.indent(textwrap.fill(reason, 74), "    "))
    ctx.exit()


@click.command("diagnose", epilog=examples("ppmcal diagnose mine.yaml run2.csv"))
@click.argument("mech", type=MODEL)
@click.argument("data", type=FILE, nargs=-1, required=True)
@out_option("diagnosed")
@click.option("--free", "patterns", multiple=True, metavar="PATTERN",
              shell_complete=completion.parameters,
              help="Geometry that the fit may change, in place of the file's choice; frozen slots "
              "are candidates.")
@click.option("--kind", "kinds", multiple=True, metavar="KIND",
              shell_complete=completion.effects,
              help="Try only these kinds of effect (may be repeated)  [default: all].")
@click.option("--holdout", type=FiniteRange(0.0, 0.9), default=0.27, show_default=True,
              help="Part of the poses that no fit sees, on which the gap is measured.")
@leave_out_option
@click.option("--png", is_flag=True, help="Write the pictures as PNG too.")
@click.option("--priors", is_flag=True, is_eager=True, expose_value=False, callback=_priors,
              help="Print every number that decides what is in the data, and its reason.")
@seed_option
@console_options
def command(mech: Path, data: tuple[Path, ...], out: Path, patterns: tuple[str, ...],
            kinds: tuple[str, ...], holdout: float, leave_out: str | None, png: bool,
            seed: int | None, console: Console) -> None:
    """Find the physical effect that the model of MECH misses in the measurements DATA.

    Names what is probable with its size, adds it to the model and shows on held-out poses how
    much of the gap is gone; or says that nothing is missing, what has no name, what cannot be
    told apart and what to measure next. Writes model.yaml, effects.csv, residuals.csv,
    diagnosis.json and the pictures gap.svg, actuators.svg, inputs.svg and, where effects cannot
    be told apart, alternatives.svg. What is left of an unnamed or partly named
    disagreement is learned as smooth functions, if poses left out of the fits confirm them:
    terms.svg.
    """
    from ppmcal.api.diagnose import diagnose
    from ppmcal.calibration.interpretation import Misread

    refuse_two_holdouts(leave_out)
    try:
        result = diagnose(mech, data, free=patterns, kinds=kinds, holdout=holdout,
                          leave_out=leave_out or "", seed=seed or 0, png=png)
    except Misread as refused:
        _write_misread(refused, mech, data, out, seed or 0, console)
        raise
    written = result.save(out)
    describe(result.diagnosis, result.record, console)
    finish(out, [p.name for p in written], console)
    console.summary(result.record.entries())
    leave(result.needs_a_look)


def _write_misread(refused: Misread, mech: Path, data: Sequence[Path], out: Path, seed: int,
                   console: Console) -> None:
    """Write diagnosis.json with how the files are to be read, where that is known."""
    from ppmcal.api.diagnose import save_misread

    record = save_misread(refused, mech, data, out, seed)
    if record is not None:
        finish(out, [record.FILE], console)
        console.summary(record.entries())


def describe(result: Diagnosis, record: DiagnosisRecord, console: Console) -> None:
    """Print what a person wants to know."""
    if not console.speaks:
        return
    from ppmcal.io.results.campaign import campaign_sentences
    from ppmcal.io.results.diagnosis_wording import (
        another_day,
        gap_closed,
        imitated,
        learned,
        learned_gap,
        next_step,
        predicted,
        stages,
        tried_sets,
        unknown_causes,
        verdict,
    )

    console.say(f"{record.name}: {verdict(record)}")
    console.say("Disagreement with geometry alone: " + _where(result))
    console.say(stages(record))
    for line in [*_effects(record), *another_day(record), *_suspected(result), *_left(result)]:
        console.say(line)
    for line in (unknown_causes(record), tried_sets(record),
                 gap_closed(record) if record.effects else "",
                 predicted(record),
                 imitated(record), *learned(record), learned_gap(record)):
        if line:
            console.say(line)
    if record.not_testable:
        console.say("Not testable: " + "; ".join(_lacking(record.not_testable)) + ".")
    for line in campaign_sentences(record.campaign):
        console.say(line)
    console.say(f"Next: {next_step(record)}")
    console.warn(record.findings)


def _lacking(untestable: Sequence[Untestable]) -> list[str]:
    """Return ``compliance, windup (need payload)``: the kinds by what they lack, and where."""
    kinds: dict[tuple[tuple[str, ...], str], list[str]] = {}
    for u in untestable:
        where = f", {u.reason}" if u.reason.startswith("not recorded in ") else ""
        kinds.setdefault((u.missing, where), []).append(u.kind)
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


def _effects(record: DiagnosisRecord) -> list[str]:
    """Return the named effects with their sizes, and what they cannot be told from."""
    from ppmcal.io.results.diagnosis_wording import (
        actuators,
        name_of,
        onset,
        own_values,
        probable,
        rivals,
        side,
        together,
    )

    out = []
    for group in together(record):
        on = list(dict.fromkeys(a for e in group for a in e.on))
        heads = ["" if list(e.on) == on else f"{where(e.on, actuators(record))} " for e in group]
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
            out.append(f"  Cannot be told from: {some(others, 'effects.csv', joint='; ')}.")
    return out


def _event(when: str) -> str:
    return f"{when}: " if when else ""


def _suspected(result: Diagnosis) -> list[str]:
    from ppmcal.io.results.diagnosis_wording import probable

    names = [f"{c.hypothesis.label} ({probable(c.probability)})"
             for c in sorted(result.possible, key=lambda c: -c.probability)]
    return [f"Suspected: {some(names, 'effects.csv')}."] if names else []


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
