"""A batch: the bytes of each command alone, whatever runs it and however often it was stopped."""

import importlib.util
import json
import shlex
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from helpers.commands import EXECUTABLE, ppmcal, tree
from helpers.fleets import DESIGN, write_fleet

import ppmcal as face
from ppmcal.commands.batch import run as batch_run
from ppmcal.commands.batch.manifest import CampaignJob
from ppmcal.commands.batch.run import KEPT
from ppmcal.commands.face import carry_out
from ppmcal.io.results.batch import CampaignRecord
from ppmcal.io.yaml import dump_yaml, read_yaml
from ppmcal.store.folder import RECORD
from ppmcal.store.inputs import digest_of
from ppmcal.store.stage import INSIDE, NEW
from ppmcal.store.transaction import write_journal

pytestmark = pytest.mark.skipif(importlib.util.find_spec("pyarrow") is None,
                                reason="writes Parquet")


@pytest.fixture(scope="module")
def fleet(tmp_path_factory):
    """Three machines on two dates, the last of which has changed; and a file that is missing."""
    manifest = write_fleet(tmp_path_factory.mktemp("fleet"))
    content = read_yaml(manifest)
    content["campaigns"].append({"machine": "m09", "date": "2026-01-10", "data": "gone.csv"})
    manifest.write_text(dump_yaml(content))
    return manifest


@pytest.fixture(scope="module")
def alone(fleet):
    """The results of the batch in one process."""
    out = fleet.parent / "alone"
    run = ppmcal("batch", fleet, "--out", out, "--cores", 1, "--json", expect=1)
    return out, run.json


def copied(fleet, folder):
    """Return the manifest in a copy of its folder, and the folder for its results there."""
    shutil.copytree(fleet.parent, folder / "fleet", ignore=shutil.ignore_patterns("alone"))
    return folder / "fleet" / fleet.name, folder / "fleet" / "alone"


def results(out):
    """Return the files of all campaigns that have some: below machine, date and command."""
    return {k: v for k, v in tree(out).items() if k.count("/") == 3 and not k.startswith(".")}


def table(out):
    from pyarrow import parquet

    return parquet.read_table(out / "campaigns.parquet").to_pylist()


@pytest.mark.long
def test_each_campaign_has_the_bytes_of_its_command_alone(fleet, alone, tmp_path):
    out, _ = alone
    wanted = {k: v for k, v in tree(out).items() if k.startswith("m02/")}
    lines = [r["run"] for r in table(out) if r["what"] == "campaign" and r["exit_code"] < 2]
    assert len(lines) == 9      # six identifications, three comparisons
    shutil.move(out, tmp_path / "moved")
    try:
        for line in (line for line in lines if "m02" in line):
            ppmcal(*shlex.split(line)[1:], cwd=fleet.parent)
        again = tree(out)
    finally:
        shutil.rmtree(out)
        shutil.move(tmp_path / "moved", out)
    assert again == wanted      # the hidden record of each folder too


@pytest.mark.slow
def test_a_failed_campaign_is_reported_and_the_rest_finished(alone):
    out, said = alone
    ends = {c["campaign"]: c for c in said["campaigns"]}
    lost = ends.pop("m09/2026-01-10/identify")
    assert lost["exit_code"] == 2
    assert "gone.csv: there is no such file" in lost["message"]
    assert all(c["exit_code"] < 2 for c in ends.values())
    assert "gone.csv" in (out / "batch.html").read_text()
    row, = (r for r in table(out) if r["campaign"] == "m09/2026-01-10/identify")
    assert (row["exit_code"], row["status"]) == (2, "failed")
    assert not (out / "m09").exists()


@pytest.mark.slow
def test_the_table_has_what_the_commands_wrote(alone):
    out, _ = alone
    rows = [r for r in table(out) if r["campaign"] == "m01/2026-01-10/identify"]
    record = json.loads((out / "m01/2026-01-10/identify/identification.json").read_text())
    written = {p["name"]: (p["value"], p.get("sigma"), p["unit"]) for p in record["parameters"]}
    assert {r["name"]: (r["value"], r["sigma"], r["unit"]) for r in rows
            if r["what"] == "parameter"} == written
    rms = {r["parameter"]: r["value"] for r in rows
           if (r["what"], r["name"]) == ("error", "position")}
    assert rms == {s: record["residual"][s]["position"]["rms"]
                   for s in ("before", "after", "holdout")}


@pytest.mark.slow
def test_what_changed_since_last_time_is_named_and_nothing_else(alone):
    out, said = alone
    verdicts = {c["machine"]: c["verdict"] for c in said["campaigns"] if c["command"] == "compare"}
    assert verdicts == {"m00": "unchanged", "m01": "unchanged", "m02": "changed"}
    change, *more = (r for r in table(out) if r["what"] == "change")
    assert not more
    assert change["name"] == "leg2.base.point.x"
    assert abs(change["value"] - 0.4) < 4.0 * change["sigma"]
    assert "changed since last time: m02" in (out / "batch.html").read_text()


@pytest.mark.slow
def test_nothing_is_done_twice(fleet, alone):
    out, said = alone
    before = {p: p.stat().st_mtime_ns for p in out.rglob("*.json") if "m09" not in str(p)
              and p.parent != out}
    again = ppmcal("batch", fleet, "--out", out, "--cores", 1, "--json", expect=1).json
    assert len(again["finished_before"]) == 9
    assert again["campaigns"] == said["campaigns"]
    assert {p: p.stat().st_mtime_ns for p in before} == before


@pytest.mark.long
def test_workers_of_a_cluster_give_the_same_bytes(fleet, alone, tmp_path):
    distributed = pytest.importorskip("distributed")
    manifest, out = copied(fleet, tmp_path)
    shutil.rmtree(manifest.parent / "runs" / "m00")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True,
                                  dashboard_address=None, protocol="tcp",
                                  local_directory=str(tmp_path)) as cluster:
        assert cluster.scheduler_address.startswith("tcp://")
        ppmcal("batch", manifest, "--out", out, "--scheduler", cluster.scheduler_address, expect=1)
        with distributed.Client(cluster) as client:
            busy = client.run(_campaigns_run)
    assert results(out) == {k: v for k, v in results(alone[0]).items() if k[:3] != "m00"}
    assert sum(n > 0 for n in busy.values()) == 2


def _campaigns_run():
    """Return whether this worker has run campaigns."""
    return int("ppmcal.commands.batch.run" in sys.modules)


@pytest.mark.long
def test_a_killed_batch_goes_on_in_two_processes_with_the_same_bytes(fleet, alone, tmp_path):
    manifest, out = copied(fleet, tmp_path)
    kept = out / KEPT
    run = subprocess.Popen([*EXECUTABLE, "batch", str(manifest), "--out", str(out), "--cores", "1"],
                           stderr=subprocess.DEVNULL)
    end = time.monotonic() + 60.0
    while len(list(kept.rglob("*.json"))) < 3 and time.monotonic() < end:
        time.sleep(0.01)
    run.send_signal(signal.SIGKILL)
    run.wait()
    assert not (out / "campaigns.parquet").exists()
    sound = [CampaignRecord.read(p) for p in kept.rglob("*.json")]
    done = {r.campaign for r in sound if not r.failed}
    assert 0 < len(done) < 9
    again = ppmcal("batch", manifest, "--out", out, "--cores", 2, "--json", expect=1).json
    assert set(again["finished_before"]) == done
    assert [(c["campaign"], c["exit_code"]) for c in again["campaigns"]] == [
        (c["campaign"], c["exit_code"]) for c in alone[1]["campaigns"]]
    assert results(out) == results(alone[0])


FIRST, SECOND = "m00/2026-01-10/identify", "m00/2026-03-12/identify"
"""The two campaigns of one machine."""


def finished_before(folder):
    return set(ppmcal("batch", folder / "fleet.yaml", "--out", folder / "out", "--cores", 1,
                      "--json").json["finished_before"])


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """One machine's files and, in ``out``, what a batch made of them."""
    folder = tmp_path_factory.mktemp("small") / "one"
    write_fleet(folder, machines=1, rows=20)
    assert finished_before(folder) == set()
    return folder


@pytest.fixture
def one(tmp_path):
    """Return a folder of the same machine's files alone, without results."""
    write_fleet(tmp_path, machines=1, rows=20)
    return tmp_path


@pytest.fixture
def done(made, tmp_path):
    """Return a folder of that machine's files and results."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    return tmp_path


def test_campaigns_with_points_in_their_names_have_notes_of_their_own(tmp_path):
    at = batch_run.BatchPlace(str(tmp_path), "out", False)
    names = ("m/2026-01-10/fit.1", "m/2026-01-10/fit.2", "m/2026-01-10/fit")
    jobs = [CampaignJob(n, "m", "2026-01-10", "", "identify", "m.yaml", ()) for n in names]
    notes = [at.kept(j) for j in jobs]
    assert len({n.with_suffix(".part") for n in notes}) == len(set(notes)) == 3
    assert {n.suffix for n in notes} == {".json"}


@pytest.mark.long
def test_what_is_new_is_run_again(done):
    manifest, out = done / "fleet.yaml", done / "out"
    compared = "m00/2026-03-12/compare-identify"
    assert finished_before(done) == {FIRST, SECOND, compared}
    # another measurement
    data = done / "runs/m00/2026-03-12/measurements.csv"
    lines = data.read_text().splitlines(keepends=True)
    data.write_text("".join(lines[:-1]))
    assert finished_before(done) == {FIRST}
    # another sidecar
    sidecar = data.with_suffix(".yaml")
    sidecar.write_text(sidecar.read_text() + "# by hand\n")
    assert finished_before(done) == {FIRST}
    # another option
    content = read_yaml(manifest)
    content["options"]["identify"] = {"seed": 1}
    manifest.write_text(dump_yaml(content))
    assert finished_before(done) == set()
    # a result that is gone
    (out / FIRST / "residuals.csv").unlink()
    assert finished_before(done) == {SECOND}
    assert (out / FIRST / "residuals.csv").exists()
    # a result that is not known, as of a run that an older version was killed in
    kept = (out / KEPT / SECOND).with_suffix(".json")
    kept.write_text(CampaignRecord.read(kept).changed(outputs={}).text())
    assert finished_before(done) == {FIRST}


@pytest.mark.long
def test_a_measurement_that_comes_while_its_campaign_runs_is_new(one, monkeypatch):
    manifest, out = one / "fleet.yaml", one / "out"
    data = one / "runs/m00/2026-03-12/measurements.csv"
    was = digest_of(data)

    def slow(spec, asked):
        found = carry_out(spec, asked)
        if "2026-03-12" in asked.data[0] and digest_of(data) == was:
            data.write_text("".join(data.read_text().splitlines(keepends=True)[:-1]))
        return found

    monkeypatch.setattr(batch_run, "carry_out", slow)
    found = face.batch(manifest, out, cores=1)
    name = str(data.relative_to(one))
    kept = (out / KEPT / SECOND).with_suffix(".json")
    assert CampaignRecord.read(kept).inputs[name] == was
    assert found.provenance["inputs"][str(one / name)] == was
    assert not any(KEPT in p for p in found.provenance["inputs"])     # its own notes
    again = face.batch(manifest, out, cores=1)
    assert again.done_before == (FIRST,)
    assert again.provenance["inputs"][str(one / name)] == digest_of(data) != was


@pytest.mark.long
def test_results_that_were_edited_are_not_replaced(done):
    manifest, out = done / "fleet.yaml", done / "out"
    own = out / FIRST / "parameters.csv"
    own.write_text("mine\n")
    said = {c["campaign"]: c for c in ppmcal(
        "batch", manifest, "--out", out, "--cores", 1, "--json", expect=1).json["campaigns"]}
    assert said[FIRST]["exit_code"] == 2
    assert "was edited since" in said[FIRST]["message"]
    assert own.read_text() == "mine\n"
    ppmcal("batch", manifest, "--out", out, "--cores", 1, "--force")
    assert own.read_text() != "mine\n"


@pytest.mark.long
def test_a_mixture_that_a_killed_run_left_is_replaced(done):
    """Where files are moved one by one, some are new and some are old after a kill in between."""
    out = done / "out"
    good = results(out)
    place, stage = out / FIRST, out / FIRST / INSIDE
    record = json.loads((place / RECORD).read_text())
    (stage / NEW).mkdir(parents=True)
    for name in ("parameters.csv", "residuals.csv"):
        (stage / NEW / name).write_text("of the killed run")
        record["files"][name]["sha256"] = digest_of(stage / NEW / name)
    (stage / NEW / RECORD).write_text(json.dumps(record))
    write_journal(stage, ["parameters.csv", "residuals.csv", RECORD], [])
    (stage / NEW / "parameters.csv").replace(place / "parameters.csv")
    assert finished_before(done) == {SECOND}
    assert results(out) == good
    assert not stage.exists()


@pytest.mark.slow
def test_what_a_run_could_not_take_away_is_swept(tmp_path):
    """The campaign is finished: its command is not run again."""
    write_fleet(tmp_path, machines=1, dates=[FIRST.split("/")[1]], rows=20)
    assert finished_before(tmp_path) == set()
    out = tmp_path / "out"
    left = (out / FIRST).with_name(".ppmcal.identify.part")
    left.mkdir()
    (left / "lock").touch()
    part = (out / KEPT / FIRST).with_suffix(".part")
    part.touch()
    assert finished_before(tmp_path) == {FIRST}
    assert not left.exists() and not part.exists()


@pytest.mark.slow
def test_a_fault_of_the_program_ends_one_campaign_alone(one, monkeypatch):

    def breaks(spec, asked):
        if "2026-01-10" in asked.data[0]:
            raise ZeroDivisionError("by chance")
        return carry_out(spec, asked)

    monkeypatch.setattr(batch_run, "carry_out", breaks)
    found = face.batch(one / "fleet.yaml", one / "out", cores=1)
    ends = {r.campaign: r for r in found.records}
    assert ends[FIRST].exit_code == 3
    assert "ZeroDivisionError: by chance" in ends[FIRST].message
    assert not ends[SECOND].failed
    assert set(ends) == {FIRST, SECOND}     # nothing to compare with
    assert found.has_findings


@pytest.mark.long
def test_a_diagnosis_and_a_compensation_are_run_too(done):
    manifest = done / "fleet.yaml"
    (done / "targets.csv").write_text("x,y,rz\n500,290,10\n510,280,12\n")
    content = read_yaml(manifest)
    content["campaigns"] = [
        {"data": "runs/{machine}/{date}/*.csv", "command": "diagnose",
         "options": {"seed": 1, "kind": ["backlash", "gain"]}},
        {"machine": "m00", "date": "2026-03-12", "command": "compensate", "data": "targets.csv",
         "model": f"out/{SECOND}/identified.yaml", "options": {"path": False}}]
    manifest.write_text(dump_yaml(content))
    found = face.batch(manifest, done / "more", cores=1)
    assert [r.command for r in found.records] == ["diagnose", "diagnose", "compensate"]
    assert not found.failed
    q = found.records[-1].of_kind("error")
    assert [x.parameter for x in q] == ["before", "after"]
    commands = (done / "more/m00/2026-03-12/compensate/commands.csv").read_bytes()
    ppmcal(*found.records[-1].typed.split()[1:-1], "alone", cwd=done)
    assert (done / "alone/commands.csv").read_bytes() == commands
    # the knowledge beside the model is an input, though nobody named it
    known = done / "out" / SECOND / "identification.json"
    known.write_text(known.read_text() + "\n")
    assert set(face.batch(manifest, done / "more", cores=1).done_before) == {
        r.campaign for r in found.records[:2]}


@pytest.mark.long
def test_what_all_units_share_is_the_designs(tmp_path):
    manifest = write_fleet(tmp_path, machines=8, dates=("2026-01-10",), own=0.03, rows=24)
    found = face.batch(manifest, tmp_path / "out", cores=1)
    page = found.files()["batch.html"]
    lead = page[:page.index("</header>")]
    (name, size), = DESIGN.items()
    assert "so by design: " in lead
    assert name in lead
    errors = [q.value - q.nominal for r in found.records for q in r.of_kind("parameter")
              if q.name == name]
    # the prior keeps a part of it
    assert 0.4 * size < np.mean(errors) < size
