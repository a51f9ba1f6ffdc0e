"""The commands end to end, on a small machine, with one of their files changed."""

import functools
import json
import shutil
import tempfile
import time
from pathlib import Path

from helpers.commands import ppmcal

from fuzz.judge import SECONDS, bare
from fuzz.readers import Reader, texts

SCENARIO = """format: ppmcal/scenario/1
units: {length: mm, angle: deg}
poses: {random: {center: {x: 500, y: 260, rz: 25}, half_range: {x: 60, y: 60, rz: 8}, count: 9}}
errors: {random: {scale: 1.0}}
instrument: {kind: pose, sigma: {position: 0.01, rotation: 0.002}}
frame: {x: 5, y: -3, rz: 10}
seed: 7
"""
BATCH = """format: ppmcal/batch/1
campaigns:
  - {machine: a, date: 2026-01-02, model: m.yaml, data: [d.csv]}
"""
WELL = {0, 1, 2, 3}
LONGEST = 30.0
"""Seconds for a command that does not refuse."""


@functools.cache
def desk():
    """A folder with a machine, a scenario, measurements and every result made of them."""
    home = Path(tempfile.mkdtemp(prefix="ppmcal-desk-"))
    (home / "m.yaml").write_bytes(texts("tests/broken/good_bench.yaml")[0])
    (home / "s.yaml").write_text(SCENARIO)
    (home / "t.csv").write_text("x,y,rz\n500,280,20\n510,270,22\n")
    (home / "b.yaml").write_text(BATCH)
    (home / "printer.cfg").write_bytes(texts("sample_data/printer/printer.cfg")[0])
    for args in (("simulate", "m.yaml", "s.yaml", "--out", "sim"),
                 ("simulate", "m.yaml", "s.yaml", "--out", "sim2", "--seed", "8"),
                 ("identify", "m.yaml", "sim/measurements.csv", "--out", "i"),
                 ("identify", "m.yaml", "sim2/measurements.csv", "--out", "j"),
                 ("compensate", "i", "t.csv", "--out", "c", "--frame", "base"),
                 ("kinematics", "inverse", "m.yaml", "t.csv", "--out", "k"),
                 ("validate", "i", "sim2/measurements.csv", "--out", "v"),
                 ("compare", "i", "j", "--out", "x"),
                 ("export", "grid", "i", "--poses", "t.csv", "--out", "e"),
                 ("plan", "m.yaml", "--count", "6", "--out", "p"),
                 ("sensitivity", "m.yaml", "--grid", "x=490:510:3,y=270:290:3", "--out", "se"),
                 ("workspace", "m.yaml", "--grid", "x=490:510:3,y=270:290:3", "--out", "w"),
                 ("diagnose", "m.yaml", "sim/measurements.csv", "--out", "g")):
        ppmcal(*args, cwd=home)
    for end in ("csv", "yaml"):
        shutil.copy(home / "sim" / f"measurements.{end}", home / f"d.{end}")
    return home


def _runs(name, *args):
    """Return a call that runs a command with one file of the desk replaced."""
    def call(data):
        path = desk() / name
        good = path.read_bytes()
        out = Path(tempfile.mkdtemp(prefix="ppmcal-out-"))
        words = [str(out / a.lower()) if a.startswith("OUT") else a for a in args]
        begun = time.process_time()
        try:
            path.write_bytes(data)
            run = ppmcal(*words, cwd=desk())
        finally:
            path.write_bytes(good)
            shutil.rmtree(out, ignore_errors=True)
            (desk() / ".ppmcal.json").unlink(missing_ok=True)
        _check(run, time.process_time() - begun)
        return f"{run.code} {bare(run.err)}"

    return call


def _check(run, seconds):
    text = run.out + run.err
    assert run.code in WELL, f"exit code {run.code}"
    assert "Traceback" not in text, "a traceback was shown"
    if "fault of ppmcal" in text:
        raise AssertionError(run.err.splitlines()[0][:150])
    if run.code == 2:
        assert run.err.count("Error:") == 1, "not one message"
        assert seconds < SECONDS, "slow to refuse"


CORRECT = ("compensate", "i", "t.csv", "--frame", "base", "--out", "OUT")
COMMANDS = {
    "check-machine": ("m.yaml", "check", "m.yaml"),
    "check-table": ("d.csv", "check", "m.yaml", "d.csv"),
    "check-sidecar": ("d.yaml", "check", "m.yaml", "d.csv"),
    "identify-machine": ("m.yaml", "identify", "m.yaml", "d.csv", "--out", "OUT"),
    "identify-table": ("d.csv", "identify", "m.yaml", "d.csv", "--out", "OUT"),
    "identify-sidecar": ("d.yaml", "identify", "m.yaml", "d.csv", "--out", "OUT"),
    "identify-start": ("i/identification.json", "identify", "m.yaml", "sim2/measurements.csv",
                       "--start", "i", "--keep", "--out", "OUT"),
    "simulate-machine": ("m.yaml", "simulate", "m.yaml", "s.yaml", "--out", "OUT"),
    "simulate-scenario": ("s.yaml", "simulate", "m.yaml", "s.yaml", "--out", "OUT"),
    "inverse": ("t.csv", "kinematics", "inverse", "m.yaml", "t.csv", "--out", "OUT"),
    "forward": ("d.csv", "kinematics", "forward", "m.yaml", "d.csv", "--out", "OUT"),
    "compensate-targets": ("t.csv", *CORRECT),
    "compensate-model": ("i/identified.yaml", *CORRECT),
    "compensate-knowledge": ("i/identification.json", *CORRECT),
    "validate": ("i/identification.json", "validate", "i", "sim2/measurements.csv", "--out", "OUT"),
    "compare": ("i/identification.json", "compare", "i", "j", "--out", "OUT"),
    "report-fit": ("i/identification.json", "report", "i", "--out", "OUT"),
    "report-parameters": ("i/parameters.csv", "report", "i", "--out", "OUT"),
    "report-residuals": ("i/residuals.csv", "report", "i", "--out", "OUT"),
    "report-diagnosis": ("g/diagnosis.json", "report", "g", "--out", "OUT"),
    "report-validation": ("v/validation.json", "report", "v", "--out", "OUT"),
    "report-comparison": ("x/comparison.json", "report", "x", "--out", "OUT"),
    "report-commands": ("c/commands.json", "report", "c", "--out", "OUT"),
    "report-truth": ("sim/truth.json", "report", "sim", "i", "--out", "OUT"),
    "report-plan": ("p/poses.json", "report", "p", "--out", "OUT"),
    "report-workspace": ("w/workspace.json", "report", "w", "--out", "OUT"),
    "report-sensitivity": ("se/sensitivity.json", "report", "se", "--out", "OUT"),
    "report-export": ("e/export.json", "report", "e", "--out", "OUT"),
    "import-klipper": ("printer.cfg", "import", "klipper", "printer.cfg", "--out", "OUT"),
    "read": ("d.csv", "read", "d.csv", "--mechanism", "m.yaml", "--out", "OUT.csv"),
}


def commands():
    """Return name -> what takes the bytes of the changed file, as a reader."""
    home = desk()
    return {name: Reader(name, _runs(file, *args), ((home / file).read_bytes(),), LONGEST)
            for name, (file, *args) in COMMANDS.items() if (home / file).is_file()}


def seeds():
    """Return name -> content of every result, as short as can be."""
    home = desk()
    return {path.name: json.dumps(json.loads(path.read_text()), separators=(",", ":")).encode()
            for path in home.glob("*/[a-z]*.json")}


def clean():
    """Remove the desk."""
    shutil.rmtree(desk(), ignore_errors=True)


def write_seeds(corpus):
    """Write results into the corpus, as good inputs of those who read them back."""
    (corpus / "results").mkdir(parents=True, exist_ok=True)
    for name, data in seeds().items():
        (corpus / "results" / name).write_bytes(data)
