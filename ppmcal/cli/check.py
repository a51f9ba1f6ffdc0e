"""``ppmcal check``."""

from __future__ import annotations

from pathlib import Path

import click

from ppmcal.cli.common import (
    FILE,
    MODEL,
    Console,
    console_options,
    examples,
    leave,
    plain_table,
    single_files,
)
from ppmcal.errors import BadInput
from ppmcal.wording import number


@click.command("check", epilog=examples(
    "ppmcal check mine.yaml --draw machine.html", "ppmcal check mine.yaml run1.csv"))
@click.argument("mech", type=MODEL)
@click.argument("data", type=FILE, nargs=-1)
@click.option("--draw", type=FILE, default=None, metavar="PATH",
              help="Draw the machine to scale, as an HTML page to turn and move, offline.")
@console_options
@single_files
def command(mech: Path, data: tuple[Path, ...], draw: Path | None, console: Console) -> None:
    """Check MECH: schema, closure and singularity at home, units, what DATA can see."""
    from ppmcal.api.check import CheckResult, check
    from ppmcal.api.inputs import prepared
    from ppmcal.io.results.identifiability import (
        IdentifiabilitySummary,
        UnidentifiableSet,
        unidentifiable_words,
    )
    from ppmcal.io.results.misreading import misreading_entries

    mechanism, datasets = prepared(mech, data, needed=False)
    try:
        result = check(mechanism, datasets)
    except BadInput:
        if draw is not None:    # what cannot be checked can still be looked at
            shown = CheckResult.of_machine(mechanism, datasets).draw(draw)
            console.say(f"The machine, drawn as far as it goes: {shown}")
        raise
    drawn = None if draw is None else result.draw(draw)
    factor, unit = mechanism.units.factor("length"), mechanism.units.length
    console.say(f"{mechanism.name}: {mechanism.motion}, {len(mechanism.limbs)} limbs "
                f"({', '.join(dict.fromkeys(limb.kind.name for limb in mechanism.limbs))}), "
                f"{len(mechanism.actuators)} actuators, {len(mechanism.free)} free parameters.")
    rows = [[name, number(q / f, 7), u or "units"] for name, q, (f, u) in
            zip(mechanism.actuators, result.q_home, mechanism.joint_units, strict=True)]
    console.table(plain_table(["joint", "at home", "unit"], rows, (1,)))
    if result.gaps:
        console.table(plain_table(
            ["limb", "gap at home", "allowed", "unit"],
            [[g.limb, number(g.gap / factor), number(g.allowed / factor, 2), unit]
             for g in result.gaps], (1, 2)))
    console.say(f"Smallest singular value at home: {result.singular_value:.3g} (rotation against "
                f"{mechanism.length_scale / factor:.4g} {unit}).")
    if result.columns:
        seen = "the measurements" if datasets else "full-pose measurements about home"
        console.say(f"Rank with {seen}: {result.rank} of {result.columns}.")
    sets = [UnidentifiableSet.of(s, mechanism) for s in result.unidentifiable]
    if sets:
        console.say(f"{sum(s.combinations for s in sets)} redundant: combinations that cannot be "
                    f"identified: {unidentifiable_words(sets)}.")
    identifiability = None if result.identifiability is None else IdentifiabilitySummary.of(
        result.identifiability, mechanism)
    open_ = identifiability.sentences() if identifiability else []
    for sentence in open_:
        console.say(sentence)
    console.warn(result.findings)
    if not (result.findings or result.unseen or open_):
        console.say("No findings.")
    if drawn is not None:
        console.say(f"The machine, drawn: {drawn}")
    console.summary(
        {
            "format": "ppmcal/check/1",
            "name": mechanism.name,
            "findings": list(result.findings),
            "gaps": [
                {
                    "limb": g.limb,
                    "gap": g.gap / factor,
                    "allowed": g.allowed / factor,
                    "unit": unit,
                    "open": g.open,
                }
                for g in result.gaps
            ],
            "condition": result.singular_value,
            "rank": result.rank,
            "columns": result.columns,
            "unseen": list(result.unseen),
            "redundant": list(result.redundant),
            "unidentifiable": [s.entries(whole=True) for s in sets],
            "identifiability": None if identifiability is None else
            identifiability.entries(),
            "misreadings": [m.entries(whole=True) for m in
                            misreading_entries(result.misreadings, mechanism.units)],
            **({} if drawn is None else {"drawing": str(drawn)}),
        }
    )
    leave(bool(result.findings))
