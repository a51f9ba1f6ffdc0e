"""``ppmcal demo``."""

from __future__ import annotations

import importlib
from pathlib import Path

import click

from ppmcal.cli.common import Console, console_options, examples, out_option
from ppmcal.wording.progress import stage


@click.command("demo", epilog=examples("ppmcal demo --out demo-results"))
@out_option("demo-results")
@console_options
def command(out: Path, console: Console) -> None:
    """Run the main job once on the sample data: a table-top hexapod seen by a tracker.

    Check, identify, compensate, diagnose, inverse kinematics, simulation, sensitivity and a
    plan of measurements, one report.
    """
    from ppmcal.io import Output
    from ppmcal.io.templates import sample_data

    with Output(out):
        pass    # the folder is the demo's own from now on
    folder = sample_data()
    mech, data = folder / "hexapod.yaml", folder / "measurements.csv"
    model = out / "identified" / "identified.yaml"
    steps = [
        ("Is the file the machine that it should be, and can the tracker see its parameters?",
         ["check", mech, data]),
        ("What are the machine's true dimensions?",
         ["identify", mech, data, "--out", out / "identified"]),
        ("What must be sent so that the machine goes where it is wanted?",
         ["compensate", model, folder / "targets.csv", "--out", out / "compensated"]),
        ("Later it is wrong again. What does the model miss? (Three effects are hidden.)",
         ["diagnose", mech, folder / "hidden" / "measurements.csv", "--out",
          out / "diagnosed"]),
        ("Joint values of some platform poses, with the identified machine.",
         ["kinematics", "inverse", model, folder / "poses.csv", "--out", out / "kinematics"]),
        ("And how would such measurements be simulated?",
         ["simulate", mech, folder / "scenario.yaml", "--out", out / "simulated"]),
        ("Which error of the geometry does most to the tool, and where?",
         ["sensitivity", mech, "--grid", "x=-20:20:25,y=-20:20:25", "--out",
          out / "sensitivity"]),
        ("Which twenty poses would that tracker tell the geometry by best?",
         ["plan", mech, "--count", "20", "--instrument", data.with_suffix(".yaml"), "--out",
          out / "plan"]),
        ("Everything on one page.",
         ["report", out / "identified", out / "diagnosed", out / "compensated",
          out / "kinematics", out / "simulated", out / "sensitivity", out / "plan", "--out",
          out / "report"]),
    ]
    codes = {}
    replace = click.get_current_context().params["force"]
    for number, (question, step) in enumerate(steps, 1):
        words = [str(w) for w in step]
        if replace and "--out" in step:
            words.append("--overwrite" if step[0] == "compensate" else "--force")
        console.say(f"\n[{number}/{len(steps)}] {question}")
        console.say(f"$ ppmcal {' '.join(words)}\n")
        with stage(words[0]):
            codes[words[0]] = _run(words, console.speaks)
    page = out / "report" / "report.html"
    console.say(f"\nDone. Results are in {out}; open {page} in a browser.")
    console.summary({"out": str(out), "report": str(page), "exit_codes": codes})


def _run(words: list[str], speaks: bool) -> int:
    """Run one command in this process; its findings (exit code 1) do not stop the demo."""
    part = importlib.import_module(f"ppmcal.cli.{words[0]}").command
    arguments = words[1:] if speaks else [*words[1:], "--quiet"]
    code = part.main(args=arguments, prog_name=f"ppmcal {words[0]}", standalone_mode=False)
    return code if isinstance(code, int) else 0
