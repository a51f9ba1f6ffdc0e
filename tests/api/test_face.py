"""The Python face: its names and docstrings, what it takes, and that commands do the same."""

import ast
import inspect
import json
import re
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
import yaml
from helpers.commands import ppmcal as command
from helpers.commands import tree
from helpers.paths import ROOT

import ppmcal
from ppmcal.commands import functions
from ppmcal.commands.face import result_of
from ppmcal.commands.result import Result
from ppmcal.controllers.export import UNKNOWN, pose_uncertainty
from ppmcal.io import tables as ppmcal_tables

NOTEBOOK = ROOT / "docs" / "calibration.ipynb"
FUNCTIONS = [n for n in ppmcal.__all__ if not n[0].isupper()]


@pytest.fixture(scope="module")
def stage():
    return ppmcal.load(ppmcal.shipped("3-RPR"))


@pytest.fixture(scope="module")
def session(stage):
    return ppmcal.simulate(stage, ppmcal.shipped("3-RPR", scenario=True), seed=7)


@pytest.fixture(scope="module")
def folder(session, tmp_path_factory):
    """The session as files."""
    out = tmp_path_factory.mktemp("face") / "session"
    session.save(out)
    return out


@pytest.fixture(scope="module")
def fit(stage, session):
    return ppmcal.identify(stage, session.data)


# ---------------------------------------------------------------- names and docstrings


def test_neither_import_nor_help_loads_numpy():
    code = ("import sys, ppmcal\nfrom click.testing import CliRunner\n"
            "from ppmcal.cli import cli\n"
            "from ppmcal.commands import names\n"
            "for words in [['--help'], *([name, '--help'] for name in names())]:\n"
            "    assert CliRunner().invoke(cli, words).exit_code == 0\n"
            "print([m for m in ('numpy', 'scipy', 'matplotlib', 'pydantic') if m in sys.modules])")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_name_is_there_and_listed():
    assert set(ppmcal.__all__) <= set(dir(ppmcal))
    assert all(getattr(ppmcal, name) is not None for name in ppmcal.__all__)
    with pytest.raises(AttributeError, match="no attribute 'identfy'"):
        ppmcal.identfy    # noqa: B018


def documented(text, parameters):
    """Return what a function's docstring lacks."""
    lacking = [p for p in parameters if f"{p}:" not in text and f"{p}`" not in text]
    return lacking + [] if "Raises:" in text else [*lacking, "Raises:"]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_function_says_what_it_takes_and_raises(name):
    function = getattr(ppmcal, name)
    text = inspect.getdoc(function) or ""
    parameters = list(inspect.signature(function).parameters)
    if "Arguments as for" in text:
        parameters = []
    assert not documented(text, parameters)


def results():
    """Return all classes of results."""
    found = {kind for kind in map(result_of, functions()) if kind and issubclass(kind, Result)}
    return sorted(found, key=lambda c: c.__name__)


def test_every_result_documents_what_it_holds():
    assert results()
    for cls in results():
        assert cls.COMMAND and cls.TABLE.endswith(".csv")
        own = [n for n, v in vars(cls).items() if (not n.startswith("_") and
               isinstance(v, property)) or (inspect.isfunction(v) and not n.startswith("_"))]
        for name in own:
            assert inspect.getdoc(getattr(cls, name)), f"{cls.__name__}.{name}"
        fields = [n for n in cls.__annotations__ if not n.isupper() and n[0] != "_"]
        text = cls.__doc__ or ""
        for name in fields:
            assert name in text or name in ("png", "name"), f"{cls.__name__}.{name}"


# ---------------------------------------------------------------- what it takes


def test_a_data_frame_is_as_good_as_its_file(stage, session, folder):
    """Files, a frame, a mapping of columns: the same numbers."""
    sidecar = yaml.safe_load((folder / "measurements.yaml").read_text())
    frame = pd.read_csv(folder / "measurements.csv")
    (filed,) = ppmcal.read_data(stage, folder / "measurements.csv")
    columns = {c: frame[c].to_numpy() for c in frame.columns}
    for table in (frame, columns, session.to_frame()):
        (data,) = ppmcal.read_data(stage, table, sidecar=sidecar)
        np.testing.assert_array_equal(data.q, filed.q)
        np.testing.assert_array_equal(data.position, filed.position)
        assert data.sigma_position.tolist() == filed.sigma_position.tolist()
    by_path = ppmcal.read_data(stage, frame, sidecar=folder / "measurements.yaml")
    np.testing.assert_array_equal(by_path[0].q, filed.q)


@pytest.mark.slow
def test_a_sidecar_may_end_in_yml(stage, folder, tmp_path):
    (tmp_path / "run.csv").write_bytes((folder / "measurements.csv").read_bytes())
    (tmp_path / "run.yml").write_bytes((folder / "measurements.yaml").read_bytes())
    fit = ppmcal.identify(stage, tmp_path / "run.csv")
    assert str(tmp_path / "run.yml") in fit.provenance["inputs"]


def test_a_file_may_have_its_sidecar_in_memory(stage, folder, tmp_path):
    """What is not a file is no input of the result."""
    (tmp_path / "run.csv").write_bytes((folder / "measurements.csv").read_bytes())
    sidecar = yaml.safe_load((folder / "measurements.yaml").read_text())
    fit = ppmcal.identify(stage, ppmcal.read_data(stage, tmp_path / "run.csv", sidecar=sidecar))
    inputs = [p for p in fit.provenance["inputs"] if p not in stage.inputs]
    assert inputs == [str(tmp_path / "run.csv")]


def test_without_pandas_a_table_is_a_dict(session, monkeypatch):
    frame = session.to_frame()
    monkeypatch.setitem(sys.modules, "pandas", None)
    columns = session.to_frame()
    assert list(columns) == list(frame.columns)
    np.testing.assert_array_equal(columns["q_leg1"], frame["q_leg1"])


def test_units_of_a_table_are_said_once(stage, session, folder):
    sidecar = yaml.safe_load((folder / "measurements.yaml").read_text())
    frame = session.to_frame()
    lengths = [c for c in frame.columns if c in ("x", "y") or c.startswith("q_")]
    metres = frame.assign(**{c: frame[c] / 1000.0 for c in lengths})
    sigma = sidecar["instrument"]["sigma"]
    in_m = {**sidecar, "units": {"length": "m", "angle": "deg"}, "instrument": {
        **sidecar["instrument"], "sigma": {**sigma, "position": sigma["position"] / 1000.0}}}
    (one,), (other,) = (ppmcal.read_data(stage, t, sidecar=s)
                        for t, s in ((frame, sidecar), (metres, in_m)))
    np.testing.assert_allclose(one.position, other.position, rtol=1e-12, equal_nan=True)
    np.testing.assert_allclose(one.q, other.q, rtol=1e-12)


def test_arrays_go_into_kinematics_and_back(stage):
    home = stage.home_pose[[0, 1, 5]] * np.array([1e3, 1e3, np.degrees(1.0)])
    wanted = home + np.array([[0.0, 0.0, 0.0], [5.0, -3.0, 2.0]])
    there = ppmcal.inverse(stage, wanted)
    factors = np.array([f for f, _ in stage.joint_units])
    back = ppmcal.forward(stage, there.q / factors)
    np.testing.assert_allclose(back.pose[:, [0, 1]] * 1e3, wanted[:, :2], rtol=1e-12)
    np.testing.assert_allclose(np.degrees(back.pose[:, 5]), wanted[:, 2], rtol=1e-9, atol=1e-9)


REFUSED = {
    "no sidecar": (lambda m: ppmcal.read_data(m, {"q_leg1": [1.0]}), "needs its sidecar"),
    "another width": (lambda m: ppmcal.inverse(m, [[1.0, 2.0]]), "array of shape"),
    "uneven columns": (lambda m: ppmcal.inverse(m, {"x": [1, 2], "y": [1], "rz": [0]}), "rows"),
    "no rows": (lambda m: ppmcal.inverse(m, {"x": [], "y": [], "rz": []}), "no rows"),
    "a word": (lambda m: ppmcal.inverse(m, {"x": ["a"], "y": [0], "rz": [0]}), "x"),
    "a number for a machine": (lambda m: ppmcal.load(3), "given as int"),
    "a number for data": (lambda m: ppmcal.identify(m, [3]), "given as int"),
    "a method that is none": (lambda m: ppmcal.identify(m, [], method="magic"), "magic"),
    "a mixture": (lambda m: ppmcal.identify(m, [], method="gcv", prior="flat"), "--prior flat"),
    "a kind that is none": (lambda m: ppmcal.diagnose(m, [], kinds=["magic"]), "magic"),
    "a table that is none": (lambda m: ppmcal.inverse(m, [[0, 0, 0]]).to_frame("x.csv"),
                             "kinematics.csv"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_is_refused_with_a_reason(stage, case):
    call, words = REFUSED[case]
    with pytest.raises(ppmcal.PpmcalError, match=words):
        call(stage)


# ---------------------------------------------------------------- what it returns


@pytest.mark.slow
def test_a_result_shows_itself(fit, session):
    for result in (fit, session):
        assert len(repr(result)) < 200
        shown = result._repr_html_()
        assert shown.count("<table>") == 1 and len(shown) < 30_000
    assert list(fit.to_frame().columns)[:3] == ["name", "nominal", "value"]
    assert len(fit.to_frame("residuals.csv")) == sum(len(d) for d in session.data)
    assert fit.covariance.shape == (len(fit.columns),) * 2
    assert fit.converged and not fit.findings


def test_html_is_escaped(stage):
    odd = ppmcal.inverse(stage, {"x": [0.0], "y": [0.0], "rz": [0.0], "<b>": ["<script>"]})
    assert "<script>" not in odd._repr_html_()


@pytest.mark.slow
def test_saved_is_what_the_command_writes(fit, folder, tmp_path):
    """Same tables and the same machine from the files, by the command and by the function."""
    mech = ppmcal.shipped("3-RPR")
    command("identify", mech, folder / "measurements.csv", "--out", tmp_path / "c", expect=0)
    again = ppmcal.identify(mech, folder / "measurements.csv")
    again.save(tmp_path / "f")
    assert sorted(tree(tmp_path / "c")) == sorted(tree(tmp_path / "f"))
    for name in ("parameters.csv", "residuals.csv"):
        assert (tmp_path / "c" / name).read_text() == (tmp_path / "f" / name).read_text()
    one, other = (json.loads((tmp_path / d / "identification.json").read_text()) for d in "cf")
    assert one.pop("provenance")["command"].startswith("ppmcal identify")
    assert other.pop("provenance")["command"] == "ppmcal.identify()"
    assert one == other
    np.testing.assert_array_equal(again.covariance, fit.covariance)


@pytest.mark.slow
def test_compensation_in_memory_is_that_from_files(stage, fit, folder, tmp_path):
    again = ppmcal.identify(stage, folder / "measurements.csv")
    again.save(tmp_path / "fit")
    targets = {"x": [0.0, 4.0], "y": [0.0, -3.0], "rz": [0.0, 1.0]}
    here = ppmcal.compensate(again, targets)
    filed = ppmcal.compensate(tmp_path / "fit" / "identified.yaml", targets)
    np.testing.assert_allclose(here.compensation.q, filed.compensation.q, rtol=1e-12)
    np.testing.assert_allclose(here.compensation.sigma_position,
                               filed.compensation.sigma_position, rtol=1e-6)


def test_a_table_of_targets_is_read_once(stage, fit, tmp_path, monkeypatch):
    read = []
    monkeypatch.setattr(ppmcal_tables, "read_bytes", lambda path: read.append(path.name) or
                        path.read_bytes())
    poses, joints = tmp_path / "poses.csv", tmp_path / "joints.csv"
    poses.write_text("label,y,x,rz\none,0,0,0\ntwo,-3,4,1\n")
    found = ppmcal.compensate(fit, poses)
    assert read == ["poses.csv"]
    assert found.targets[0] == ("label", "y", "x", "rz")
    assert list(found.targets[1][0]) == ["one", "two"]
    np.testing.assert_array_equal(found.targets[1][1], [0.0, -3.0])
    joints.write_text("q_leg1,q_leg2,q_leg3\n400,400,400\n")
    ppmcal.forward(stage, joints)
    ppmcal.inverse(stage, poses)
    assert read == ["poses.csv", "joints.csv", "poses.csv"]


def test_save_refuses_what_is_somebody_elses(fit, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ppmcal.BadInput, match="did not write"):
        fit.save(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]
    fit.save(tmp_path, force=True)
    assert (tmp_path / "identified.yaml").exists()


def test_a_result_never_replaces_its_inputs(stage, tmp_path):
    table = tmp_path / "kinematics.csv"
    table.write_text("x,y,rz\n230,200,0\n")
    found = ppmcal.inverse(stage, table)
    for force in (False, True):
        with pytest.raises(ppmcal.BadInput, match=r"input of this run|did not write"):
            found.save(tmp_path, force=force)
    assert table.read_text() == "x,y,rz\n230,200,0\n"


@pytest.mark.slow
def test_the_python_block_of_the_readme_runs(tmp_path, monkeypatch):
    (block,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
    monkeypatch.chdir(tmp_path)
    command("init", "6-UPS", "--out", "mine.yaml", expect=0)
    run = ppmcal.simulate("mine.yaml", "mine.scenario.yaml")
    names = {"frame": run.to_frame()}
    exec(compile(block, "README.md", "exec"), names)
    assert names["fit"].converged
    written = pd.read_csv(tmp_path / "compensated" / "commands.csv")
    assert list(written["status"]) == ["ok", "ok"]


@pytest.mark.long
def test_the_notebook_runs_and_says_what_its_text_says(capsys):
    """Every cell, in order; the hidden backlash is named and the commands are right."""
    cells = [c for c in json.loads(NOTEBOOK.read_text())["cells"] if c["cell_type"] == "code"]
    assert len(cells) == 8
    names = {}
    for cell in cells:
        source = "".join(cell["source"])
        module = ast.parse(source)
        exec(compile(module, str(NOTEBOOK), "exec"), names)
    assert names["found"].verdict == "named"
    (effect,) = names["found"].diagnosis.effects
    assert effect.kind == "backlash"
    assert names["fit"].findings and not ppmcal.check(names["stage"]).findings
    before, after = names["commands"].errors()
    assert after < 0.01 * before
    assert "without correction" in capsys.readouterr().out


def test_nothing_lies_beside_a_machine_in_memory(tmp_path, monkeypatch):
    """A calibration in the working folder is another machine's."""
    machine = yaml.safe_load(ppmcal.shipped("3-RPR").read_text())
    (tmp_path / "identification.json").write_text("of another machine")
    monkeypatch.chdir(tmp_path)
    found = ppmcal.compensate(machine, {"x": [500.0], "y": [290.0], "rz": [10.0]}, frame="base")
    assert found.knowledge is None and not found.provenance["inputs"]
    stage = ppmcal.load(machine)
    assert pose_uncertainty(stage, np.zeros((1, 6))) == UNKNOWN
