"""The methods beside the tool, each on readings whose cause is known and where it has to fail."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from labelled.baselines import METHODS, bic, gp, split
from labelled.linear import Candidate, LinearProblem, gains, linear_problem, without
from labelled.run import main
from labelled.score import Name, read_answers
from labelled.sources import Files

import ppmcal

NOISE = 0.1
POSES = 60


def problem(kind: str, seed: int = 1, size: float = 1.0) -> LinearProblem:
    """Return readings of one joint, visited twice, with ``kind`` in them and a line as geometry.

    ``curvature``, ``backlash``, ``step`` are candidates; ``wave`` is none; ``typo``: one reading.
    """
    rng = np.random.default_rng(seed)
    q = np.repeat(rng.uniform(-1.0, 1.0, POSES), 2)
    way = np.tile([1.0, -1.0], POSES)
    order = np.arange(q.size, dtype=float)
    shapes = {"curvature": q**2, "backlash": way, "step": (order > 70.0).astype(float),
              "wave": np.sin(5.0 * q) + q**2, "typo": 3.0 * (order == 40.0),
              "nothing": np.zeros(q.size)}
    names = ("curvature", "backlash", "step")
    geometry = np.column_stack([np.ones(q.size), q])
    basis = np.linalg.qr(geometry)[0]
    matrix = np.column_stack([shapes[n] for n in names])
    matrix = without(matrix / np.linalg.norm(matrix, axis=0), basis)
    values = size * shapes[kind] + NOISE * rng.normal(size=q.size)
    return LinearProblem(
        without(values, basis), geometry, matrix,
        tuple(Candidate(n, (i,), ("leg1",)) for i, n in enumerate(names)),
        np.arange(q.size), np.repeat(np.arange(POSES), 2),
        {"joint leg1": q, "direction leg1": way, "order": order},
        np.zeros(q.size, dtype=np.int64))


def kinds(method: str, of: LinearProblem, seed: int = 1) -> set[str]:
    return {n.kind for n in METHODS[method](of, seed)[0]}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", ["curvature", "backlash"])
def test_one_cause_is_named(method: str, kind: str) -> None:
    assert kinds(method, problem(kind)) == {kind}


@pytest.mark.parametrize("method", METHODS)
def test_of_twenty_without_a_cause_few_have_a_name(method: str) -> None:
    """BIC of three candidates and 120 readings is wrong in about one of twelve by itself."""
    false = sum(bool(kinds(method, problem("nothing", seed))) for seed in range(20))
    assert false <= 6


@pytest.mark.parametrize("method", METHODS)
def test_a_reading_typed_wrong_is_named(method: str) -> None:
    assert Name("row", rows=(41,)) in METHODS[method](problem("typo"), 1)[0]


def test_sparse_regression_does_not_tell_equal_columns_apart() -> None:
    """It names both, where steps name one of them, whichever is true."""
    assert {"backlash", "windup"} <= kinds("sindy", twice())


def test_steps_name_one_of_two_equal_columns() -> None:
    assert kinds("bic", twice()) == {"backlash"}


def twice() -> LinearProblem:
    """Return readings in which a second kind looks the same as the true one."""
    one = problem("backlash")
    return LinearProblem(
        one.residual, one.geometry, np.column_stack([one.matrix, one.matrix[:, 1]]),
        (*one.candidates, Candidate("windup", (3,), ("leg1",))), one.reading, one.group,
        one.inputs, one.coordinate)


def test_a_shape_of_no_candidate() -> None:
    """A process calls it unknown; steps imitate it with what they have."""
    of = problem("wave", size=0.3)
    assert gp.names(of, 1) == ((), 1.0)
    assert METHODS["bic"](of, 1)[1] == 0.0
    assert kinds("bic", of)


def test_what_only_one_half_shows_is_not_confirmed() -> None:
    whole = problem("nothing")
    first = split.halves(whole, 1)
    inside = 0.5 * np.where(first, np.tile([1.0, -1.0], POSES), 0.0)
    half = LinearProblem(
        whole.residual + without(inside, whole.basis), whole.geometry, whole.matrix,
        whole.candidates, whole.reading, whole.group, whole.inputs, whole.coordinate)
    assert "backlash" in kinds("bic", half)
    assert "backlash" not in kinds("split", half)


def test_gains_are_falls_of_the_sum_of_squares() -> None:
    of = problem("step")
    every = (*of.candidates, Candidate("both", (0, 1)))
    fall = gains(of.matrix, of.residual, every)
    for c, gain in zip(every, fall, strict=True):
        columns = of.matrix[:, list(c.columns)]
        rest = of.residual - columns @ np.linalg.lstsq(columns, of.residual, rcond=None)[0]
        assert gain == pytest.approx(of.residual @ of.residual - rest @ rest, rel=1e-4)


def test_a_model_has_no_more_than_the_readings_allow() -> None:
    few = problem("curvature").take(np.arange(6))
    assert len(bic.chosen(few)) <= 2


@pytest.fixture(scope="module")
def bench(tmp_path_factory) -> Path:
    """A planar machine whose drives have play, measured from both sides, and a set of two cases.

    ``bench`` has its play, ``typed`` a position that is 5 mm off.
    """
    folder = tmp_path_factory.mktemp("bench")
    scenario = yaml.safe_load(ppmcal.shipped("3-RPR", True).read_text(encoding="utf-8")) | {
        "seed": 3, "approach": "both", "repeats": 1,
        "effects": [{"kind": "backlash", "parameters": {"width": 0.05}}]}
    machine = ppmcal.load(ppmcal.shipped("3-RPR"))
    ppmcal.simulate(machine, scenario).save(folder / "data")
    (folder / "machine.yaml").write_bytes(ppmcal.shipped("3-RPR").read_bytes())
    usual = {"reader": "files", "data": ["machine.yaml", "data/measurements.csv"], "kind": "k",
             "source": "tests"}
    (folder / "truth").mkdir()
    cases = [
        {"name": "bench", "basis": "simulated", "words": "play of all drives",
         "asks": ["backlash", "play", "lag", "clearance"],
         "causes": [{"kind": ["backlash", "play"]}]},
        {"name": "typed", "basis": "injected", "words": "x is 5 mm off in reading 8", "asks": "row",
         "inject": [{"column": "x", "row": 8, "add": 5.0}],
         "causes": [{"kind": "row", "rows": [8, 8]}]}]
    (folder / "truth/set.yaml").write_text(yaml.safe_dump(
        {"set": "set", "defaults": usual, "cases": cases}), encoding="utf-8")
    return folder


def test_linear_problem_of_files(bench: Path) -> None:
    """Residuals and columns are without geometry; the column of play explains most of what is."""
    of = linear_problem(Files(bench / "machine.yaml", (bench / "data/measurements.csv",)))
    assert of.residual.size == 3 * np.unique(of.reading).size
    assert {"joint leg1", "direction leg1", "order"} <= set(of.inputs)
    assert np.abs(of.basis.T @ of.residual).max() < 1e-6 * np.linalg.norm(of.residual)
    assert np.abs(of.basis.T @ of.matrix).max() < 1e-6
    part = gains(of.matrix, of.residual, of.candidates) / (of.residual @ of.residual)
    shared = [g for c, g in zip(of.candidates, part, strict=True)
              if c.kind == "backlash" and len(c.on) == 3]
    assert max(shared) > 0.5
    assert max(shared) > max(g for c, g in zip(of.candidates, part, strict=True)
                             if c.kind in ("gain", "curvature"))


@pytest.mark.long
def test_command_scores_and_goes_on(bench: Path, tmp_path: Path, capsys) -> None:
    """What was answered before stands; a submission is scored as the run was."""
    asked = ["--truth", str(bench / "truth"), "--data", str(bench), "--out", str(tmp_path / "out"),
             "--methods", "bic", "split"]
    assert main(asked) == 0
    told = capsys.readouterr().out
    assert "seed 1: 2 cases of set; the tool's authors had never seen the readings of 0." in told
    assert "| k (injected) | 1 | bic | 1 (2-100) |" in told
    answers = read_answers(tmp_path / "out/bic.jsonl")
    assert {a.case for a in answers} == {"set/bench", "set/typed"}
    assert "set/bench,k,simulated,True,bic," in (tmp_path / "out/cases.csv").read_text()
    kept = (tmp_path / "out/bic.jsonl").read_bytes()
    assert main(asked) == 0
    assert (tmp_path / "out/bic.jsonl").read_bytes() == kept
    assert "1 of" not in capsys.readouterr().err
    assert main(["--truth", str(bench / "truth"),
                 "--submission", str(tmp_path / "out/bic.jsonl")]) == 0
    assert "| k (injected) | 1 | bic | 1 (2-100) |" in capsys.readouterr().out


@pytest.mark.long
def test_the_tool_answers_both(bench: Path, tmp_path: Path) -> None:
    assert main(["--truth", str(bench / "truth"), "--data", str(bench), "--out",
                 str(tmp_path / "out"), "--methods", "ppmcal"]) == 0
    lines = (tmp_path / "out/cases.csv").read_text(encoding="utf-8").splitlines()[1:]
    assert [line.split(",")[5] for line in lines] == ["right", "right"]


def test_files_of_cases_are_written(bench: Path, tmp_path: Path) -> None:
    assert main(["--truth", str(bench / "truth"), "--data", str(bench),
                 "--write-files", str(tmp_path / "cases")]) == 0
    plain, typed = ((tmp_path / f"cases/set/{n}/measurements.csv").read_text(encoding="utf-8")
                    for n in ("bench", "typed"))
    differ = [n for n, (a, b) in enumerate(
        zip(plain.split(), typed.split(), strict=True)) if a != b]
    assert differ == [8]


@pytest.mark.parametrize("options, words", [
    (["--data", "nowhere"], "the readings are not here"),
    (["--truth", "nowhere"], "no truth table is here"),
    (["--submission", "nowhere.jsonl"], "no submission is here")])
def test_bad_input_is_told(options: list[str], words: str, capsys, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(options) == 2
    assert words in capsys.readouterr().err
