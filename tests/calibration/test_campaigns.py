"""What is one session: several targets of one body are, days are not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from helpers.sessions import BOX, POSITION, machine
from numpy.typing import NDArray

from ppmcal import check, diagnose
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.homing_shift import homing_shifts
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.knowledge.intervals import by_sessions
from ppmcal.calibration.validation.residual_vectors import split
from ppmcal.diagnosis.left_out_schemes import SESSION, schemes
from ppmcal.errors import BadInput
from ppmcal.io.campaign import joined
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.kinematics.registration import measured_pose
from ppmcal.model.dataset import Dataset, Unknown
from ppmcal.model.instruments import find_instrument
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration
from ppmcal.model.sessions import campaign, one_session, pose_labels, session_masks

TARGETS = {"A": (0.02, -0.01, 0.0), "B": (-0.05, 0.03, 0.0), "C": (0.04, 0.06, 0.0)}
FRAME = np.array([0.1, -0.05, 0.0, 0.0, 0.0, 0.3])
ROWS, REHOMED, SHIFT = 60, 31, 3e-4
NAME = "3-RPR"


def joints(seed: int = 1, n: int = ROWS) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    pose = machine(NAME).home_pose + rng.uniform(-1.0, 1.0, (3 * n, 6)) * BOX[NAME]
    found = inverse(Model(machine(NAME)), pose_motor(pose))
    return np.round(found.q[found.reached][:n], 6)


def seen(name: str, q: NDArray[np.float64], target: Sequence[float], rehomed: int = 0,
         seed: int = 0) -> Dataset:
    """Positions of one target; from row ``rehomed`` on the first leg's zero is another."""
    mechanism = machine(NAME)
    g = mechanism.nominals.copy()
    g[mechanism.names.index("leg1.base.point.x")] += 4e-4
    g[mechanism.names.index("leg3.offset")] -= 3e-4
    late = np.arange(1, len(q) + 1)[:, None] >= (rehomed or np.inf)
    true = q + late * np.array([SHIFT, 0.0, 0.0])
    where = Registration.of_pose(FRAME, np.array(target))
    pose = measured_pose(where, forward(Model(mechanism, g), true).pose)
    rng = np.random.default_rng([seed, *name.encode()])
    pose[:, :3] += POSITION * rng.normal(size=(len(q), 3)) * [1.0, 1.0, 0.0]
    data = Dataset.of_poses(name, q, pose, (POSITION, np.inf), True)
    return replace(data, kind=find_instrument("position"), rotation=np.full((len(q), 3), np.nan),
                   target_rotation=Unknown(False, np.zeros(3)),
                   frame=Unknown(True, np.zeros(6), None if name == "A" else "A"))


def three(rehomed: int = 0) -> list[Dataset]:
    return [seen(name, joints(), at, rehomed) for name, at in TARGETS.items()]


@pytest.mark.slow
def test_targets_of_one_body_are_one_session_and_share_poses_and_time() -> None:
    datasets = joined(three())
    assert len(session_masks(datasets)) == 1
    held = split(datasets, 0.27, 7)
    assert held[0].sum() == round(0.27 * ROWS)
    assert all(np.array_equal(held[0], h) for h in held)
    assert all(np.array_equal(d.numbers(), np.arange(1, ROWS + 1)) for d in datasets)
    problem = Problem(machine(NAME), datasets, machine(NAME).free)
    assert SESSION not in [by for by, _ in schemes(problem)]
    fit = identify(problem)
    assert by_sessions(fit, 1.0) is None
    assert not list(homing_shifts(fit))


def test_a_target_that_was_hidden_in_some_poses_keeps_its_place_in_time() -> None:
    a, b, c = three()
    hidden = np.isin(np.arange(ROWS), [0, 7, 8, 40])
    b = replace(b.take(~hidden), rows=np.arange(1, ROWS - 3))
    # of the third file joints have fewer digits
    c = replace(c, q=np.round(c.q, 5))
    datasets = joined([b, a, c, seen("D", joints(2), TARGETS["A"])])
    one, first, third, other = datasets
    assert np.array_equal(one.numbers(), first.numbers()[~hidden])
    assert np.array_equal(third.numbers(), first.numbers())
    assert np.array_equal(one.groups, first.groups[~hidden])
    assert campaign(one) == campaign(first) == campaign(third) != campaign(other)
    assert other.numbers()[0] == ROWS + 1
    assert one.row_at(10) == 7    # rows 1, 8 and 9 are not in it
    assert [label for label, _ in session_masks(datasets)] == ["B + A + C", "D"]
    # read, then given to a command: what is known stays
    again = joined(datasets)
    for old, new in zip(datasets, again, strict=True):
        assert np.array_equal(old.numbers(), new.numbers())
        assert np.array_equal(old.groups, new.groups) and old.campaign == new.campaign


@pytest.mark.parametrize("why", ["other poses", "same target", "frame", "column", "time"])
def test_days_are_sessions(why: str) -> None:
    a, b = seen("A", joints(), TARGETS["A"]), seen("B", joints(), TARGETS["B"])
    if why == "other poses":
        b = seen("B", joints(3), TARGETS["B"])
    elif why == "same target":
        a, b = (replace(d, target=Unknown(False, np.zeros(3))) for d in (a, b))
    elif why == "frame":
        b = replace(b, frame=Unknown(True, np.zeros(6)))
    elif why == "column":
        a, b = (replace(d, sessions=(s,) * ROWS) for d, s in ((a, "mon"), (b, "tue")))
    else:
        a, b = (replace(d, columns={"time": np.arange(ROWS) + s}) for d, s in ((a, 0.0), (b, 9e4)))
    datasets = joined([a, b])
    assert len(session_masks(datasets)) == 2
    assert np.array_equal(datasets[1].numbers(), np.arange(1, ROWS + 1) + ROWS)
    labels = pose_labels(datasets)
    assert not set(labels[0]) & set(labels[1])
    assert "several days" in one_session().hint


def of_one_clock(kind: str, session: str = "") -> list[Dataset]:
    """Two files of the same joints and times, each with a frame, or a point, of its own."""
    columns = {"time": 45.0 * np.arange(ROWS), "temperature": 0.01 * np.arange(ROWS)}
    return [replace(seen("A", joints(), TARGETS["A"]), name=name, kind=find_instrument(kind),
                    frame=Unknown(True, np.zeros(6)), target=Unknown(False, np.zeros(3)),
                    columns=columns, sessions=(session,) * ROWS if session else None)
            for name in ("one", "two")]


@pytest.mark.parametrize(("kind", "session"), [
    ("distance", ""), ("distance", "monday"), ("position", "monday")])
def test_files_of_the_same_poses_and_times_are_one_sequence(kind: str, session: str) -> None:
    first, second = joined(of_one_clock(kind, session))
    assert np.array_equal(second.numbers(), first.numbers())
    assert np.array_equal(*pose_labels([first, second]))
    assert [label for label, _ in session_masks([first, second])] == [session or "one + two"]


@pytest.mark.parametrize("why", ["times", "temperatures", "no times", "sessions", "one point",
                                 "positions"])
def test_files_of_the_same_poses_at_other_times_follow_each_other(why: str) -> None:
    one, two = of_one_clock("position" if why == "positions" else "distance",
                            "monday" if why == "sessions" else "")
    columns = dict(two.columns)
    if why == "times":
        columns["time"] = columns["time"] + 20.0
    elif why == "temperatures":
        columns["temperature"] = columns["temperature"] + 0.3
    elif why == "no times":
        del columns["time"]
    elif why == "sessions":
        two = replace(two, sessions=("tuesday",) * ROWS)
    elif why == "one point":
        one, two = (replace(d, frame=Unknown(False, np.zeros(6))) for d in (one, two))
    datasets = joined([one, replace(two, columns=columns)])
    assert datasets[1].numbers()[0] == ROWS + 1
    assert len(session_masks(datasets)) == 2


def test_heights_and_distances_of_a_printer_are_one_session() -> None:
    base = seen("A", joints(), TARGETS["A"])
    heights, distances, more = (
        replace(base, name=n, kind=find_instrument(k), q=joints(s),
                frame=Unknown(True, np.zeros(6)))
        for n, k, s in (("h", "plane", 1), ("d", "distance", 2), ("h2", "plane", 3)))
    datasets = joined([heights, distances])
    assert [label for label, _ in session_masks(datasets)] == ["h + d"]
    labels = pose_labels(datasets)
    assert not set(labels[0]) & set(labels[1])
    assert datasets[1].numbers()[0] == ROWS + 1
    # whose the distances are is not known
    assert len(session_masks(joined([heights, more, distances]))) == 3


def sister() -> Mechanism:
    """The file of another machine of the kind: eight tolerances off."""
    rng, parameters = np.random.default_rng(2), list(machine(NAME).parameters)
    for p in machine(NAME).free:
        value = parameters[p].nominal + 8.0 * (parameters[p].tolerance or 0.0) * rng.normal()
        parameters[p] = replace(parameters[p], value=value, nominal=value)
    return replace(machine(NAME), parameters=tuple(parameters))


@pytest.mark.long
def test_files_of_one_frame_are_each_looked_at_alone() -> None:
    (found,) = check(sister(), three()[:2]).misreadings
    assert found.mistakes[0].kind == "other-machine"
    swapped = [replace(d, q=d.q[:, [1, 0, 2]]) for d in three()]
    found = check(machine(NAME), swapped).misreadings
    assert [m.source for m in found] == ["A", "B", "C"]
    assert all(m.mistakes[0].kind == "permuted" for m in found)


@pytest.mark.parametrize(("own", "others", "words"), [
    ("run2", (), "no other data set is given"), ("run1", (), "names itself"),
    ("run3", ("run2",), "Did you mean 'run2'?")])
def test_a_frame_is_another_data_sets(own: str, others: tuple[str, ...], words: str) -> None:
    one = replace(seen(own, joints(), TARGETS["A"]), frame=Unknown(True, np.zeros(6), "run1"))
    more = [replace(one, name=n, frame=Unknown(True, np.zeros(6))) for n in others]
    with pytest.raises(BadInput) as refused:
        joined([one, *more])
    assert words in str(refused.value)
    assert f"'{own}'?" not in str(refused.value)
    assert "sidecar of" in str(refused.value)


@pytest.mark.long
def test_a_leg_homed_anew_is_one_event_for_all_targets() -> None:
    found = diagnose(machine(NAME), three(REHOMED), seed=3)
    record = found.record
    assert isinstance(record, DiagnosisRecord)
    (event,) = record.effects
    assert (event.kind, tuple(event.on)) == ("zero_shift", ("leg1",))
    assert event.row is not None and event.row.row == REHOMED
    assert event.parameters["shift"].value == pytest.approx(1e3 * SHIFT, abs=0.03)
    assert record.gap.poses <= round(0.27 * ROWS)
