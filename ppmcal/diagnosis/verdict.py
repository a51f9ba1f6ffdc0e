"""The verdict of diagnosis.md, step 11, what to look at, and what to do next."""

from __future__ import annotations

from collections.abc import Sequence

from ppmcal.calibration.fit import OVERSTATED, Fit, few_poses
from ppmcal.calibration.validation import LeftOut
from ppmcal.diagnosis.adequacy import TOO_MUCH, Remainder
from ppmcal.diagnosis.held_out_blocks import BlockGap
from ppmcal.diagnosis.held_out_gap import Gap
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.next_experiment import Proposal, nothing, propose
from ppmcal.diagnosis.result import Found, NamedEffect
from ppmcal.diagnosis.result_tables import measured_against
from ppmcal.diagnosis.rivals import Rival
from ppmcal.diagnosis.stage import Stage
from ppmcal.errors import NoResult
from ppmcal.wording import counted

Alternatives = dict[int, tuple[list[Rival], list[Hypothesis]]]
"""By named hypothesis: rivals in the library, and what was not recorded."""
FAR = 10.0
MOSTLY = 0.5
"""Effects that explain less than this of what exceeds the noise are no more than an imitation."""


def refuse_unconverged(fit: Fit) -> None:
    """Refuse a diagnosis that would be built on a fit which is not at its minimum.

    Raises:
        NoResult: with how far it got.
    """
    if fit.converged:
        return
    raise NoResult(
        f"the fit of the geometry did not converge: {fit.reached}, so no effect can be told from "
        "geometry", ", ".join(d.source for d in fit.problem.datasets),
        "These poses hardly tell the parameters apart: measure poses that differ in every "
        "coordinate, or free fewer parameters (--free)")


def refuse_unredundant(found: Found) -> None:
    """Refuse a diagnosis of values that geometry alone reproduces, whatever they are.

    Raises:
        NoResult: no degree of freedom is left that could show what is missing.
    """
    if found.first.search.test.freedom > 0:
        return
    data = found.before.problem.datasets
    raise NoResult(
        f"geometry explains each of these {counted(found.first.system.count, 'value')} exactly, "
        "whatever is measured: nothing is left that could show a missing effect",
        ", ".join(d.source for d in data), "Measure more poses, or free fewer parameters (--free)")


def decide(found: Found, left: Remainder, start: Remainder, effects: Sequence[NamedEffect],
           out: LeftOut, blocks: Sequence[BlockGap], imitated: bool) -> str:
    """Return the verdict.

    Args:
        found: fits and tests on the training rows.
        left: what the named effects leave.
        start: what geometry alone leaves.
        effects: what was named.
        out: the rows that were left out.
        blocks: the gap on stretches of time and of the environment.
        imitated: whether what was named only makes up a shape that none of it is.
    """
    search = found.first.search
    smallest = float(found.first.log_p.min(initial=0.0))
    # names that only imitate, of what is no more than noise without them, are none
    nothing = not effects or (imitated and start.adequate)
    adequate = (left if not effects else start).adequate and not out.suspicious
    if nothing:
        # far beyond chance, but no physical value fits
        if not adequate or smallest < search.name - FAR:
            return "unnamed"
        return "weak" if smallest < search.detect else "none"
    if imitated or not_predicted(blocks, left, start):
        return "unnamed"  # what does not predict, or only makes up a shape, is no name
    if not left.adequate:
        explained = (start.ratio**2 - left.ratio**2) / max(start.ratio**2 - 1.0, 1e-9)
        return _partial(found) if explained >= MOSTLY else "unnamed"
    if out.suspicious:
        return _partial(found)
    return "named-set" if any(e.alternatives for e in effects) else "named"


def _partial(found: Found) -> str:
    """Return the verdict where names leave something: of few poses they may be made of that."""
    return "unnamed" if any(few_poses(found.before)) else "partial"


def not_predicted(blocks: Sequence[BlockGap], left: Remainder, start: Remainder
                  ) -> list[BlockGap]:
    """Return the blocks that the effects do not predict as well as they explain all rows."""
    before, after = (max(0.0, r.ratio**2 - 1.0) for r in (start, left))
    if before <= 0.0:
        return []
    everywhere = max(0.0, 1.0 - (after / before) ** 0.5)
    return [b for b in blocks if b.fails(everywhere, left.excess < TOO_MUCH)]


def findings(before: Fit, after: Fit, left: Remainder, effects: Sequence[NamedEffect],
             gap: Gap | None, out: LeftOut, blocks: Sequence[BlockGap]) -> list[str]:
    """Return what the user must look at; ``blocks``: those that were not predicted."""
    said = [f for d in after.problem.datasets for f in d.findings]
    for data, reasons, old in zip(after.problem.datasets, after.reasons, before.reasons,
                                  strict=True):
        if reasons:
            said.append(f"{data.name}: {len(reasons)} of {len(data)} rows left out, see "
                        "residuals.csv for each reason")
        back = sorted(set(old) - set(reasons))
        if back:
            said.append(f"{data.name}: {counted(len(back), 'row')} at first taken for outliers, "
                        "explained by the effects and back in use")
    if out.sentence:
        said.append(out.sentence)
    if left.excess >= TOO_MUCH:
        said.append(f"what is left is {left.ratio:.2f} times the {left.source} noise: something "
                    "unrecorded, or a sigma that is too small")
    if left.ratio < OVERSTATED:
        said.append(f"residuals are only {left.ratio:.3g} times the {left.source} noise: sigma is "
                    "too large, in a wrong unit perhaps; correct it, it decides what geometry is "
                    "held to")
    weak = [e.hypothesis.called for e in effects if e.survival < 0.2]
    if weak:
        said.append(f"{', '.join(dict.fromkeys(weak))}: geometry imitates most of it (weakly "
                    "testable), so its size is uncertain")
    said += _sides(after, effects)
    if effects and gap is not None and not gap.confirmed:
        said.append("the held-out poses do not confirm the improvement: too few, or too small")
    said += [f"left out by {b.by} ({b.portion}), only {b.gap.closed or 0.0:.0%} of the gap "
             "is closed: what was found does not predict there" for b in blocks]
    if not after.converged:
        said.append(f"the fit had not converged after {after.iterations} iterations")
    return said


def _sides(fit: Fit, effects: Sequence[NamedEffect]) -> list[str]:
    """Return of which effects some joints lag their readings and some lead them: perhaps both do.

    Which side is a convention as much as a place of the encoder, so no file is refused for it.
    """
    if not effects:
        return []
    mechanism = fit.problem.mechanism.with_values(fit.state.g)
    joints: dict[str, dict[str, list[str]]] = {}
    for effect in effects:
        if side := effect.side(mechanism):
            joints.setdefault(effect.hypothesis.called, {}).setdefault(side, []).extend(
                effect.on or mechanism.actuators)
    return [f"{kind} has one sign on {', '.join(ways['lags'])} and the other on "
            f"{', '.join(ways['leads'])}: their encoders sit on different sides of it, or the "
            "directions of some are written the other way round"
            for kind, ways in joints.items() if len(ways) > 1]


def next_step(stage: Stage, alternatives: Alternatives, verdict: str, seed: int,
              gap: Gap | None = None) -> Proposal:
    """Return measurements that tell the first rivals apart, or what else to do."""
    joints = len(stage.system.problem.mechanism.actuators)
    for i, (others, _) in alternatives.items() if verdict != "unnamed" else ():
        if others and not stage.hypotheses[i].slot:
            likeliest = min(others, key=lambda r: r.odds)
            return propose(stage, stage.hypotheses[i], likeliest.hypothesis, likeliest.odds, seed)
    if verdict in ("named-set", "partial") and any(a for _, a in alternatives.values()):
        return nothing("measure again with a known payload (column payload): give under a "
                       "weight that was not recorded looks much like this", joints)
    if verdict == "named" and gap is not None and not gap.confirmed:
        return nothing("repeat the campaign, or measure more poses: those held out do not confirm "
                       "yet what is named", joints)
    against = next(measured_against(stage), None) if verdict == "unnamed" else None
    if against is not None and against.hypothesis.effect is not None:
        return nothing(against.hypothesis.effect.remedy, joints)
    return advice(verdict, joints)


def advice(verdict: str, joints: int) -> Proposal:
    """Return what to do where no measurements tell rivals apart."""
    return nothing({"none": "nothing more to measure: no missing effect is detectable",
                    "weak": "repeat the campaign: the suspicion grows or goes with more rows",
                    "named": "nothing more to measure: the named effects explain the residuals",
                    }.get(verdict, "record more of what might matter (load, temperature, time)"),
                   joints)
