"""Machines in space, written down another way: same decisions, and the same numbers to round-off.

A hexapod, a 3-RPS and deltas, calibrated, validated and compensated in other words
(``helpers.other_words``); errors that are vectors are compared in the first axes.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from helpers.other_words import PLAIN, POSE, Words, campaign, written
from scipy.spatial.transform import Rotation

import ppmcal as face

ROWS = {"6-UPS": 22, "3-RPS": 16, "delta-linear": 22, "delta-rotary": 24}
QUICK = ("6-UPS", "3-RPS", "delta-linear")
VECTORS = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True)
class Answer:
    """What the commands say of a campaign, in its first words and axes, SI.

    ``errors``, ``sigmas``: by slot, (1,) or (3,), and the covariance of its coordinates.
    """

    decisions: dict[str, Any]
    errors: dict[str, Any]
    covariances: dict[str, Any]
    figures: dict[str, float]
    commands: dict[str, Any]
    redundant: frozenset[str]
    identified: Any
    data: Any


def in_first_words(name, words):
    """Return a parameter's or slot's name as the plain campaign has it."""
    limb, dot, rest = name.partition(".")
    return {new: old for old, new in words.names.items()}.get(limb, limb) + dot + rest


def vectors(found, words):
    """Return slot -> errors and slot -> covariance, SI, in the first base axes."""
    level = not found.mechanism.motion.turns
    turn = Rotation.from_rotvec(words.base[0]).as_matrix().T
    columns = list(found.columns)
    sizes = {e.name: e.error for e in found.estimates}
    slots = {}
    for name in columns:
        stem, _, end = name.rpartition(".")
        if " of " not in name:
            slots.setdefault(stem if end in VECTORS else name, []).append(name)
    errors, covariances = {}, {}
    for slot, names in slots.items():
        at = [columns.index(n) for n in names]
        error = np.array([sizes[n] for n in names])
        covariance = found.covariance[np.ix_(at, at)]
        if len(names) == 3 and (level or ".platform." not in slot):
            error, covariance = turn @ error, turn @ covariance @ turn.T
        errors[in_first_words(slot, words)] = error
        covariances[in_first_words(slot, words)] = covariance
    return errors, covariances


def answer(one, words=PLAIN):
    """Return what check, identify and compensate say of a campaign in other words."""
    w = written(one, words)
    machine = w.machine()
    data = w.data(machine)
    checked = face.check(machine, data)
    result = face.identify(machine, data, holdout=0)
    found = result.identification
    fit = found.fit
    rows = np.arange(len(w.table["x"])) if words.rows is None else np.asarray(words.rows)
    left_out = sorted(rows[fit.problem.datasets[0].rows[~fit.keep[0]] - 1].tolist())
    sets = frozenset((frozenset(in_first_words(s, words) for s in one.slots), one.combinations)
                     for one in found.unidentifiable)
    seen = frozenset((frozenset(in_first_words(s, words) for s in one.slots), one.combinations)
                     for one in checked.unidentifiable)
    sent = face.compensate(result, w.targets)
    order = np.argsort(words.limbs) if words.limbs is not None else np.arange(len(machine.limbs))
    errors, covariances = vectors(found, words)
    length = machine.units.factor("length")
    return Answer(
        {"rank": found.rank, "redundant": len(found.redundant), "sets": sets, "check": seen,
         "left out": left_out, "noise failed": found.noise.failed,
         "needs a look": result.has_findings, "findings": len(result.findings),
         "sent": [tuple(sent.compensation.status), sent.has_findings]},
        errors, covariances,
        {"noise": found.noise.sigma_ratio, "chi2": found.noise.chi2,
         "before": float(result.record.residual.before["position"].rms * length),
         "after": float(result.record.residual.after["position"].rms * length)},
        {"q": sent.compensation.q[:, order],
         "before": sent.compensation.position_before,
         "sigma": sent.compensation.sigma_position},
        frozenset(in_first_words(d.name, words) for d in found.redundant), result, data)


def assert_same(one, other, drives_fewer=False):
    """Compare two answers: decisions exactly, numbers to the fit's own last step.

    ``drives_fewer``: an uncorrected command of such a machine names coordinates of the base's axes,
    and leaves the others open, so that its error is another one in other axes.
    """
    assert other.decisions == one.decisions
    assert other.errors.keys() == one.errors.keys()
    for slot, error in one.errors.items():
        sigma = np.sqrt(np.trace(one.covariances[slot]))
        assert other.errors[slot] == pytest.approx(error, abs=1e-4 * sigma), slot
        assert other.covariances[slot] == pytest.approx(
            one.covariances[slot], abs=2e-5 * sigma**2), slot
    for name, value in one.figures.items():
        assert other.figures[name] == pytest.approx(value, rel=1e-6), name
    for name in {"q", "sigma", *([] if drives_fewer else ["before"])}:
        value = one.commands[name]
        size = np.nanmax(np.abs(value))
        assert other.commands[name] == pytest.approx(value, abs=1e-6 * size, nan_ok=True), name


def on_the_surface(one):
    """Return the campaign with targets that the identified machine can be seen at, and one not.

    A machine of three drives goes to no other poses.
    """
    w = written(one)
    machine = w.machine()
    found = face.identify(machine, w.data(machine), holdout=0)
    joints = {c: v[[0, 7, 8, 10, 11]] for c, v in one.table.items() if c.startswith("q_")}
    seen = face.forward(found.mechanism, joints, dataset="simulated").to_frame()
    targets = {c: np.array(seen[c], float) for c in POSE if c in one.table}
    targets["z"][2] += 1e4
    return replace(one, targets=targets)


def all_at_once(kind, seed):
    """Return words that change everything."""
    rng = np.random.default_rng(seed)
    limbs = 6 if kind == "6-UPS" else 3
    first = [f"leg{i + 1}" for i in range(limbs)] if kind in ("6-UPS", "3-RPS") else list("abc")
    new = [f"strut{10 - i}" for i in range(limbs)]
    return Words(
        rows=rng.permutation(ROWS[kind]), limbs=rng.permutation(limbs), columns=seed,
        units=[("m", "rad"), ("in", "deg"), ("um", "deg"), ("mm", "deg")][seed % 4],
        names=dict(zip(first, new, strict=True)),
        base=(rng.uniform(-1.7, 1.7, 3), rng.uniform(-900.0, 900.0, 3)),
        seen=(rng.uniform(-1.7, 1.7, 3), rng.uniform(-900.0, 900.0, 3)))


@pytest.fixture(scope="module")
def campaigns():
    """Return (kind, seed of words) -> the campaign and the answer in these words, made once."""
    made, answers = {}, {}

    def of(kind, seed=None):
        if kind not in made:
            made[kind] = on_the_surface(campaign(kind, ROWS[kind],
                                                 errors={"random": {"scale": 2.0}}))
        if (kind, seed) not in answers:
            words = PLAIN if seed is None else all_at_once(kind, seed)
            answers[kind, seed] = answer(made[kind], words)
        return made[kind], answers[kind, seed]

    return of


@pytest.mark.long
@pytest.mark.parametrize("kind", QUICK)
def test_everything_at_once_tells_nothing(campaigns, kind):
    _, plain = campaigns(kind)
    decided = plain.decisions
    assert decided["left out"] == [5] and decided["sets"]
    assert decided["sent"][0] == ("ok", "ok", "refused", "ok", "ok")
    assert_same(plain, campaigns(kind, 0)[1], kind == "3-RPS")


def by_itself(kind):
    """Return name -> words that change one thing."""
    every = all_at_once(kind, 4)
    return {
        "rows": Words(rows=every.rows), "limbs": Words(limbs=every.limbs),
        "units": Words(units=("m", "rad")), "columns": Words(columns=2),
        "names": Words(names=every.names), "base": Words(base=every.base),
        "measuring frame": Words(seen=every.seen)}


@pytest.mark.long_cases("3-RPS-limbs")
@pytest.mark.slow
@pytest.mark.parametrize(("kind", "changed"), [
    *(("6-UPS", name) for name in by_itself("6-UPS")), ("3-RPS", "limbs"), ("3-RPS", "base")])
def test_each_by_itself_tells_nothing(campaigns, kind, changed):
    one, plain = campaigns(kind)
    found = answer(one, by_itself(kind)[changed])
    assert_same(plain, found, kind == "3-RPS" and changed == "base")
    if changed in ("rows", "limbs", "units", "columns"):
        assert found.redundant == plain.redundant


@pytest.mark.long_cases("3-RPS", "delta-rotary")
@pytest.mark.slow
@pytest.mark.parametrize("kind", ROWS)
def test_everything_at_once_tells_nothing_again(campaigns, kind):
    assert_same(campaigns(kind)[1], campaigns(kind, 1)[1], kind == "3-RPS")


# --- validate and report ------------------------------------------------------------------------


def judged(record, machine):
    """Return verdicts, and errors in SI, of the identified and the nominal machine."""
    factors = {"m": machine.units.factor("length"), "rad": machine.units.factor("angle")}
    said, figures = [record.datasets[0].fitted, len(record.findings)], {}
    for errors in record.datasets[0].errors:
        said += [errors.model, errors.verdict]
        figures |= {f"{errors.model} noise": errors.noise, f"{errors.model} closer":
                    errors.closer * factors["m"]}
        for part, unit in (("position", "m"), ("rotation", "rad")):
            sizes = getattr(errors, part)
            if sizes is not None:
                figures |= {f"{errors.model} {part} {n}": getattr(sizes, n) * factors[unit]
                            for n in ("rms", "p95", "max")}
    return said, figures


@pytest.mark.long
@pytest.mark.parametrize("kind", ["6-UPS", "delta-linear"])
def test_validate_judges_the_same(campaigns, kind):
    (said, figures), (again, others) = (
        judged(face.validate(a.identified, a.data).record, a.identified.mechanism)
        for a in (campaigns(kind)[1], campaigns(kind, 0)[1]))
    assert again == said
    assert others == pytest.approx(figures, rel=1e-6, abs=1e-12)


@pytest.mark.slow
def test_the_report_says_the_same(campaigns, tmp_path):
    """In the same units: headline, what needs a look but for its places, figures of residuals."""
    said = []
    for seed in (None, 3):
        _, a = campaigns("delta-linear", seed)
        a.identified.save(tmp_path / "identified", force=True)
        said.append(face.make_report(tmp_path / "identified").content)
    plain, other = said
    assert other["headline"] == plain["headline"]
    assert [a["what"].partition(":")[0] for a in other["attention"]] == [
        a["what"].partition(":")[0] for a in plain["attention"]]


# --- decisions of diagnose ----------------------------------------------------------------------


HIDDEN = {"approach": "both", "effects": [
    {"kind": "backlash", "on": ["leg2"], "parameters": {"width": 0.04}}]}


def named(one, words):
    """Return the verdict, and each effect with the joints that it is on, in the first words."""
    w = written(one, words)
    machine = w.machine()
    found = face.diagnose(machine, w.data(machine), holdout=0,
                          kinds=["backlash", "friction", "gain"])
    return found.verdict, frozenset(
        (e.kind, frozenset(in_first_words(n, words) for n in e.on))
        for e in found.record.effects)


@pytest.mark.long
def test_diagnose_says_the_same_of_a_machine_in_space():
    """A 3-RPS with backlash; rows keep their order, which is the machine's way."""
    one = campaign("3-RPS", 40, **HIDDEN)
    plain = named(one, PLAIN)
    assert plain[1] == frozenset({("backlash", frozenset({"leg2"}))})
    rows = np.arange(len(one.table["x"]))
    assert named(one, replace(all_at_once("3-RPS", 0), rows=rows)) == plain
