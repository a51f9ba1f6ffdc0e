"""What only callers from Python meet: seeds, masks, paths, threads, stubs."""

import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from generators import stub

import ppmcal
from ppmcal.commands import functions
from ppmcal.commands.result import Result
from ppmcal.store.provenance import _function, _libraries, environment

BENCH = ppmcal.shipped("3-RPR")


@pytest.fixture(scope="module")
def run():
    return ppmcal.simulate(BENCH, ppmcal.shipped("3-RPR", scenario=True), seed=3)


@pytest.fixture
def two_threads():
    found = [(_function(lib, "get_num_threads"), _function(lib, "set_num_threads"))
             for lib in _libraries("numpy")]
    before = [get() for get, _ in found]
    for _, put in found:
        put(2)
    if environment().get("blas_threads") != 2:
        pytest.skip("NumPy's BLAS is another, or has one thread")
    yield
    for (_, put), threads in zip(found, before, strict=True):
        put(threads)


def test_results_are_written_in_one_thread_as_they_were_found(tmp_path, two_threads):
    class Own(Result):
        COMMAND, TABLE = "plan", ""

        def files(self):
            return {"plan.json": json.dumps(environment())}

    Own({}, ()).save(tmp_path / "out")
    assert json.loads((tmp_path / "out" / "plan.json").read_text())["blas_threads"] == 1


@pytest.mark.slow
def test_a_validation_records_the_calibration_that_it_asked(run, tmp_path):
    run.save(tmp_path / "day")
    data = tmp_path / "day" / "measurements.csv"
    ppmcal.identify(BENCH, data).save(tmp_path / "fit")
    found = ppmcal.validate(tmp_path / "fit", data, against=[tmp_path / "fit"])
    assert str(tmp_path / "fit" / "identification.json") in found.provenance["inputs"]
    assert any("do not test it" in f for f in found.findings)


@pytest.mark.parametrize("seed", [-1, 2 ** 53 + 1, 1.5, "one", True])
def test_a_seed_is_one_that_its_record_can_hold(run, seed):
    with pytest.raises(ppmcal.BadInput, match="is not a seed"):
        ppmcal.identify(BENCH, run.data, seed=seed)


@pytest.mark.slow
def test_the_largest_seed_is_read_back(run, tmp_path):
    ppmcal.identify(BENCH, run.data, seed=2 ** 53).save(tmp_path / "fit")
    assert ppmcal.make_report(tmp_path / "fit")


@pytest.mark.parametrize("call", [ppmcal.identify, ppmcal.diagnose, ppmcal.validate])
def test_no_measurements_are_refused(call):
    with pytest.raises(ppmcal.BadInput, match="there are no measurements"):
        call(BENCH, [])
    assert ppmcal.check(BENCH, []).rank >= 0


def test_what_is_masked_is_not_measured():
    def told(poses):
        return np.isfinite(ppmcal.inverse(BENCH, poses).q).all(axis=1).tolist()

    x = np.ma.masked_array([500.0, 510.0, 1e6], mask=[False, False, True])
    table = {"x": x, "y": [280.0, 270.0, 260.0], "rz": [20.0, 21.0, 22.0]}
    assert told(table) == [True, True, False]
    block = np.ma.masked_array([[500.0, 280.0, 20.0], [1e6, 270.0, 21.0]],
                               mask=[[0, 0, 0], [1, 0, 0]])
    assert told(block) == [True, False]


LONG = "x" * 5000


@pytest.mark.parametrize("call", [
    lambda run, tmp: ppmcal.load(LONG), lambda run, tmp: ppmcal.read_data(BENCH, f"{LONG}.csv"),
    lambda run, tmp: ppmcal.identify(LONG, run.data),
    lambda run, tmp: ppmcal.identify(BENCH, f"{LONG}.csv"),
    lambda run, tmp: ppmcal.inverse(BENCH, f"{LONG}.csv"),
    lambda run, tmp: ppmcal.identify(BENCH, run.data, start=LONG),
    lambda run, tmp: run.save(tmp / LONG)], ids=range(7))
def test_an_over_long_path_is_refused(call, run, tmp_path):
    with pytest.raises(ppmcal.BadInput) as refused:
        call(run, tmp_path)
    assert len(str(refused.value)) < 12_000


@pytest.mark.parametrize("call", [
    lambda tool: ppmcal.sensitivity(BENCH, tool=tool).record,
    lambda tool: ppmcal.forward(BENCH, [[400.0, 400.0, 400.0]], tool=tool).pose,
    lambda tool: ppmcal.tolerances(BENCH, accuracy=1.0, machines=20, tool=tool).record])
@pytest.mark.slow_cases("<lambda>0", "<lambda>2")
def test_a_tool_is_a_text_or_its_numbers(call):
    one, two = call("10,-20"), call([10, -20.0])
    if isinstance(one, np.ndarray):
        np.testing.assert_array_equal(one, two)
    else:
        assert {k: v for k, v in one.entries(whole=True).items() if k != "provenance"} == {
            k: v for k, v in two.entries(whole=True).items() if k != "provenance"}
    with pytest.raises(ppmcal.BadInput, match="is not a point"):
        call([1.0])


@pytest.mark.parametrize("call", [
    lambda given: ppmcal.tolerances(BENCH, accuracy=given),
    lambda given: ppmcal.plan(BENCH, accuracy=given),
    lambda given: ppmcal.sensitivity(BENCH, sigmas=given)])
def test_a_number_with_a_unit_is_refused(call):
    for given in ("0.1 mm", [0.1, 0.2]):
        with pytest.raises(ppmcal.BadInput, match=r"is not a number.*without a unit"):
            call(given)


def test_type_checkers_see_what_there_is():
    assert (Path(ppmcal.__file__).parent / "py.typed").is_file()
    assert stub.TARGET.read_text(encoding="utf-8") == stub.stub(), (
        "run `make generated`")


def test_the_names_are_those_of_the_commands():
    assert sorted(ppmcal.__all__) == list(ppmcal.__all__) == sorted(
        [*ppmcal._HOME, *functions()])


def test_functions_go_to_other_processes():
    assert all(pickle.loads(pickle.dumps(f)) is f for f in (ppmcal.identify, ppmcal.forward))
