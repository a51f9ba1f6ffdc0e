"""``ppmcal compare``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from ppmcal.cli.common import (
    MODEL,
    Console,
    console_options,
    examples,
    finish,
    leave,
    out_option,
    plain_table,
)
from ppmcal.wording import number

if TYPE_CHECKING:
    from ppmcal.io.results.comparison import ComparisonRecord, ParameterDifference

SHOWN = 12


@click.command("compare", epilog=examples("ppmcal compare identified identified-may"))
@click.argument("old", type=MODEL)
@click.argument("new", type=MODEL)
@out_option("compared")
@console_options
def command(old: Path, new: Path, out: Path, console: Console) -> None:
    """Tell what changed between two calibrations OLD and NEW of one machine.

    Both are folders that identify wrote (or the identified.yaml in them), from different
    measurements. All parameters are judged together, with what was taken for known: homing, where
    bed, instrument and measured body were. The likeliest explanations of a change are named, and
    those that are as likely. If only one of the two had a parameter free, both are fitted to their
    measurements again with it free. Writes compare.csv and comparison.json.
    """
    from ppmcal.api.compare import compare

    result = compare(old, new)
    written = result.save(out)
    _show(result.record, console)
    console.warn(result.findings)
    finish(out, [p.name for p in written], console)
    console.summary(result.record.entries())
    leave(result.needs_a_look)


def _status(row: ParameterDifference) -> str:
    """Return by how much the named changes say that a parameter changed."""
    if row.status == "changed":
        return f"{row.explained:+.3g}" if row.explained else "yes"
    return "" if row.status == "unchanged" else row.status


def _show(record: ComparisonRecord, console: Console) -> None:
    """Print what a person wants to know."""
    if not console.speaks:
        return
    from ppmcal.io.results.comparison import (
        anew_sentence,
        apart_sentence,
        change_sentence,
        noise_sentence,
        platform_sentence,
        remainder_sentence,
        verdict_sentence,
    )

    console.say(verdict_sentence(record))
    for c in record.changes:
        console.say(change_sentence(c))
    for sentence in (remainder_sentence(record), apart_sentence(record), noise_sentence(record),
                     anew_sentence(record)):
        if sentence:
            console.say(sentence)
    if not record.parameters:
        return
    rows = sorted(record.parameters, key=lambda r: r.p_alone or 0.0)
    console.table(plain_table(
        ["parameter", "new", "new - old", "+- 95 %", "unit", "changed"],
        [[r.name, number(r.new, 6), f"{r.difference:+.3g}",
          number(r.wide or 0.0, 2), r.unit, _status(r)] for r in rows[:SHOWN]],
        (1, 2, 3)))
    if len(rows) > SHOWN:
        console.say(f"The {SHOWN} likeliest to have changed; all {len(rows)} in compare.csv.")
    if moved := platform_sentence(record):
        console.say(moved)
