"""Do two versions of ppmcal give the same results?

    python benchmarks/same_results.py run before            # in the old checkout
    python benchmarks/same_results.py run after             # in the new one
    python benchmarks/same_results.py compare before after  # value by value

`run` takes the demo, three simulated machines, the hidden sample and the printer sample through
the commands, with the same words in any version. `compare` goes through every CSV, JSON and YAML
file: same keys, same texts, numbers to a relative 1e-7 (what a changed order of a sum may do,
after an iteration) or 1e-12 of the column's own size. It ends with 1 where anything differs. What
a version renames on purpose is told by `--renamed old=new` (a column or a JSON key), repeated.
"""

import csv
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import click
import yaml

MACHINES = ("3-RPR", "6-UPS", "delta-linear")
RELATIVE, TINY = 1e-7, 1e-12
NO_RESULTS = ("provenance",)
"""Keys whose values are no results: where and by which version they were made."""


def steps(root):
    """Return the command lines: each is run in the output folder, with `root` the checkout."""
    sample = root / "sample_data"
    lines = [["demo", "--out", "demo"]]
    for name in MACHINES:
        mech, out = root / "configs" / f"{name}.yaml", Path(name)
        model = out / "identified" / "identified.yaml"
        lines += [
            ["check", mech],
            ["simulate", mech, root / "configs" / "scenarios" / f"{name}.yaml", "--out",
             out / "simulated"],
            ["identify", mech, out / "simulated" / "measurements.csv", "--out",
             out / "identified"],
            ["diagnose", mech, out / "simulated" / "measurements.csv", "--out",
             out / "diagnosed"],
            ["kinematics", "forward", model, out / "simulated" / "measurements.csv", "--out",
             out / "forward"],
            ["compensate", model, out / "forward" / "kinematics.csv", "--frame", "base", "--out",
             out / "compensated"],
            ["sensitivity", mech, "--out", out / "sensitivity"],
            ["workspace", mech, "--out", out / "workspace"],
            ["plan", mech, "--count", "12", "--seed", "3", "--out", out / "plan"],
            ["tolerances", mech, "--accuracy", "0.5", "--machines", "200", "--seed", "3",
             "--cores", "1", "--out", out / "tolerances"],
            ["compare", out / "identified", out / "identified", "--out", out / "compared"],
            ["report", out / "simulated", out / "identified", out / "diagnosed",
             out / "compensated", "--out", out / "report"],
        ]
    lines += [
        ["stiffness", root / "configs" / "linapod.yaml", "--load", "fz=-100", "--out",
         "stiffness"],
        ["diagnose", sample / "hexapod.yaml", sample / "hidden" / "measurements.csv", "--out",
         "hidden"],
        ["import", "klipper", sample / "printer" / "printer.cfg", "--out", "printer/imported"],
        ["identify", "printer/imported/machine.yaml", "printer/imported/heights.csv",
         "printer/imported/distances.csv", "--out", "printer/identified"],
        ["export", "klipper", "printer/identified/identified.yaml", "--old",
         sample / "printer" / "printer.cfg", "--out", "printer/exported"],
    ]
    return [[str(word) for word in line] for line in lines]


ROOT = "checkout.txt"
"""The file of an output folder that says where the checkout was."""


def numbered(value):
    """Return a text as the number that it is, or as it is."""
    try:
        return float(value)
    except ValueError:
        return value


def leaves(value, place=()):
    """Yield every leaf of a nested value with its place."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from leaves(inner, (*place, str(key)))
    elif isinstance(value, list):
        for number, inner in enumerate(value):
            yield from leaves(inner, (*place, number))
    else:
        yield place, value


def read(path, root, renamed):
    """Return a result file as a mapping from place to value; None for a kind without values.

    Paths in the checkout ``root`` are as if it stood in the working directory.
    """
    if path.suffix == ".csv":
        lines = path.read_text().replace(root, ".").splitlines()
        rows = [{renamed.get(k, k): numbered(v) for k, v in row.items() if k is not None}
                for row in csv.DictReader(lines)]
        return dict(leaves(rows))
    if path.suffix not in (".json", ".yaml"):
        return None
    text = path.read_text().replace(root, ".")
    loaded = (json.loads if path.suffix == ".json" else yaml.safe_load)(text)
    return {tuple(renamed.get(p, p) for p in place): value for place, value in leaves(loaded)
            if not any(p in NO_RESULTS for p in place)}


def same(one, two):
    """Return whether two leaves hold the same."""
    plain = (int, float)
    if not (isinstance(one, plain) and isinstance(two, plain)) or isinstance(one, bool):
        return one == two
    return one == two or (one != one and two != two) or \
        abs(one - two) <= max(RELATIVE * max(abs(one), abs(two)), TINY)


def differences(before, after, renamed):
    """Yield a line for everything that two folders do not have in common."""
    roots = [(f / ROOT).read_text() for f in (before, after)]
    files = {p.relative_to(f) for f in (before, after) for p in f.rglob("*") if p.is_file()}
    for name in sorted(f for f in files if f.name not in (".ppmcal.json", ROOT)):
        if not ((before / name).exists() and (after / name).exists()):
            yield f"{name}: only {'before' if (before / name).exists() else 'after'}"
            continue
        old, new = read(before / name, roots[0], renamed), read(after / name, roots[1], {})
        if old is None or new is None:
            continue
        for place in [*old, *(p for p in new if p not in old)]:
            missing = "only before" if place not in new else "only after" if place not in old \
                else None
            if missing or not same(old[place], new[place]):
                at = "/".join(map(str, place))
                yield f"{name}: {at}: " + (missing or f"{old[place]!r} -> {new[place]!r}")


@click.group()
def main():
    """Compare the results of two versions of ppmcal."""


@main.command()
@click.argument("out", type=click.Path(path_type=Path))
def run(out):
    """Run every command on the samples, into the folder OUT."""
    out.mkdir(parents=True, exist_ok=False)
    root = Path(__file__).resolve().parents[1]
    (out / ROOT).write_text(str(root))
    for line in steps(root):
        start = time.perf_counter()
        ran = subprocess.run([sys.executable, "-m", "ppmcal", *line], cwd=out, text=True,
                             capture_output=True, check=False,
                             env={**os.environ, "PYTHONPATH": str(root)})
        with (out / "codes.csv").open("a") as handle:
            if not handle.tell():
                handle.write("command,exit_code\n")
            words = " ".join(line).replace(str(root), ".").replace(",", ";")
            handle.write(f"{words},{ran.returncode}\n")
        click.echo(f"{time.perf_counter() - start:6.1f} s  exit {ran.returncode}  {words}")
        if ran.returncode not in (0, 1):
            click.echo(ran.stderr)


@main.command()
@click.argument("before", type=click.Path(path_type=Path, exists=True))
@click.argument("after", type=click.Path(path_type=Path, exists=True))
@click.option("--renamed", multiple=True, help="old=new: a column or key renamed on purpose.")
@click.option("--most", default=40, help="Lines to print.")
def compare(before, after, renamed, most):
    """Print what BEFORE and AFTER do not have in common."""
    found = list(differences(before, after, dict(r.split("=", 1) for r in renamed)))
    for line in found[:most]:
        click.echo(line)
    files = sum(p.suffix in (".csv", ".json", ".yaml") for p in after.rglob("*"))
    click.echo(f"{len(found)} differences in {files} files.")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
