"""Run the real commands on real files: in this process, or for a few tests in their own."""

import contextlib
import csv
import io
import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

EXECUTABLE = [sys.executable, "-c", "from ppmcal.cli import main; main()"]


@dataclass(frozen=True)
class Run:
    """What one command left behind on its two streams, and its exit code."""

    code: int
    out: str
    err: str

    @property
    def json(self):
        """Standard output as exactly one JSON object."""
        found = json.loads(self.out)
        assert isinstance(found, dict)
        return found


def ppmcal(*args, cwd=None, expect=None):
    """Run ``ppmcal args`` in this process, in the folder ``cwd``; check the exit code if asked."""
    from ppmcal.cli import main

    out, err = io.StringIO(), io.StringIO()
    argv = ["ppmcal", *map(str, args)]
    with (
        mock.patch.object(sys, "argv", argv),
        mock.patch.dict(os.environ, {"COLUMNS": "80", "NO_COLOR": "1"}),
        contextlib.chdir(cwd or Path.cwd()),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        os.environ.pop("PPMCAL_DEBUG", None)
        code = 0
        try:
            main()
        except SystemExit as stop:
            code = stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    run = Run(code, out.getvalue(), err.getvalue())
    if expect is not None:
        assert run.code == expect, f"{' '.join(argv)}\nexit {run.code}\n{run.out}{run.err}"
    return run


def environment(*first):
    """Return what another process needs to find all that this one does, and ``first`` before."""
    return {**os.environ, "COLUMNS": "80", "NO_COLOR": "1",
            "PYTHONPATH": os.pathsep.join([*map(str, first), *filter(None, sys.path)])}


def ppmcal_process(*args, cwd=None, timeout=60, site=None, expect=None):
    """Run ``ppmcal args`` as a process of its own; ``site``: a folder of installed packages."""
    done = subprocess.run([*EXECUTABLE, *map(str, args)], cwd=cwd, capture_output=True, text=True,
                          timeout=timeout, check=False, env=environment(*[site] if site else []))
    run = Run(done.returncode, done.stdout, done.stderr)
    if expect is not None:
        assert run.code == expect, f"{args}\nexit {run.code}\n{run.out}{run.err}"
    return run


def install(site, name, code, entries):
    """Write a package ``name`` of one module into ``site``; ``entries``: group -> its lines."""
    info = Path(site) / f"{name}-1.0.dist-info"
    info.mkdir(parents=True)
    (Path(site) / f"{name}.py").write_text(code)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("".join(
        f"[{group}]\n" + "".join(f"{entry} = {name}:{what}\n" for entry, what in lines.items())
        for group, lines in entries.items()))
    return Path(site)


def columns(path):
    """Return the header of a CSV file."""
    with Path(path).open(newline="") as file:
        return next(csv.reader(file))


def rows(path):
    """Return the rows of a CSV file as dictionaries of text."""
    with Path(path).open(newline="") as file:
        return list(csv.DictReader(file))


def number(row, name):
    """Return one cell as a number, nan where it is empty."""
    return float(row[name] or "nan")


def write_csv(path, table):
    """Write dictionaries as a CSV file whose columns are the first row's keys."""
    lines = [",".join(table[0]), *(",".join(str(v) for v in row.values()) for row in table)]
    Path(path).write_text("\n".join(lines) + "\n")


def pick(path, names, target):
    """Copy some columns of a CSV file to another; ``names`` maps old to new, or lists them."""
    names = names if isinstance(names, dict) else {name: name for name in names}
    write_csv(target, [{new: row[old] for old, new in names.items()} for row in rows(path)])


def tree(folder):
    """Return every file below a folder with its bytes."""
    return {str(path.relative_to(folder)): path.read_bytes()
            for path in sorted(Path(folder).rglob("*")) if path.is_file()}
