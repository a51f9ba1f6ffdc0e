"""Solvers and decompositions: guarded in one place, refused by name, batch by batch."""

import ast
from pathlib import Path

import numpy as np
import pytest
from helpers.sources import nodes_of

import ppmcal
from ppmcal import linalg
from ppmcal.errors import LinearAlgebraError, NoResult

PACKAGE = Path(ppmcal.__file__).parent
HARMLESS = {"norm", "det", "slogdet"}
"""These never fail: what is not finite stays so."""
RNG = np.random.default_rng(5)
SQUARE = RNG.normal(size=(3, 4, 4)) + 4.0 * np.eye(4)
SPD = SQUARE @ np.swapaxes(SQUARE, -1, -2)
TALL = RNG.normal(size=(3, 7, 4))
RIGHT = RNG.normal(size=(3, 4, 2))

CALLS = {
    "solve": (lambda m: linalg.solve(m, RIGHT[:len(m)] if m.ndim > 2 else RIGHT[0]), SQUARE),
    "inv": (linalg.inv, SQUARE),
    "cholesky": (linalg.cholesky, SPD),
    "eigh": (linalg.eigh, SPD),
    "eigvalsh": (linalg.eigvalsh, SPD),
    "triangle": (linalg.triangle, TALL),
    "column_basis": (linalg.column_basis, TALL),
    "svd": (linalg.svd, TALL),
    "singular_values": (linalg.singular_values, TALL),
    "pinv": (linalg.pinv, TALL),
    "lstsq": (lambda m: linalg.lstsq(m if m.ndim == 2 else m[0], np.ones(7)), TALL),
    "largest_singular": (lambda m: linalg.largest_singular(m if m.ndim == 2 else m[0]), TALL),
    "condition": (lambda m: linalg.condition(m if m.ndim == 2 else m[0]), TALL),
    "general eigh": (lambda m: linalg.eigh(m[0] if m.ndim > 2 else m, metric=np.eye(4)), SPD),
}


def solver_calls(nodes):
    """Yield line and name of what nodes of a module take of NumPy's or SciPy's linear algebra."""
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and (node.module or "").endswith("linalg") and not (
                node.module or "").startswith("ppmcal"):
            yield node.lineno, f"from {node.module}"
        if isinstance(node, ast.Import) and any(
                a.name.endswith("linalg") and not a.name.startswith("ppmcal") for a in node.names):
            yield node.lineno, "import linalg"
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Attribute) and (
                node.value.attr == "linalg") and node.attr not in HARMLESS:
            yield node.lineno, node.attr
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and (
                node.func.attr == "norm") and len(node.args) > 1 and (
                getattr(node.args[1], "value", None) not in (1, np.inf)):
            yield node.lineno, "norm of a matrix by its singular values"


def test_no_module_but_one_calls_a_solver_of_numpy_or_scipy():
    found = [f"{path.relative_to(PACKAGE)}:{line}: {name}"
             for path in PACKAGE.rglob("*.py")
             if path != PACKAGE / "linalg.py" and not path.name.startswith("compiled_")
             for line, name in solver_calls(nodes_of(path))]
    assert found == []


def test_that_check_would_see_a_solver():
    text = ("import scipy.linalg\nfrom numpy.linalg import solve\nx = np.linalg.inv(a)\n"
            "try:\n  pass\nexcept np.linalg.LinAlgError:\n  pass\ny = np.linalg.norm(a, 2)\n"
            "z = np.linalg.norm(a, axis=1)\n")
    assert sorted(line for line, _ in solver_calls(ast.walk(ast.parse(text)))) == [1, 2, 3, 6, 8]


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("batch", [False, True])
def test_what_is_not_finite_is_refused_by_name(name, bad, batch):
    call, sound = CALLS[name]
    matrix = sound.copy() if batch else sound[0].copy()
    matrix[(0,) * matrix.ndim] = bad
    with pytest.raises(LinearAlgebraError, match="could not be computed") as caught:
        call(matrix)
    assert isinstance(caught.value, NoResult) and caught.value.exit_code == 3
    assert "sigmas" in caught.value.hint


@pytest.mark.parametrize("name", CALLS)
def test_sound_matrices_of_any_size_are_taken(name):
    call, sound = CALLS[name]
    for size in (1e-120, 1.0, 1e120):
        for matrix in (sound, sound[0]):
            found = call(size * matrix)
            for part in found if isinstance(found, tuple) else (found,):
                assert np.isfinite(part).all()


@pytest.mark.parametrize("call", [lambda m: linalg.solve(m, np.ones((4, 1))), linalg.inv,
                                  linalg.cholesky])
@pytest.mark.parametrize("batch", [False, True])
def test_a_singular_matrix_is_refused_with_the_reason(call, batch):
    matrix = np.zeros((3, 4, 4)) if batch else np.zeros((4, 4))
    with pytest.raises(LinearAlgebraError, match=r"singular|positive definite"):
        call(matrix)


def test_what_was_to_be_had_is_said():
    with pytest.raises(LinearAlgebraError, match=r"^the step of the fit could not be computed"):
        linalg.solve(np.zeros((2, 2)), np.ones(2), "the step of the fit")


def test_each_equals_numpys_own():
    assert np.array_equal(linalg.solve(SQUARE, RIGHT), np.linalg.solve(SQUARE, RIGHT))
    assert np.array_equal(linalg.inv(SQUARE), np.linalg.inv(SQUARE))
    assert np.array_equal(linalg.cholesky(SPD), np.linalg.cholesky(SPD))
    assert np.array_equal(linalg.eigvalsh(SPD), np.linalg.eigvalsh(SPD))
    assert np.array_equal(linalg.pinv(TALL), np.linalg.pinv(TALL))
    assert np.array_equal(linalg.triangle(TALL), np.linalg.qr(TALL, mode="r"))
    assert np.array_equal(linalg.column_basis(TALL), np.linalg.qr(TALL)[0])
    for thin, numpys in zip(linalg.svd(TALL), np.linalg.svd(TALL, full_matrices=False),
                            strict=True):
        assert np.array_equal(thin, numpys)
    assert linalg.svd(TALL, full=True)[0].shape == (3, 7, 7)
    solution, rank = linalg.lstsq(TALL[0], np.ones(7))
    assert np.array_equal(solution, np.linalg.lstsq(TALL[0], np.ones(7), rcond=None)[0])
    assert rank == 4
    assert linalg.condition(SQUARE[0]) == pytest.approx(np.linalg.cond(SQUARE[0]))
    assert linalg.largest_singular(TALL[0]) == pytest.approx(np.linalg.norm(TALL[0], 2))
    assert linalg.condition(np.zeros((2, 2))) == np.inf
    assert linalg.largest_singular(np.zeros((0, 3))) == 0.0


def test_a_generalised_eigenvalue_problem():
    metric = SPD[1]
    w, v = linalg.eigh(SPD[0], metric=metric)
    assert SPD[0] @ v == pytest.approx(metric @ v * w)
    with pytest.raises(LinearAlgebraError):
        linalg.eigh(SPD[0], metric=-metric)


@pytest.mark.parametrize("full", [False, True])
def test_where_divide_and_conquer_fails_qr_iteration_serves(monkeypatch, full):
    expected = np.linalg.pinv(TALL)
    solution = np.linalg.lstsq(TALL[0], np.ones(7), rcond=None)[0]

    def fails(*_, **__):
        raise np.linalg.LinAlgError("SVD did not converge")

    for name in ("svd", "pinv", "lstsq"):
        monkeypatch.setattr(np.linalg, name, fails)
    u, s, vt = linalg.svd(TALL, full)
    assert u.shape == ((3, 7, 7) if full else (3, 7, 4))
    assert (u[..., :4] * s[..., None, :]) @ vt == pytest.approx(TALL)
    assert linalg.singular_values(TALL) == pytest.approx(s)
    assert linalg.pinv(TALL) == pytest.approx(expected)
    found, rank = linalg.lstsq(TALL[0], np.ones(7))
    assert found == pytest.approx(solution)
    assert rank == 4


def test_rows_that_are_singular_give_nan_and_the_others_their_solution():
    matrix = SQUARE.copy()
    matrix[1] = 0.0
    found = linalg.solve_rows(matrix, RIGHT[..., 0])
    assert np.isnan(found[1]).all()
    for n in (0, 2):
        assert found[n] == pytest.approx(np.linalg.solve(matrix[n], RIGHT[n, :, 0]))


def test_a_library_that_fails_inside_is_refused_by_name():
    with pytest.raises(LinearAlgebraError, match=r"^the fit could not be computed"), \
            linalg.guarded("the fit"):
        raise np.linalg.LinAlgError("inside")
