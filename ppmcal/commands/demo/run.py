"""The main job once, on the data that come with the program."""

from __future__ import annotations

from pathlib import Path

from ppmcal.commands.demo.options import DemoArguments
from ppmcal.commands.spec import Script, Step
from ppmcal.io.templates import sample_data
from ppmcal.store.output import Output


def run(asked: DemoArguments) -> Script:
    """Return the command lines of the job, which write into folders within one."""
    out = Path(asked.out)
    with Output(out):
        pass    # the folder is the demo's own from now on
    page = out / "report" / "report.html"
    return Script(tuple(_steps(out, sample_data())),
                  f"Done. Results are in {out}; open {page} in a browser.",
                  {"out": str(out), "report": str(page)})


def _steps(out: Path, folder: Path) -> list[Step]:
    mech, data = folder / "hexapod.yaml", folder / "measurements.csv"
    model = out / "identified" / "identified.yaml"
    return [Step(question, tuple(map(str, words))) for question, *words in (
        ("Is the file the machine that it should be, and can the tracker see its parameters?",
         "check", mech, data),
        ("What are the machine's true dimensions?",
         "identify", mech, data, "--out", out / "identified"),
        ("What must be sent so that the machine goes where it is wanted?",
         "compensate", model, folder / "targets.csv", "--out", out / "compensated"),
        ("Later it is wrong again. What does the model miss? (Three effects are hidden.)",
         "diagnose", mech, folder / "hidden" / "measurements.csv", "--out", out / "diagnosed"),
        ("Joint values of some platform poses, with the identified machine.",
         "kinematics", "inverse", model, folder / "poses.csv", "--out", out / "kinematics"),
        ("And how would such measurements be simulated?",
         "simulate", mech, folder / "scenario.yaml", "--out", out / "simulated"),
        ("Which error of the geometry does most to the tool, and where?",
         "sensitivity", mech, "--grid", "x=-20:20:25,y=-20:20:25", "--out", out / "sensitivity"),
        ("Which twenty poses would that tracker tell the geometry by best?",
         "plan", mech, "--count", "20", "--instrument", data.with_suffix(".yaml"), "--out",
         out / "plan"),
        ("Everything on one page.",
         "report", out / "identified", out / "diagnosed", out / "compensated",
         out / "kinematics", out / "simulated", out / "sensitivity", out / "plan", "--out",
         out / "report"))]
