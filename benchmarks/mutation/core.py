"""Which modules are the core, and which tests can notice a fault in them."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build" / "mutants"

CORE = {
    "closure": (
        "kinematics/closure.py", "kinematics/limb_groups.py", "kinematics/limb_roots.py",
        "kinematics/forward.py", "kinematics/inverse.py", "kinematics/entry_tables.py",
        "kinematics/compiled_limbs.py", "model/limbs/*.py"),
    "effects": (
        "kinematics/equilibrium.py", "kinematics/effect_response.py", "model/effects/*.py"),
    "least squares": (
        "calibration/fit/linearisation.py", "calibration/fit/gauss_newton.py",
        "calibration/fit/normal_equations.py", "calibration/fit/response.py",
        "calibration/fit/observation.py", "calibration/fit/raw_rows.py",
        "calibration/fit/white_rows.py"),
    "identifiability": (
        "calibration/knowledge/identifiability_report.py", "calibration/fit/rank.py",
        "calibration/fit/prior_information.py", "calibration/knowledge/intervals.py"),
    "inference": ("inference/*.py",),
    "compensation": (
        "calibration/compensation/commands.py", "calibration/compensation/safe_commands.py",
        "calibration/knowledge/extrapolation.py", "kinematics/ways.py"),
    "diagnosis": (
        "diagnosis/cause_sizes.py", "diagnosis/explanation.py", "diagnosis/findings.py",
        "diagnosis/hypotheses.py", "diagnosis/linear_system.py", "diagnosis/naming.py",
        "diagnosis/question.py", "diagnosis/refit.py", "diagnosis/lack_of_fit.py",
        "diagnosis/linearisation.py"),
}
"""Files below ppmcal, by what they are of the theory."""

COMPILED = {"compiled": ("kinematics/compiled_closure.py", "kinematics/compiled_algebra.py",
                         "calibration/fit/compiled_rows.py")}
"""The same formulas once more, row by row: each mutant is compiled, which takes its time."""

TESTS = ("tests/kinematics", "tests/model", "tests/calibration", "tests/inference",
         "tests/diagnosis", "tests/test_papers.py", "tests/test_plug_ins.py")
COMPILED_TESTS = ("tests/kinematics/test_compiled.py", "tests/calibration/test_normal_equations.py")
"""No line of a compiled function is seen by coverage: these call them."""


def core_files(compiled: bool = False) -> dict[str, str]:
    """Return each file of the core, or what of it is compiled, and its part."""
    return {path.relative_to(ROOT).as_posix(): part
            for part, patterns in (COMPILED if compiled else CORE).items() for pattern in patterns
            for path in sorted((ROOT / "ppmcal").glob(pattern))
            if path.name != "__init__.py"}
