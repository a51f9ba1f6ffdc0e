"""What is installed and from what: ``make wheel`` and ``make oldest``.

wheel: builds the source distribution, from that the wheel, installs it into a clean environment and
runs the main commands in a folder of their own, with nothing of the checkout in reach.
oldest: installs the oldest versions that pyproject.toml allows and runs a part of the tests.
Both work in a copy, so that tests of the checkout may run beside them.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
import venv
import zipfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BUILD = ROOT / "build" / "supply"
OLDEST = (3, 11)
"""The Python whose wheels of the oldest versions there are."""
TESTS = ("tests/algebra/test_algebra.py", "tests/io/test_configs.py", "tests/io/test_mechanism.py",
         "tests/io/test_json_schema.py", "tests/io/test_excel.py", "tests/io/test_parquet.py",
         "tests/io/test_recorders.py", "tests/io/test_roundtrip.py", "tests/io/test_output.py",
         "tests/kinematics/test_kinematics.py", "tests/kinematics/test_compiled.py",
         "tests/model/test_limbs.py", "tests/calibration/test_normal_equations.py",
         "tests/calibration/test_identifiability.py", "tests/plotting/test_pictures.py",
         "tests/plotting/test_maps.py", "tests/cli/test_tables.py")
"""A part that imports every dependency and calls what of it ppmcal calls."""
OF_THEIR_TIME = "pyparsing<3.3\n"
"""What warns, when newer, of what the oldest call still; in tests warnings are errors."""
COMMANDS = (
    "--version", "init 6-UPS --out mine.yaml", "check mine.yaml --draw mine.html",
    "simulate {data}/hexapod.yaml {data}/scenario.yaml --seed 1 --out simulated",
    "check {data}/hexapod.yaml simulated/measurements.csv",
    "identify {data}/hexapod.yaml simulated/measurements.csv --out identified",
    "kinematics inverse identified/identified.yaml {data}/poses.csv --out joints",
    "compensate identified/identified.yaml {data}/targets.csv --out compensated",
    "plan {data}/hexapod.yaml --count 8 --instrument {data}/measurements.yaml --out plan",
    "schema mechanism", "report identified compensated joints plan --out report")
"""What a user does first; {data}: the sample data that came with the wheel."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Prove the wheel, the oldest versions, or both."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("wheel", "oldest"))
    parser.add_argument("--python", default=sys.executable, help="interpreter to install into")
    parser.add_argument("--wheel", type=Path, help="a wheel that was built already")
    options = parser.parse_args(arguments)
    BUILD.mkdir(parents=True, exist_ok=True)
    if options.what == "oldest":
        return oldest()
    wheel = options.wheel or built()
    complete(wheel)
    installed(wheel, options.python)
    return 0


def built() -> Path:
    """Return the wheel that is made from the source distribution."""
    out = BUILD / "dist"
    shutil.rmtree(out, ignore_errors=True)
    tools = environment("builder", sys.executable)
    run(tools, "-m", "pip", "install", "--quiet", "build")
    run(tools, "-m", "build", "--outdir", str(out), str(copied("wheel-source")))
    made, = out.glob("*.whl")
    return made


def copied(name: str) -> Path:
    """Return a folder with the files that git knows, as they are in the checkout."""
    folder = BUILD / name
    shutil.rmtree(folder, ignore_errors=True)
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True,
                            check=True).stdout.split("\0")
    for file in filter(None, listed):
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / file, folder / file)
    return folder


def complete(wheel: Path) -> None:
    """Compare the wheel's files with those of the checkout.

    Raises:
        SystemExit: one is not in it, with its name.
    """
    listed = subprocess.run(["git", "ls-files", "ppmcal", "configs", "sample_data"], cwd=ROOT,
                            capture_output=True, text=True, check=True).stdout.split("\n")
    wanted = {name if name.startswith("ppmcal/") else f"ppmcal/{name}" for name in listed if name}
    with zipfile.ZipFile(wheel) as file:
        found = {name for name in file.namelist() if ".dist-info/" not in name}
    if missing := sorted(wanted - found):
        raise SystemExit(f"{wheel.name}: without {', '.join(missing[:9])}")
    if more := sorted(found - wanted):
        raise SystemExit(f"{wheel.name}: with {', '.join(more[:9])}, which git does not know")
    print(f"{wheel.name}: all {len(found)} files, {wheel.stat().st_size / 1e6:.1f} MB")


def installed(wheel: Path, interpreter: str) -> None:
    """Install a wheel into a clean environment and run the commands elsewhere."""
    python = environment("clean", interpreter)
    run(python, "-m", "pip", "install", "--quiet", str(wheel))
    with tempfile.TemporaryDirectory(prefix="elsewhere-") as folder:
        where = run(python, "-c", "from ppmcal.io.templates import sample_data; "
                    "print(sample_data())", folder=folder).strip()
        if Path(where).is_relative_to(ROOT) and not Path(where).is_relative_to(BUILD):
            raise SystemExit(f"sample data are taken from the checkout: {where}")
        for command in COMMANDS:
            print(f"$ ppmcal {command}", flush=True)
            run(python, "-m", "ppmcal", *command.format(data=where).split(), folder=folder,
                good=(0, 1))
        page = Path(folder, "report", "report.html").read_text(encoding="utf-8")
        if "</html>" not in page:
            raise SystemExit("report.html is not whole")
    print(f"{len(COMMANDS)} commands ran with {run(python, '--version').strip()}.")


def oldest() -> int:
    """Install the oldest versions allowed and run a part of the tests; return their exit code."""
    interpreter = shutil.which(f"python{OLDEST[0]}.{OLDEST[1]}") or sys.executable
    version = run(interpreter, "-c", "import sys; print(*sys.version_info[:2])").split()
    if tuple(map(int, version)) != OLDEST:
        raise SystemExit(f"The oldest versions are those of Python {OLDEST[0]}.{OLDEST[1]}: "
                         "install it, with its venv")
    python, source = environment("oldest", interpreter), copied("oldest-source")
    run(python, "-m", "pip", "install", "--quiet", "uv")
    constraints = BUILD / "constraints.txt"
    constraints.write_text(OF_THEIR_TIME, encoding="utf-8")
    run(python, "-m", "uv", "pip", "install", "--quiet", "--python", python,
        "--resolution", "lowest-direct", "--constraint", str(constraints), "-e", f"{source}[test]")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for line in project["dependencies"]:
        name, lowest = line.split(">=")
        found = run(python, "-c", "import sys; from importlib.metadata import version; "
                    "print(version(sys.argv[1]))", name).strip()
        print(f"{name} {found} (allowed from {lowest})")
    return subprocess.run([python, "-m", "pytest", "-n", "auto", "-m", "not slow", *TESTS],
                          cwd=source, env=clean_variables(), check=False).returncode


def environment(name: str, interpreter: str) -> str:
    """Return the Python of a new virtual environment."""
    folder = BUILD / name
    shutil.rmtree(folder, ignore_errors=True)
    if interpreter == sys.executable:
        venv.create(folder, with_pip=True)
    else:
        run(interpreter, "-m", "venv", str(folder))
    return str(folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python"))


def clean_variables() -> dict[str, str]:
    """Return the environment without what leads Python elsewhere."""
    return {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME",
                                                             "VIRTUAL_ENV")}


def run(program: str, *words: str, folder: str | None = None, good: Sequence[int] = (0,)) -> str:
    """Return what a program prints; ``good``: exit codes, of ppmcal 1 is a finding.

    Raises:
        SystemExit: it failed; with what it said.
    """
    done = subprocess.run([program, *words], cwd=folder, env=clean_variables(),
                          capture_output=True, text=True, check=False)
    if done.returncode not in good or "Traceback" in done.stderr:
        raise SystemExit(f"{Path(program).name} {' '.join(words)}: exit code {done.returncode}\n"
                         f"{done.stdout[-3000:]}{done.stderr[-3000:]}")
    return done.stdout


if __name__ == "__main__":
    raise SystemExit(main())
