"""Files of encoders that are read wrongly: told with the line for the sidecar, which is tried."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.commands import Run, ppmcal, rows
from helpers.paths import ROOT

from ppmcal import simulate
from ppmcal.calibration.fit import FitOptions, Problem, identify
from ppmcal.calibration.interpretation import check
from ppmcal.calibration.interpretation.encoders import encoder_readings
from ppmcal.calibration.interpretation.interpretation_error import InterpretationError
from ppmcal.calibration.interpretation.read_rightly import refuse_after_fit, refuse_misread
from ppmcal.calibration.interpretation.readings import at_joint
from ppmcal.calibration.validation import left_out, unused, unused_sentences
from ppmcal.commands.identify import run as identify_run
from ppmcal.commands.inputs import prepared
from ppmcal.errors import NoResult
from ppmcal.io.mechanism_reader import read_mechanism
from ppmcal.io.results.parts import misreading_entries
from ppmcal.model.dataset import Dataset
from ppmcal.model.instruments import InstrumentKind, find_instrument

UNITS = {"length": "mm", "angle": "deg"}


def arm(side: float, elbow: int) -> dict[str, Any]:
    def fixed(value: float) -> dict[str, Any]:
        return {"value": value, "fixed": True}
    return {"name": "left" if side < 0 else "right", "kind": "(R)RR",
            "base": {"point": {"x": fixed(60 * side), "y": fixed(0)}},
            "platform": {"point": {"x": fixed(0), "y": fixed(0)}},
            "proximal": 120, "distal": 160, "elbow": elbow}


FIVE_BAR = {"format": "ppmcal/mechanism/1", "name": "pick arm", "units": UNITS,
            "motion": "planar-point", "limbs": [arm(-1.0, -1), arm(1.0, 1)],
            "home": {"pose": {"x": 0, "y": 190}}, "tolerances": {"length": 0.5, "offset": 0.3}}
ERRORS = {"left.proximal": 0.4, "left.distal": -0.6, "right.proximal": -0.4, "right.distal": 0.5,
          "left.offset": 0.25, "right.offset": -0.2}
TWIN = "the encoder is at left.joint2, not at "


@dataclass(frozen=True)
class Desk:
    """A folder with a five-bar, a camera's file and one for each elbow's encoder."""

    folder: Path

    def changed(self, name: str, at: str = "left.joint2", sigma: float = 0.01,
                value: Callable[[list[float]], list[float]] = lambda v: v,
                q: Callable[[float, float], tuple[float, float]] = lambda a, b: (a, b)) -> Path:
        """Return a file of the left elbow's encoder, its columns changed."""
        table = rows(self.folder / "elbow" / "measurements.csv")
        angles = value([float(row["value"]) for row in table])
        lines = ["q_left,q_right,value"]
        for row, angle in zip(table, angles, strict=True):
            joints = q(float(row["q_left"]), float(row["q_right"]))
            lines.append(f"{joints[0]:.6f},{joints[1]:.6f},{angle:.8f}")
        path = self.folder / f"{name}.csv"
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        sidecar(path, {"format": "ppmcal/dataset/1", "name": name, "units": UNITS, "instrument": {
            "kind": "joint", "at": at, "sigma": {"value": sigma}}})
        return path

    def problem(self, *files: Path, camera: bool = True) -> Problem:
        names = [str(f) for f in files]
        machine, data = prepared(str(self.folder / "m.yaml"), (
            *[str(self.folder / "camera" / "measurements.csv")] * camera, *names))
        return Problem(machine, data, machine.free)

    def command(self, name: str, *files: Path, expect: int) -> Run:
        out = () if name == "check" else ("--out", self.folder / "out", "--overwrite")
        return ppmcal(name, self.folder / "m.yaml", self.folder / "camera" / "measurements.csv",
                      *files, *out, expect=expect)


def sidecar(path: Path, tree: dict[str, Any]) -> None:
    path.with_suffix(".yaml").write_text(yaml.safe_dump(tree), encoding="utf-8")


def flat(text: str) -> str:
    return re.sub(r"\s+", " ", text)


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Desk:
    folder = tmp_path_factory.mktemp("encoders")
    (folder / "m.yaml").write_text(yaml.safe_dump(FIVE_BAR), encoding="utf-8")
    for seed, (name, instrument) in enumerate({
            "camera": {"kind": "position", "sigma": {"position": 0.02}},
            "elbow": {"kind": "joint", "at": "left.joint2", "sigma": {"value": 0.01},
                      "offset": 0.7}}.items()):
        (folder / "s.yaml").write_text(yaml.safe_dump({
            "format": "ppmcal/scenario/1", "units": UNITS, "instrument": instrument,
            "poses": {"random": {"center": {"x": 0, "y": 190}, "half_range": {"x": 60, "y": 35},
                                 "count": 30}}, "errors": ERRORS, "seed": seed}))
        ppmcal("simulate", "m.yaml", "s.yaml", "--out", name, cwd=folder)
    return Desk(folder)


WRONG: dict[str, tuple[dict[str, Any], str, dict[str, Any]]] = {
    "the other sign": ({"value": lambda v: [-x for x in v]}, "value has the other sign",
                       {"read": {"signs": {"value": -1}}}),
    "radians": ({"value": lambda v: [math.radians(x) for x in v]}, "value is in rad, not deg",
                {"read": {"units": {"value": "rad"}}}),
    "the other limb": ({"at": "right.joint2"}, TWIN + "right.joint2",
                       {"instrument": {"at": "left.joint2"}}),
    "the driven joint": ({"at": "left.joint1"}, TWIN + "left.joint1",
                         {"instrument": {"at": "left.joint2"}}),
    "the last joint": ({"at": "left.joint3"}, TWIN + "left.joint3",
                       {"instrument": {"at": "left.joint2"}}),
    "sign and joint": ({"value": lambda v: [-x for x in v], "at": "left.joint1"},
                       "value has the other sign and " + TWIN + "left.joint1",
                       {"read": {"signs": {"value": -1}}, "instrument": {"at": "left.joint2"}}),
    "motors exchanged": ({"q": lambda a, b: (b, a)}, "q_left and q_right are exchanged",
                         {"read": {"columns": {"q_left": "q_right", "q_right": "q_left"}}})}


@pytest.mark.parametrize("camera", [True, False])
@pytest.mark.parametrize("name", WRONG)
def test_a_misread_encoder_is_told_with_the_lines_that_correct_it(desk: Desk, name: str,
                                                                  camera: bool) -> None:
    change, words, lines = WRONG[name]
    path = desk.changed("wrong", **change)
    with pytest.raises(InterpretationError) as refused:
        refuse_misread(desk.problem(path, camera=camera))
    (found,) = refused.value.found
    assert words in refused.value.what
    assert [yaml.safe_load(x) for x in re.findall(r"`(.*?)`", refused.value.hint)] == [
        {key: value} for key, value in lines.items()]
    tree = yaml.safe_load(path.with_suffix(".yaml").read_text(encoding="utf-8"))
    sidecar(path, {**tree, "read": lines.get("read", {}),
                   "instrument": {**tree["instrument"], **lines.get("instrument", {})}})
    problem = desk.problem(path, camera=camera)
    refuse_misread(problem)
    refuse_after_fit(identify(problem))
    assert found.quantity == "angle" and found.noise_after < 2.0


def test_an_encoder_that_is_read_rightly_is_let_through(desk: Desk) -> None:
    problem = desk.problem(desk.changed("right"))
    refuse_misread(problem)
    fit = identify(problem)
    refuse_after_fit(fit)
    assert unused(fit) == [] and unused_sentences(fit) == []


def test_an_offset_that_the_sidecar_gives_wrongly_is_opened(desk: Desk) -> None:
    path = desk.changed("zero", value=lambda v: [x + 40.0 for x in v])
    tree = yaml.safe_load(path.with_suffix(".yaml").read_text(encoding="utf-8"))
    sidecar(path, {**tree, "instrument": {**tree["instrument"], "offset": "known"}})
    with pytest.raises(InterpretationError, match="zero is not where the sidecar puts it"
                       ) as refused:
        refuse_misread(desk.problem(path))
    assert refused.value.hint == "Write into the sidecar: `instrument: {offset: unknown}`"


def test_sigma_goes_with_the_unit_of_the_whole_file(desk: Desk) -> None:
    """Angles and their sigma in degrees under a sidecar that says radians."""
    path = desk.changed("sigma")
    tree = yaml.safe_load(path.with_suffix(".yaml").read_text(encoding="utf-8"))
    sidecar(path, {**tree, "units": {**UNITS, "angle": "rad"}})
    with pytest.raises(InterpretationError) as refused:
        refuse_misread(desk.problem(path))
    lines = [yaml.safe_load(line) for line in re.findall(r"`(.*?)`", refused.value.hint)]
    assert lines[0]["read"]["units"] == {"q_left": "deg", "q_right": "deg", "value": "deg"}
    assert lines[1]["instrument"]["sigma"]["value"] == pytest.approx(math.radians(0.01), rel=1e-5)


def test_a_unit_that_the_header_states_is_corrected_there(desk: Desk) -> None:
    path = desk.changed("header", value=lambda v: [math.radians(x) for x in v])
    path.write_text(path.read_text(encoding="utf-8").replace("value", "value [deg]", 1),
                    encoding="utf-8")
    with pytest.raises(InterpretationError) as refused:
        refuse_misread(desk.problem(path))
    assert "`value [rad]` for `value [deg]`" in refused.value.hint


def test_a_slide_and_a_hinge_are_taken_for_each_other_where_no_unit_is_said() -> None:
    machine = read_mechanism(config("3-RPR"))
    kind = find_instrument("joint").located("leg1.joint2", machine, "m.yaml")
    data = replace(Dataset.of_poses("e", np.zeros((3, 3)), np.zeros((3, 6)), (1.0, 1.0), False),
                   kind=kind, units=machine.units, value=np.array([0.001, 0.002, 0.003]))
    found = {r.at: r for r in encoder_readings(machine, data) if not r.numbers.parts}
    assert {"", "leg1.joint1", "leg1.joint3", "leg2.joint2"} <= set(found)
    # what the file holds is 1, 2, 3: mm of the slide, and degrees of a hinge
    assert np.allclose(np.degrees(found["leg1.joint1"].of(data).value), [1.0, 2.0, 3.0])
    said = replace(data, read={"units": {"value": "mm"}})
    assert {r.at for r in encoder_readings(machine, said)} == {"", "leg2.joint2", "leg3.joint2"}


SPATIAL = {"x": 250, "y": 250, "z": 200, "rx": 12, "ry": 12, "rz": 12}


def simulated(tree: dict[str, Any], at: str, half: dict[str, float], **more: Any) -> Problem:
    """Return the problem of one simulated encoder alone."""
    machine = read_mechanism(tree)
    made = simulate(machine, {
        "format": "ppmcal/scenario/1", "units": UNITS, "errors": {"random": {"scale": 1.0}},
        "poses": {"random": {"center": tree["home"]["pose"], "half_range": half, "count": 40}},
        "instrument": {"kind": "joint", "at": at, "sigma": {"value": 0.01}, "offset": 7},
        "seed": 1, **more})
    return Problem(machine, made.data, machine.free)


def config(name: str) -> dict[str, Any]:
    found = yaml.safe_load((ROOT / "configs" / f"{name}.yaml").read_text(encoding="utf-8"))
    assert isinstance(found, dict)
    return found


def test_a_slides_reading_that_is_taken_for_an_angle_is_told_in_lengths() -> None:
    problem = simulated(config("3-RPR"), "leg2.joint2", {"x": 100, "y": 100, "rz": 20})
    (data,), machine = problem.datasets, problem.mechanism
    hinge = data.kind.located("leg3.joint3", machine, "m.yaml")
    with pytest.raises(InterpretationError) as refused:
        refuse_misread(replace(problem, datasets=(at_joint(data, hinge),)))
    (found,) = refused.value.found
    assert TWIN.replace("left", "leg2") + "leg3.joint3: read so, the median error is 0.0" in (
        refused.value.what)
    assert " mm, and a short fit leaves" in refused.value.what
    assert found.quantity == "length" and found.at == "leg2.joint2" and not found.block
    (entry,) = misreading_entries([found], machine.units)
    assert entry.entries()["at"] == "leg2.joint2"


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_encoder_of_a_spatial_machine_is_judged_too(sign: float) -> None:
    """A rotation is whole or nothing; the one angle that an encoder shows is no part of one."""
    tree = config("6-UPS")
    for i, limb in enumerate(tree["limbs"]):
        limb["base"]["axis"] = {"value": [float(np.cos(i)), float(np.sin(i)), 0.0],
                                "tolerance": 0.0}
    problem = simulated(tree, "leg1.joint1", SPATIAL)
    (data,) = problem.datasets
    problem = replace(problem, datasets=(replace(data, value=sign * data.value),))
    assert problem.counts(0, np.arange(len(data))).tolist() == [1] * len(data)
    if sign > 0.0:
        refuse_misread(problem)
        return
    with pytest.raises(InterpretationError, match="value has the other sign"):
        refuse_misread(problem)


def test_a_kind_at_a_joint_that_names_no_others_is_read_there_alone() -> None:
    machine = read_mechanism(FIVE_BAR)
    bare = InstrumentKind("probe", lambda motion: (5,), "value", placed=lambda *_: 5)
    assert list(bare.elsewhere(machine)) == []
    own = find_instrument("joint").located("left.joint2", machine, "m.yaml")
    assert [k.at for k in own.elsewhere(machine)] == [
        "left.joint1", "left.joint3", "right.joint1", "right.joint2", "right.joint3"]


# --- what no reading explains ---------------------------------------------------------------------

def shuffled(values: list[float]) -> list[float]:
    return [values[i] for i in np.random.default_rng(1).permutation(len(values))]


def test_a_file_of_which_hardly_a_row_is_used_comes_first(desk: Desk) -> None:
    fit = identify(desk.problem(desk.changed("shuffled", value=shuffled)))
    (note,) = unused_sentences(fit)
    assert re.match(r"shuffled: (none|only \d) of 30 rows (is|are) used \(they contradict the other"
                    r" files, and no other reading explains them\)", note)
    # the file as a whole is at fault: its rows have no pattern beside those of the others
    assert left_out(fit).sentence == ""


def test_check_says_of_it_what_it_finds(desk: Desk) -> None:
    problem = desk.problem(desk.changed("twisted", value=shuffled))
    found = check(problem.mechanism, problem.datasets)
    assert any("do not fit this machine" in n or "of 30 rows" in n for n in found.findings)


@pytest.mark.slow
def test_identify_and_diagnose_begin_with_it(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    path = desk.changed("odd", value=shuffled)
    monkeypatch.setattr(identify_run, "refuse_before_fit", lambda problem: None)
    told = flat(desk.command("identify", path, expect=1).out)
    assert told.startswith("! odd: ")
    assert "the encoder at left.joint2 reads" not in told     # nothing is known of its offset
    assert told.count("no other reading explains them") == 1
    found = json.loads((desk.folder / "out" / "identification.json").read_text(encoding="utf-8"))
    assert found["findings"][0].startswith("odd: ")
    from ppmcal.commands.diagnose import run as diagnose_run
    monkeypatch.setattr(diagnose_run, "refuse_before_fit", lambda *args, **options: None)
    told = flat(desk.command("diagnose", path, expect=1).out)
    assert re.match(r"pick arm: odd: (none|only \d) of 30 rows", told)
    assert "detectable in the other data" in told
    assert "nothing more to measure" not in told
    assert "Next: find out why odd contradicts the other files" in told
    found = json.loads((desk.folder / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    assert found["unused"][0].startswith("odd: ")


@pytest.mark.slow
@pytest.mark.parametrize("command", ["identify", "diagnose", "check"])
def test_commands_refuse_a_misread_encoder(desk: Desk, command: str) -> None:
    path = desk.changed("turned", value=lambda v: [-x for x in v])
    done = desk.command(command, path, expect=1 if command == "check" else 3)
    told = flat(done.out + done.err)
    assert "value has the other sign" in told and "`read: {signs: {value: -1}}`" in told


# --- no result without a minimum ------------------------------------------------------------------

def test_a_fit_without_a_minimum_at_its_own_noise_is_no_result(desk: Desk) -> None:
    """The rows as noisy as they turned out: where the second fit wanders there is no result."""
    fit = identify(desk.problem(desk.changed("calm")))
    wandering: Any = SimpleNamespace(fit=SimpleNamespace(converged=False), inflation=171.0)
    with pytest.raises(NoResult, match="rows 171 times as noisy as stated") as refused:
        identify_run._refuse_wandering(fit, wandering, FitOptions())
    assert refused.value.exit_code == 3
    identify_run._refuse_wandering(fit, wandering, FitOptions(iterations=5))     # as it was asked
    wandering.fit.converged = True
    identify_run._refuse_wandering(fit, wandering, FitOptions())
