"""Results made again: the same byte by byte, or told where not; nothing else is run or written."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.commands import ppmcal, ppmcal_process, tree
from helpers.shared import shared_demo
from torture.desk import COMMANDS, make_desk

import ppmcal as face
from ppmcal.commands import command
from ppmcal.commands.compare import run as compare_command
from ppmcal.errors import BadInput
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.yaml import dump_yaml
from ppmcal.store import provenance
from ppmcal.store.differences import compared
from ppmcal.store.folder import RECORD, read_record

WRITING = {
    "may": "simulate mine.yaml mine.scenario.yaml --seed 5",
    "identified": "identify stiff.yaml run1.csv",
    "identified-may": "identify mine.yaml may/measurements.csv",
    "compensated": "compensate identified targets.csv",
    "kin": "kinematics inverse mine.yaml poses.csv --pictures",
    "imported": "import klipper printer.cfg",
    "sens": "sensitivity mine.yaml --home-only",
    "validated": "validate identified run2.csv --against identified-may",
    "compared": "compare identified identified-may",
    "diagnosed": "diagnose mine.yaml run1.csv --kind backlash",
    "tol": "tolerances mine.yaml --accuracy 0.2 --machines 50",
    "stiffness": "stiffness stiff.yaml",
    "ws": "workspace mine.yaml --grid x=-20:20:3,y=-20:20:3",
    "plan": "plan mine.yaml --count 12",
    "exported": "export grid identified --poses poses.csv",
    "batch": "batch fleet.yaml --cores 1",
    "reported": "report identified compensated compared validated diagnosed kin may plan tol ws",
}
"""Folder -> the command that writes it; later ones read what earlier ones wrote."""
QUICK = ("may", "identified", "compensated", "kin", "imported", "sens")
WRITING |= {f"{name}-of-desk": f"{name} {words.replace('{desk}/', '')}"
            for name, words in COMMANDS.items() if command(name).recorded
            and name not in {line.split()[0] for line in WRITING.values()}}


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with what the quick commands read, and what they wrote."""
    folder = tmp_path_factory.mktemp("desk") / "files"
    make_desk(folder)
    for name in QUICK:
        write(folder, name)
    return folder


def write(folder: Path, name: str) -> None:
    if not (folder / name).exists():
        run = ppmcal(*WRITING[name].split(), "--out", name, "-q", cwd=folder)
        assert run.code in (0, 1), run


def copied(desk: Path, folder: Path, *names: str) -> Path:
    """Return a copy of the desk's own files and of some folders of results."""
    shutil.copytree(desk, folder / "desk", ignore=lambda top, held: [
        n for n in held if Path(top, n).is_dir() and n not in names and Path(top) == desk])
    return folder / "desk"


def checked(desk: Path, *words: object, code: int, cwd: Path | None = None):
    """Run ``verify --json``, and see that it writes nothing."""
    before = tree(desk)
    found = ppmcal("verify", *words, "--json", cwd=cwd or desk, expect=code).json
    assert tree(desk) == before
    assert found["exit_code"] == code
    return found["runs"]


@pytest.mark.slow
@pytest.mark.long_cases(
    "certify-of-desk", "compared", "diagnosed", "figures-of-desk", "identified-may", "plan",
    "reported", "stiffness", "tol", "validated", "ws")
@pytest.mark.parametrize("name", [
    n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in WRITING])
def test_what_a_command_wrote_is_made_again_byte_by_byte(desk: Path, name: str) -> None:
    for earlier in WRITING:
        if earlier in WRITING[name].replace("/", " ").split():
            write(desk, earlier)
    write(desk, name)
    runs = checked(desk, name, code=0)
    assert [r["status"] for r in runs] == ["same"] * len(runs)
    there = {f for f in os.listdir(desk / name) if not f.startswith(".") and f != "hexapod-07"}
    assert {f["file"] for f in runs[0]["files"]} == there
    assert not runs[0]["environment"]
    assert len(runs) == (2 if name == "batch" else 1)


@pytest.mark.long
def test_the_folders_of_the_demo(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Its diagnosis, half of its time, is not made again: one is above."""
    demo = shared_demo(tmp_path_factory)
    folders = [f for f in sorted((demo / "demo-results").iterdir()) if f.is_dir()]
    runs = checked(demo, *(f.relative_to(demo) for f in folders if f.name != "diagnosed"), code=0)
    assert {r["command"] for r in runs} == {"identify", "compensate", "kinematics", "simulate",
                                            "sensitivity", "plan", "report"}
    assert set(read_record(demo / "demo-results" / "diagnosed").runs) == {"diagnose"}


@pytest.mark.slow
def test_the_record_names_all_that_decides_a_result(desk: Path) -> None:
    source = json.loads((desk / "identified" / "identification.json").read_text())["provenance"]
    assert set(source["inputs"]) == {"stiff.yaml", "mine.yaml", "run1.csv", "run1.yaml"}
    assert all(len(s) == 64 for s in source["inputs"].values())
    assert source["function"] == "identify.identify"
    assert source["options"] == {
        "mechanism": "stiff.yaml", "data": ["run1.csv"], "method": "prior", "prior": "tolerances",
        "damping": 0.9, "iterations": None, "free": [], "holdout": 0.2, "leave_out": "",
        "sigma": "stated", "start": None, "keep": False, "keep_outliers": False, "seed": 0}
    assert {"python", "numpy", "scipy", "numba", "system", "machine", "cpu", "blas"} <= set(
        source["environment"])
    text = json.dumps(source)
    assert os.uname().nodename not in text or len(os.uname().nodename) < 5
    assert str(desk) not in text


@pytest.mark.slow
def test_an_edited_number_is_told_with_its_place(desk: Path, tmp_path: Path) -> None:
    own = copied(desk, tmp_path, "identified")
    path = own / "identified" / "parameters.csv"
    lines = path.read_text().split("\n")
    column = lines[0].split(",").index("value")
    cells = lines[3].split(",")
    was, cells[column] = cells[column], repr(float(cells[column]) + 0.01)
    path.write_text("\n".join([*lines[:3], ",".join(cells), *lines[4:]]))
    run, = checked(own, "identified", code=1)
    assert run["status"] == "differs"
    wrong, = (f for f in run["files"] if f["status"] != "same")
    assert (wrong["file"], wrong["edited"], wrong["count"]) == ("parameters.csv", True, 1)
    assert wrong["worst"]["place"] == "row 3, value"
    assert (wrong["worst"]["then"], wrong["worst"]["now"]) == (cells[column], was)
    assert wrong["worst"]["size"] == pytest.approx(0.01)
    assert wrong["worst"]["unit"] in ("mm", "deg")
    said = ppmcal("verify", "identified", cwd=own, expect=1).out
    assert "edited since ppmcal wrote it" in said and "row 3, value" in said


@pytest.mark.slow
def test_an_edited_record_hides_nothing(desk: Path, tmp_path: Path) -> None:
    """Whoever forges the sum too is found by the values."""
    own = copied(desk, tmp_path, "identified")
    path, record = own / "identified" / "identified.yaml", own / "identified" / RECORD
    from ppmcal.store.inputs import digest_of

    before = digest_of(path)
    path.write_text(path.read_text().replace("name:", "name: x", 1))
    record.write_text(record.read_text().replace(before, digest_of(path)))
    run, = checked(own, "identified", code=1)
    wrong, = (f for f in run["files"] if f["status"] != "same")
    assert (wrong["file"], wrong["edited"]) == ("identified.yaml", False)


@pytest.mark.slow
def test_a_missing_file_is_told(desk: Path, tmp_path: Path) -> None:
    own = copied(desk, tmp_path, "identified")
    (own / "identified" / "residuals.csv").unlink()
    run, = checked(own, "identified", code=1)
    wrong, = (f for f in run["files"] if f["status"] != "same")
    assert (wrong["file"], wrong["worst"]["place"]) == ("residuals.csv", "is not there")


@pytest.mark.slow
def test_inputs_that_have_changed_or_gone_are_named_with_both_sums(desk: Path, tmp_path: Path
                                                                   ) -> None:
    own = copied(desk, tmp_path, "identified")
    (own / "run1.csv").write_text((own / "run1.csv").read_text() + "\n")
    (own / "mine.yaml").unlink()
    run, = checked(own, "identified", code=2)
    assert run["status"] == "input"
    wrong = {i["file"]: i for i in run["inputs"]}
    assert set(wrong) == {"run1.csv", "mine.yaml"}
    assert not wrong["mine.yaml"]["now"]
    assert len(wrong["run1.csv"]["now"]) == 64 != wrong["run1.csv"]["then"]
    said = ppmcal("verify", "identified", cwd=own, expect=2).out
    assert "run1.csv has changed" in said and "mine.yaml is not there" in said
    # found again, under another name too
    archive = tmp_path / "archive" / "deep"
    archive.mkdir(parents=True)
    shutil.copy(desk / "mine.yaml", archive / "renamed.yaml")
    shutil.copy(desk / "run1.csv", archive)
    run, = checked(own, "identified", "--inputs", tmp_path / "archive", code=0)
    assert run["status"] == "same"


@pytest.mark.slow
def test_from_another_folder_and_after_a_move(desk: Path, tmp_path: Path) -> None:
    own = copied(desk, tmp_path, "identified", "may")
    checked(own, own / "identified", own / "may", code=0, cwd=tmp_path)
    shutil.move(own / "may", tmp_path / "archived")
    checked(own, tmp_path / "archived", "--inputs", own, code=0, cwd=tmp_path)


@pytest.mark.slow
def test_absolute_paths_that_are_gone(desk: Path, tmp_path: Path) -> None:
    own = copied(desk, tmp_path)
    ppmcal("kinematics", "inverse", own / "mine.yaml", own / "poses.csv", "--out", own / "k", "-q",
           expect=0)
    shutil.move(own, tmp_path / "elsewhere")
    checked(tmp_path, tmp_path / "elsewhere" / "k", code=2)
    run, = checked(tmp_path, tmp_path / "elsewhere" / "k", "--inputs", tmp_path, code=0)
    assert run["status"] == "same"


@pytest.mark.slow
def test_without_the_hidden_record(desk: Path, tmp_path: Path) -> None:
    own = copied(desk, tmp_path, "identified")
    (own / "identified" / RECORD).unlink()
    run, = checked(own, "identified", code=0)
    assert len(run["files"]) == 4


@pytest.mark.slow
def test_results_of_python(desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = copied(desk, tmp_path)
    monkeypatch.chdir(own)
    face.inverse("mine.yaml", "poses.csv").save("k")
    assert face.verify("k").exit_code == 0
    face.inverse(face.load("mine.yaml"), "poses.csv").save("m")
    found = face.verify("m")
    assert found.exit_code == 2
    assert "in memory" in found.findings[0]


@pytest.mark.long
def test_a_refused_diagnosis(desk: Path, tmp_path: Path) -> None:
    own = copied(desk, tmp_path)
    text = (own / "run1.csv").read_text().splitlines()
    header = text[0].split(",")
    x = header.index("x")
    lines = [line.split(",") for line in text[1:]]
    for cells in lines:
        cells[x] = repr(-float(cells[x]))
    (own / "run1.csv").write_text("\n".join([text[0], *map(",".join, lines)]) + "\n")
    run = ppmcal("diagnose", "mine.yaml", "run1.csv", "--out", "d", "-q", cwd=own)
    assert run.code == 3, run
    assert (own / "d" / "diagnosis.json").exists()
    found, = checked(own, "d", code=0)
    assert found["status"] == "same"


@pytest.mark.parametrize(("name", "text"), [
    ("nothing", ""), ("words", "no results"), ("old", '{"format": "ppmcal/folder/1", "files": '
     '{"a.csv": {"command": "identify", "sha256": "00"}}}')])
def test_folders_without_a_run(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).mkdir()
    (tmp_path / name / RECORD).write_text(text)
    run = ppmcal("verify", name, cwd=tmp_path, expect=2)
    assert name in run.out + run.err
    assert "Traceback" not in run.err
    ppmcal("verify", "absent", cwd=tmp_path, expect=2)
    with pytest.raises(BadInput, match="is not a folder"):
        face.verify(tmp_path / "absent")
    with pytest.raises(BadInput, match=r"--inputs: .*absent: is not a folder"):
        face.verify(tmp_path, inputs=tmp_path / "absent")


# ---- records that somebody made up


def forged(folder: Path, **changes: object) -> Path:
    """Change what is recorded of a folder's run."""
    path = folder / RECORD
    content = json.loads(path.read_text())
    (command, run), = content["runs"].items()
    content["runs"] = {command: {**run, **changes}}
    path.write_text(json.dumps(content))
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("function", [
    "os.system", "subprocess.run", "inputs.load", "result.Result", "verify.verify", "identify", "",
    "identify.identify.__wrapped__", "../cli.main", "campaign.run_campaign", "identify.Path"])
def test_only_ppmcal_s_own_commands_are_run(desk: Path, tmp_path: Path, function: str) -> None:
    own = copied(desk, tmp_path, "kin")
    forged(own / "kin", function=function)
    run, = checked(own, "kin", code=2)
    assert run["status"] == "no record"


@pytest.mark.slow
@pytest.mark.parametrize(("changes", "status", "code"), [
    ({"options": {"mechanism": "mine.yaml", "shell": "rm -rf ."}}, "failed", 3),
    ({"options": {"which": "inverse", "mechanism": ["a"], "table": {"b": 1}}}, "failed", 3),
    ({"options": {"which": 5, "mechanism": "mine.yaml", "table": "poses.csv"}}, "failed", 3),
    ({"options": [1]}, "no record", 2), ({"inputs": {"mine.yaml": 5}}, "no record", 2),
    ({"inputs": {"/dev/zero": "0" * 64}}, "input", 2),
    ({"inputs": {"\0": "0" * 64}}, "input", 2),
    ({"options": {"which": "inverse", "mechanism": "../" * 40 + "etc/passwd",
                  "table": "poses.csv"}}, "failed", 3)])
def test_made_up_options_end_in_a_sentence(desk: Path, tmp_path: Path, changes: dict[str, object],
                                           status: str, code: int) -> None:
    own = copied(desk, tmp_path, "kin")
    forged(own / "kin", **changes)
    run, = checked(own, "kin", code=code)
    assert run["status"] == status
    said = ppmcal("verify", "kin", cwd=own, expect=code)
    assert "Traceback" not in said.err + said.out


@pytest.mark.slow
@pytest.mark.parametrize("option", ["scheduler", "cores", "progress"])
def test_a_record_does_not_say_where_to_compute(desk: Path, tmp_path: Path, option: str) -> None:
    """A scheduler sends back what Python takes for objects, and builds."""
    own = copied(desk, tmp_path, "kin")
    forged(own / "kin", function="tolerances.tolerances", options={
        "mechanism": "mine.yaml", "accuracy": 0.2, option: "tcp://127.0.0.1:9"})
    run, = checked(own, "kin", code=3)
    assert f"the option '{option}'" in run["message"]


def test_numbers_of_hundreds_of_digits_differ() -> None:
    found = compared("a.json", b'{"x": 1' + b"0" * 400 + b"}", b'{"x": 1.5}', False)
    assert found.status == "differs"


@pytest.mark.slow
@pytest.mark.parametrize("out", ["{outside}", "../outside", "../" * 40 + "outside", "mine.yaml"])
def test_a_made_up_out_writes_nowhere(desk: Path, tmp_path: Path, out: str) -> None:
    write(desk, "batch")
    own = copied(desk, tmp_path, "batch")
    outside = tmp_path / "outside"
    run = read_record(own / "batch").runs["batch"]
    forged(own / "batch", options={**run["options"], "out": out.format(outside=outside)})
    before = tree(tmp_path)
    ppmcal("verify", "batch", cwd=own)
    assert tree(tmp_path) == before
    assert not outside.exists()


@pytest.mark.slow
def test_names_of_files_in_a_record_stay_in_the_folder(desk: Path, tmp_path: Path) -> None:
    own = copied(desk, tmp_path, "kin")
    path = own / "kin" / RECORD
    content = json.loads(path.read_text())
    content["files"]["../mine.yaml"] = content["files"]["kinematics.csv"]
    path.write_text(json.dumps(content))
    run, = checked(own, "kin", code=0)
    assert "../mine.yaml" not in [f["file"] for f in run["files"]]


@pytest.mark.long
def test_nothing_is_left_in_the_temporary_folder(desk: Path, tmp_path: Path,
                                                 monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "temporary").mkdir()
    run = ppmcal_process
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    run("verify", "kin", cwd=desk, expect=0)
    assert not list((tmp_path / "temporary").iterdir())


# ---- another machine's arithmetic


@pytest.mark.long
def test_another_processor_is_within_bounds(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As one without AVX: OpenBLAS and NumPy take other kernels."""
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Prescott")
    monkeypatch.setenv("NPY_DISABLE_CPU_FEATURES", "X86_V4 AVX512_ICL AVX512F AVX2 FMA3")
    for name in QUICK:
        run = ppmcal_process("verify", name, "--json", cwd=desk)
        recorded = read_record(desk / name).runs[WRITING[name].split()[0]]
        if "blas_kernel" not in recorded["environment"]:
            pytest.skip("another BLAS")
        assert run.code == 0, run
        found, = run.json["runs"]
        assert found["environment"], "the processor is another one"
        assert {f["status"] for f in found["files"]} <= {"same", "within bounds", "not compared"}


@pytest.mark.slow
def test_an_environment_that_is_recorded_otherwise_allows_round_off_alone(
        desk: Path, tmp_path: Path) -> None:
    own = copied(desk, tmp_path, "identified")
    run = read_record(own / "identified").runs["identify"]
    forged(own / "identified", environment={**run["environment"], "blas_kernel": "other"})
    found, = checked(own, "identified", code=0)
    assert found["environment"] == [f"blas kernel other then, "
                                    f"{run['environment']['blas_kernel']} now"]
    (own / "fleet.yaml").write_text(dump_yaml({}))    # nobody's input
    checked(own, "identified", code=0)


@pytest.mark.slow
def test_equal_legs_are_ranked_alike_whatever_their_last_digits(
        desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import numpy as np

    from ppmcal.design.sensitivity import Sensitivity

    def ranked() -> list[str]:
        frame = face.sensitivity(desk / "mine.yaml", home_only=True).to_frame()
        return list(frame["name"])

    want, share = ranked(), Sensitivity.share
    rng = np.random.default_rng(1)

    def shaken(self, rotation=False):
        found = share(self, rotation)
        return found * (1.0 + 1e-14 * rng.standard_normal(found.shape))

    monkeypatch.setattr(Sensitivity, "share", shaken)
    assert ranked() == want


@pytest.mark.slow
def test_what_a_session_knows_has_one_sign(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from ppmcal.calibration.sessions import session_posteriors as session_knowledge

    def known() -> dict[str, object]:
        record = face.identify(desk / "mine.yaml", [desk / "run1.csv"]).record.entries()
        return record["covariance"]["session"]

    want, of_data = known(), session_knowledge.of_data
    monkeypatch.setattr(session_knowledge, "of_data",
                        lambda *given: tuple(-a for a in of_data(*given)))
    assert known() == want


def test_a_folder_of_everything_is_not_searched_for_ever(tmp_path: Path,
                                                         monkeypatch: pytest.MonkeyPatch) -> None:
    from ppmcal.store import runs as module
    monkeypatch.setattr(module, "FOLDERS", replace(module.FOLDERS, most=5))
    for n in range(6):
        (tmp_path / f"{n}").mkdir()
    with pytest.raises(BadInput, match="too many folders") as caught:
        face.verify(tmp_path)
    assert str(tmp_path) in caught.value.where and "results itself" in caught.value.hint
    (tmp_path / "5").rmdir()
    with pytest.raises(BadInput, match="no results"):
        face.verify(tmp_path)


# ---- another version, other words


@pytest.mark.parametrize(("name", "then", "now", "status"), [
    # a sentence for a sentence
    ("a.json", '{"text": "noise, ratio 0.961"}', '{"text": "as noise at 0.96"}', "wording"),
    ("a.json", '{"text": "falls from 30 to 0.06 mm"}', '{"text": "a drop to 0.06 mm"}', "wording"),
    ("a.json", '{"notes": ["one of two", "two of two"]}', '{"notes": ["both are one"]}', "wording"),
    ("a.csv", "row,reason\n1,too far off\n", "row,reason\n1,off by too much\n", "wording"),
    ("a.yaml", "note: it is so\n", "note: so it is\n", "wording"),
    ("a.json", '{"text": "from 0.412 to 0.0195 mm"}', '{"text": "0.0195 mm (0.412 before)"}',
     "wording"),
    ("a.json", '{"version": "1", "text": "it is so"}', '{"version": "2", "text": "so it is"}',
     "wording"),
    # what a number says in it, a count, and what is no sentence
    ("a.json", '{"text": "noise, ratio 0.961"}', '{"text": "as noise at 0.93"}', "differs"),
    ("a.json", '{"text": "3 rows left out"}', '{"text": "4 rows are left out"}', "differs"),
    ("a.json", '{"text": "rms is 0.96."}', '{"text": "rms is 0.99."}', "differs"),
    ("a.json", '{"text": "from 0.4 to 0.1 mm"}', '{"text": "from 0.1 to 0.4 mm"}', "differs"),
    ("a.json", '{"verdict": "named"}', '{"verdict": "weak"}', "differs"),
    ("a.json", '{"findings": []}', '{"findings": ["it is so"]}', "differs"),
    ("a.json", '{"name": "run of one day"}', '{"name": "run of the day"}', "differs"),
    ("a.json", '{"provenance": {"command": "ppmcal identify a b"}}',
     '{"provenance": {"command": "ppmcal identify a c"}}', "differs"),
    ("a.csv", "row,reason\n1,too far off\n", "row,reason\n1,\n", "differs"),
    # a number beside it
    ("a.json", '{"x": 1.5, "text": "it is so"}', '{"x": 1.6, "text": "so it is"}', "differs"),
    ("a.json", '{"x": 1.5, "text": "it is so"}', '{"x": 1.5000000001, "text": "so is it"}',
     "wording"),
    # pages, drawings, and comments of a configuration
    ("a.html", "<p>one\n<p>two\n", "<h1>all\n", "wording"),
    ("a.svg", '<path d="M 1.0 2.0"/>\n', '<path d="M 9.0 2.0"/>\n', "wording"),
    ("a.cfg", "# was 3\nx: 3\n", "# from three\n# on\nx: 3\n", "wording"),
    ("a.cfg", "# was 3\nx: 3\n", "# from three\nx: 4\n", "differs"),
    ("a.cfg", "#*# x = 3.0\n", "#*# x = 3.5\n", "differs"),
    ("a.cfg", "x: 3\n", "x: 3\ny: 4\n", "differs")])
def test_what_only_another_version_may_say_in_other_words(name: str, then: str, now: str,
                                                          status: str) -> None:
    """Of the same version each of these differs."""
    told = compared(name, then.encode(), now.encode(), False, reword=True)
    assert told.status == {"wording": "wording differs"}.get(status, status)
    assert told.count and told.worst
    assert compared(name, then.encode(), now.encode(), False).status == "differs"
    assert compared(name, then.encode(), now.encode(), True).status == "differs"


def reworded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let all that knows of noise say it otherwise."""
    monkeypatch.setattr(IdentificationRecord, "text", lambda self, text=IdentificationRecord.text:
                        text(self).replace("uncalibrated machine", "machine as it was"))


@pytest.mark.long
def test_an_older_version_s_words_are_told_and_fail_nothing(
        desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = copied(desk, tmp_path, "identified")
    reworded(monkeypatch)
    found, = checked(own, "identified", code=1)
    assert found["status"] == "differs" and not found["environment"]
    monkeypatch.setattr(provenance, "__version__", "9.9.9")
    found, = checked(own, "identified", code=0)
    assert found["status"] == "wording differs"
    assert found["environment"] == ["version 0.3.0 then, 9.9.9 now"]
    told = {f["file"]: f["status"] for f in found["files"]}
    assert told == {"identification.json": "wording differs", "identified.yaml": "same",
                    "parameters.csv": "same", "residuals.csv": "same"}
    console = ppmcal("verify", "identified", cwd=own, expect=0).out
    assert "run again: the numbers are the same, the wording differs." in console
    assert "machine as it was" in console


@pytest.mark.slow
def test_an_edited_sentence_is_a_fault_of_any_version(
        desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = copied(desk, tmp_path, "identified")
    path = own / "identified/identification.json"
    path.write_text(path.read_text().replace("uncalibrated machine", "machine as it was"))
    for version in ("0.3.0", "9.9.9"):
        monkeypatch.setattr(provenance, "__version__", version)
        found, = checked(own, "identified", code=1)
        assert [f["file"] for f in found["files"] if f["edited"]] == ["identification.json"]


@pytest.mark.slow
def test_another_version_s_number_differs(
        desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = copied(desk, tmp_path, "identified")
    reworded(monkeypatch)
    monkeypatch.setattr(provenance, "__version__", "9.9.9")
    path, record = own / "identified/parameters.csv", own / "identified" / RECORD
    value = path.read_text().splitlines()[1].split(",")[2]
    old = path.read_bytes()
    path.write_text(old.decode().replace(f",{value},", f",{float(value) + 0.5!r},", 1))
    record.write_text(record.read_text().replace(*(hashlib.sha256(b).hexdigest() for b in (
        old, path.read_bytes()))))
    found, = checked(own, "identified", code=1)
    told = {f["file"]: (f["status"], f["edited"]) for f in found["files"]}
    assert told["parameters.csv"] == ("differs", False)
    assert told["identification.json"] == ("wording differs", False)


# ---- a later version, which knows more


@pytest.mark.parametrize(("name", "then", "now", "status", "unknown"), [
    ("a.json", '{"x": 1.5, "y": 2}', '{"x": 1.5}', "of a later version", ["y"]),
    ("a.json", '{"p": [{"name": "a", "x": 1, "y": 2}, {"name": "b", "x": 1, "y": 3}]}',
     '{"p": [{"name": "a", "x": 1}, {"name": "b", "x": 1}]}', "of a later version", ["p.y"]),
    ("a.yaml", "x: 1\ny: {z: 3}\n", "x: 1\n", "of a later version", ["y"]),
    ("a.csv", "row,y,x\n1,3,1.5\n2,4,1.5\n", "row,x\n1,1.5\n2,1.5\n", "of a later version", ["y"]),
    ("a.json", '{"y": 2, "text": "it is so"}', '{"text": "so it is"}', "of a later version", ["y"]),
    # what both know still counts
    ("a.json", '{"x": 1.5, "y": 2}', '{"x": 1.6}', "differs", ["y"]),
    ("a.csv", "row,y,x\n1,3,1.5\n", "row,x\n1,1.6\n", "differs", ["y"]),
    ("a.csv", "x,row,y\n1.5,1,3\n", "row,x\n1,1.5\n", "differs", ["y"]),
    ("a.json", '{"x": 1.5}', '{"x": 1.5, "y": 2}', "differs", [])])
def test_keys_that_only_a_later_version_knows_are_named(
        name: str, then: str, now: str, status: str, unknown: list[str]) -> None:
    """Of the same version, and of an earlier one, each of these differs."""
    told = compared(name, then.encode(), now.encode(), False, reword=True, later=True)
    assert (told.status, list(told.unknown)) == (status, unknown)
    assert bool(unknown) == ("not understood" in told.words())
    old = compared(name, then.encode(), now.encode(), False, reword=True)
    assert (old.status, old.unknown) == ("differs", ())


def later(folder: Path, **entries: object) -> None:
    """Let a later version have written a folder: with entries of its JSON, and another file."""
    path, record = folder / "identification.json", folder / RECORD
    path.write_text(json.dumps({**json.loads(path.read_text()), **entries}))
    (folder / "shape.csv").write_text("a\n1\n")
    known = json.loads(record.read_text().replace("0.3.0", "0.10.0"))
    for name in ("identification.json", "shape.csv"):
        known["files"][name] = {"command": "identify", "sha256": hashlib.sha256(
            (folder / name).read_bytes()).hexdigest()}
    record.write_text(json.dumps(known))


@pytest.mark.slow
def test_a_folder_of_a_later_version_says_what_is_not_understood(desk: Path, tmp_path: Path
                                                                 ) -> None:
    own = copied(desk, tmp_path, "identified")
    later(own / "identified", shape={"waves": 3})
    found, = checked(own, "identified", code=2)
    assert found["status"] == "of a later version"
    assert found["environment"] == ["version 0.10.0 then, 0.3.0 now"]
    told = {f["file"]: (f["status"], f["unknown"]) for f in found["files"]}
    assert told == {"identification.json": ("of a later version", ["shape"]),
                    "shape.csv": ("of a later version", []),
                    **dict.fromkeys(("identified.yaml", "parameters.csv", "residuals.csv"),
                                    ("same", []))}
    console = " ".join(ppmcal("verify", "identified", cwd=own, expect=2).out.split())
    assert "all is the same that this version knows; verify the rest with the version" in console
    assert ("identification.json: made by a later version: 1 key (shape) not understood."
            in console)
    assert "shape.csv: made by a later version: the file is not understood." in console


@pytest.mark.slow
def test_a_value_that_differs_is_a_fault_of_a_later_version_too(desk: Path, tmp_path: Path) -> None:
    own = copied(desk, tmp_path, "identified")
    later(own / "identified", shape={"waves": 3}, iterations=99)
    found, = checked(own, "identified", code=1)
    told = {f["file"]: (f["status"], f["unknown"], f["count"]) for f in found["files"]}
    assert found["status"] == "differs"
    assert told["identification.json"] == ("differs", ["shape"], 1)


def test_a_folder_called_as_objects_in_memory_are_recorded_holds_files(tmp_path: Path) -> None:
    inputs = {}
    for name in ("in_memory/m.yaml", "in_memory/run.csv"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(name, encoding="utf-8")
        inputs[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    folder = tmp_path / "identified"
    folder.mkdir()
    for data, known in (("in_memory/run.csv", True), ({"in_memory": "Dataset"}, False)):
        source = {"function": "identify.identify", "inputs": inputs, "from": "..",
                  "options": {"mechanism": "in_memory/m.yaml", "data": data}}
        (folder / RECORD).write_text(json.dumps({
            "format": "ppmcal/folder/1", "commands": ["identify"], "files": {},
            "runs": {"identify": source}}), encoding="utf-8")
        if known:
            run, places = compare_command._run(folder)
            assert run.data == [data] and places[data] == tmp_path / data
            continue
        with pytest.raises(BadInput, match="not recorded from which files"):
            compare_command._run(folder)
