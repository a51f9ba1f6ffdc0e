"""Every command and file that the guides and the README show: run in order, in a folder."""

from __future__ import annotations

import shlex
import shutil
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
from generators.notebook import cells
from generators.pages import FENCE, WHOLE, Ran, Step, perform, stands, steps, units, with_output
from helpers.commands import ppmcal
from helpers.desk import examples_of
from helpers.paths import ROOT
from helpers.shared import shared_desk

from ppmcal.cli import cli
from ppmcal.commands import command, names

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
ELSEWHERE = {"--scheduler": "needs a cluster"}
"""What a command line has that is not run here: its options are read all the same."""
QUICK = {"init", "check", "schema"}
"""Commands without a fit."""
HEAVY = {"compare", "diagnose", "plan", "sensitivity", "workspace"}
"""Commands that take more than some seconds."""


FEWER = {"tolerances": ("--machines", "100")}
"""What is drawn here in place of what a page draws: thousands of machines say no more of a page."""


def shown():
    """Return the page, whether it is whole, and the steps of each block that is run here.

    Left out is a block of commands alone each of which is a help's example, which
    `cli/test_examples.py` runs among the same files, or stands in another block that is run.
    """
    found = [(path, page.startswith(WHOLE), unit) for path in PAGES
             for page in (path.read_text(encoding="utf-8"),) for unit in units(page)]
    times = Counter(key for _, _, unit in found for key in keys(unit))
    times.update((line, Step(0).codes) for name in (n for n in names() if not command(n).script)
                 for line in examples_of(name))
    for path, whole, unit in found:
        own = Counter(keys(unit))
        plain = not whole and all(s.line.startswith("ppmcal ") for s in unit)
        if plain and all(times[key] > count for key, count in own.items()):
            times -= own
        else:
            yield path, whole, unit


def keys(unit: list[Step]) -> list[tuple[str, tuple[int, ...]]]:
    return [(s.line, s.codes) for s in unit if s.line]


def run(words: list[str], folder: Path) -> Ran:
    done = ppmcal(*words, cwd=folder)
    return Ran(done.code, done.out + done.err)


def cases():
    for path, whole, unit in shown():
        verbs = {word for s in unit if s.line for word in shlex.split(s.line)[1:2]}
        marks = [getattr(pytest.mark, name) for name, holds in (
            ("slow", whole or not verbs <= QUICK), ("long", verbs & HEAVY)) if holds]
        yield pytest.param(path.name, whole, unit, id=f"{path.stem}-{unit[-1].block}", marks=marks)


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    folder = Path(shutil.copytree(shared_desk(tmp_path_factory),
                                  tmp_path_factory.mktemp("desk") / "files"))
    for name in ("sample_data", "configs"):
        shutil.copytree(ROOT / name, folder / name)
    return folder


def fewer(step: Step) -> Step:
    """Return the step with as few draws as prove that it runs."""
    words = shlex.split(step.line)
    if len(words) < 2 or words[1] not in FEWER:
        return step
    option, count = FEWER[words[1]]
    if option in words:
        words[words.index(option) + 1] = count
    else:
        words += [option, count]
    return replace(step, line=shlex.join(words))


def on_a_desk(step: Step, folder: Path) -> Ran:
    """Perform a step where other files are already: a reader would have none of its results.

    What `init` writes makes way for the file in which a reader has put the machine's numbers.
    """
    words = shlex.split(step.line)
    made = []
    if words[:2] == ["ppmcal", "init"] and "--out" in words:
        name = folder / words[words.index("--out") + 1]
        made = [name, name.with_suffix(".scenario.yaml")]
    kept = {path: path.read_bytes() for path in made if path.exists()}
    for path in kept:
        path.unlink()
    if words[:2] == ["ppmcal", "compare"] and (folder / "compared").exists():
        shutil.rmtree(folder / "compared")
    ran = perform(step, folder, run)
    for path, content in kept.items():
        assert path.exists()
        path.write_bytes(content)
    return ran


# what these show, quicker blocks and the examples of the help run as well
@pytest.mark.long_cases("report-7", "sensitivity-70", "validation-7", "without-instrument-58")
@pytest.mark.parametrize(("page", "whole", "unit"), list(cases()))
def test_what_a_page_shows_runs(page, whole, unit, request, tmp_path):
    folder = tmp_path / "here"
    if whole:
        folder.mkdir()
        shutil.copytree(ROOT / "sample_data", folder / "sample_data")
    else:
        shutil.copytree(request.getfixturevalue("desk"), folder)
    for step in unit:
        if any(mark in step.line for mark in ELSEWHERE):
            _, name, *words = shlex.split(step.line)
            cli.get_command(None, name).make_context(name, words)
            continue
        short = fewer(step)
        ran = perform(short, folder, run) if whole else on_a_desk(short, folder)
        assert ran.code in step.codes, f"{page}, line {step.block}: {step.line or step.name}\n" \
                                       f"exit code {ran.code}\n{ran.text}"


def test_what_is_not_run_here_names_what_is_there():
    named = [s for path in PAGES for s in steps(path.read_text(encoding="utf-8"))
             if s.line and not s.line.startswith("ppmcal")]
    assert {shlex.split(s.line)[0] for s in named} >= {"make", "python"}
    assert stands(Step(1, line="make coffee")).code == 2
    assert stands(Step(1, line="python benchmarks/gone.py")).code == 2


def test_a_page_is_parsed():
    page = ('```\nppmcal init    # a remark\nx,y\nppmcal check \\\n  mine.yaml\n```\n'
            '```yaml title="a.yaml"\nk: 1\n```\n'
            '```console\n$ ppmcal check b.yaml   # exit code 2\nError\n...\n$ cat a.yaml\n```\n'
            '```text\nppmcal nothing\n```\n')
    found = list(steps(page))
    assert [s.line or s.name for s in found] == [
        "ppmcal init", "ppmcal check mine.yaml", "a.yaml", "ppmcal check b.yaml", "cat a.yaml"]
    assert [s.codes for s in found] == [(0, 1)] * 3 + [(2,), (0, 1)]
    assert found[3].output == ("Error", "...")
    assert [len(u) for u in units(page)] == [2, 3]


def test_outputs_are_written_anew(tmp_path):
    page = ('```text title="a.txt"\none\ntwo\nthree\n```\n'
            '```console\n$ cat a.txt\nold\n...\n$ head -1 a.txt\n```\n')
    new = with_output(page, tmp_path)
    assert new.endswith("```console\n$ cat a.txt\none\n...\n$ head -1 a.txt\none\n```\n")
    assert with_output(new, tmp_path) == new


def test_no_page_shows_a_place_of_its_makers_machine():
    for path in PAGES:
        for block in FENCE.finditer(path.read_text(encoding="utf-8")):
            assert not any(w in block["body"] for w in (tempfile.gettempdir(), str(ROOT), "/home/"))


@pytest.mark.long
def test_the_cells_of_the_notebook_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    code = [text for kind, text in cells(ROOT / "docs" / "calibration.ipynb") if kind == "code"]
    assert len(code) > 5
    for text in code:
        exec(compile(text, "calibration.ipynb", "exec"), names)
