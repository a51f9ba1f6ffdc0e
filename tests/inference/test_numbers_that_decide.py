"""Every number that decides what is in the data stands in one table, which a command prints."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from helpers.commands import ppmcal
from helpers.sources import nodes_of, tree_of

import ppmcal as package
from ppmcal.inference.priors import CORRELATIONS, SURE, SURE_ODDS, SURE_SIGMAS, sure, table

ROOT = Path(package.__file__).parent
MODULES = sorted(p for room in ("diagnosis", "inference") for p in (ROOT / room).glob("*.py")
                 if p.name != "priors.py")
OTHERS = {
    # a search ends, memory is bounded, a grid has points
    "bound": {
        "diagnose.MOST_STEPS", "equations.BAND_DRAWS", "explanation.BESIDE", "explanation.ROUNDS",
        "grids.NEAR",
        "held_out_gap.DRAWS", "held_out_gap.TOGETHER", "linear_system.MOST_ROWS",
        "localization.DRAWS", "misread_columns.FEWEST", "misread_columns.LIKELY",
        "next_experiment.POSES", "next_experiment.WIDER", "onsets.NEAR", "onsets.ROUNDS",
        "other_models.MOST_READINGS", "own_noise.LESS", "plot_data.ITERATIONS",
        "refit.MOST_STEPS",
        "refit.NEAR", "residual_profiles.MOST_ROWS", "residual_series.MOST_SERIES",
        "thinning.LEAST", "thinning.MOST_STRATA", "thinning.MOST_VALUES", "thinning.SAME_LOAD",
        "unknown_causes.MOST_PLACES", "unknown_causes.MOST_SCATTERED", "unknown_courses.WAVES",
        "block_sets.ROUNDS", "blocks.CHUNK",
        "columns.KEPT", "correlation.BLOCK", "evidence.WIDE", "gross_rows.SWEEPS", "joint.SWEEPS",
        "joint.WIDEST",
        "one_sided.HUBER",
        "moves.CLOSE", "moves.DEEP", "moves.FIRSTS", "moves.MOST",
        "moves.MOST_FORMS", "moves.SETS", "question.KEPT", "row_weights.AT_ONCE", "sets.MOVES",
        "term_candidates.PER_NODE", "unknown_functions.FINEST", "learned_shapes.POINTS"},
    # what is smaller changes no digit that is told
    "round-off": {
        "hypotheses.AS_ROUND_OFF",
        "block_sets.NEGLIGIBLE", "gross_rows.LOST", "moves.LEAST_GAIN", "pairs.ROUND_OFF",
        "ranges.FAR", "ranges.LEAST", "ranges.TINY", "one_sided.STILL",
        "learning.ROUND_OFF", "learning.UNSEEN",
        "linear_system.RANK", "session_effects.SEEN", "unknown_causes.ROUND_OFF",
        "derived_errors.SMALL", "extended_model.SMALLEST"},
    # what rows can show at all, in sigmas, or as a part that geometry leaves
    "seen": {
        "candidates.APART", "candidates.SEEN", "cause_sizes.LINEAR", "held_out_gap.UNPREDICTED",
        "linear_system.INVISIBLE", "observed_directions.HALF", "onsets.IN_STATE", "onsets.LINEAR",
        "predictive.UNPREDICTED", "linearisation.VISIBLE", "linearisation.WEAK_VISIBILITY",
        "term_candidates.BEYOND", "term_candidates.MARGIN", "term_candidates.TWIN",
        "term_candidates.SEEN_BETTER",
        "left_out_schemes.LEVELS", "library_columns.FEW", "left_over_pattern.FEW"},
    # which words a shape has, what is drawn
    "words": {
        "equation_forms.INNER", "equation_forms.POWERS", "learned_shapes.KINK",
        "learned_shapes.MOSTLY", "learned_shapes.RARE", "left_over_pattern.ALIKE",
        "left_over_pattern.MOSTLY", "left_over_pattern.RESIDUAL", "left_over_pattern.SHOWN",
        "left_over_pattern.VISIBLE", "plot_data.MANY_OUT"},
    # lengths of kernels, of which the data tell
    "kernels": {"kernels.FINER", "kernels.LENGTHS", "kernels.SECOND", "term_candidates.PAIRED",
                "unknown_memories.FADES"},
}
HALF = {"explanation": 1}
"""Comparisons with 1/2, of what is likelier than not."""


def numbers(module: Path) -> set[str]:
    """Return the constants of a module that are numbers, or several."""
    found = set()
    for node in tree_of(module).body:
        targets = node.targets if isinstance(node, ast.Assign) else []
        for target in targets:
            if isinstance(target, ast.Name) and target.id.isupper() and of_numbers(node.value):
                found.add(f"{module.stem}.{target.id}")
    return found


def of_numbers(value: ast.expr) -> bool:
    try:
        made = eval(compile(ast.Expression(value), "", "eval"), {"__builtins__": {}})
    except Exception:
        return False
    some = made if isinstance(made, tuple) else (made,)
    return bool(some) and all(isinstance(v, (int, float)) for v in some)


def test_no_number_that_decides_stands_elsewhere() -> None:
    """A new one is a bound, round-off, a matter of what rows show, of words; or a prior."""
    known = set().union(*OTHERS.values())
    found = set().union(*(numbers(m) for m in MODULES))
    assert found - known == set()
    assert known - found == set()


@pytest.mark.parametrize("module", MODULES, ids=lambda m: m.stem)
def test_no_bare_number_decides(module: Path) -> None:
    """Comparisons are with names, small counts or round-off."""
    halves = 0
    for node in nodes_of(module):
        for part in [node.left, *node.comparators] if isinstance(node, ast.Compare) else ():
            value = part.value if isinstance(part, ast.Constant) else None
            if isinstance(value, float) and abs(value) > 1e-6 and value != 1.0:
                assert value == 0.5, (module.stem, node.lineno, ast.unparse(node))
                halves += 1
    assert halves == HALF.get(module.stem, 0)


def test_the_command_prints_each_with_its_reason() -> None:
    run = ppmcal("diagnose", "--priors", expect=0)
    said = " ".join(run.out.split())
    for name, prior in table().items():
        assert f"{name.lower().replace('_', ' ')}: {prior.value:.4g} {prior.reason}" in said
    assert f"correlations: {', '.join(f'{c:g}' for c in CORRELATIONS)}" in said
    assert max(map(len, run.out.splitlines())) <= 80


def test_sure_is_one_number_in_three_forms() -> None:
    assert not sure(SURE_ODDS) and sure(1.001 * SURE_ODDS)
    assert abs(SURE_ODDS / (1.0 + SURE_ODDS) - SURE.value) < 1e-12
    assert 1.6 < SURE_SIGMAS < 1.7
