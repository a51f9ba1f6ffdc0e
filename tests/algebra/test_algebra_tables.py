"""The general products against `clifford`, and the explicit formulas against the products."""

from __future__ import annotations

import importlib
import warnings
from typing import Any

import numpy as np
import pytest

from ppmcal import algebra as cga
from ppmcal.algebra.blades import BASIS, CANONICAL, parse_blade
from ppmcal.errors import BadInput

SHAPES = [(), (3,), (2, 3)]
NAMED = {"scalar": cga.SCALAR, "vector": cga.VECTOR, "motor": cga.MOTOR, "twist": cga.TWIST}
NAMED |= {"line": cga.LINE, "pair": cga.PAIR, "full": cga.FULL}


class Oracle:
    """Our 32 blades as multivectors of `clifford`, Cl(4, 1)."""

    def __init__(self) -> None:
        """Build e∞ and e0 from e+ and e−, and every blade as an outer product."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self.layout, blades = importlib.import_module("clifford").Cl(4, 1)
            plus, minus = blades["e4"], blades["e5"]
            factors = [blades["e1"], blades["e2"], blades["e3"], minus + plus, (minus - plus) / 2]
            self.vectors = dict(zip(BASIS, factors, strict=True))
            self.basis = np.array([self.blade(name).value for name in CANONICAL])
            self.back = np.linalg.inv(self.basis)

    def blade(self, name: str) -> Any:
        """Return a blade as a multivector; the order of the factors is the name's."""
        out = self.layout.scalar
        rest = name[1:]
        while rest:
            factor = next(f for f in BASIS if rest.startswith(f))
            out, rest = out ^ self.vectors[factor], rest[len(factor) :]
        return out

    def lift(self, blades: cga.Blades, a: cga.Array) -> Any:
        """Return one multivector from its components."""
        basis = np.array([self.blade(name).value for name in blades.names])
        return self.layout.MultiVector(value=a @ basis)

    def lower(self, blades: cga.Blades, multivector: Any) -> cga.Array:
        """Return the components of a multivector; what `blades` cannot hold must be zero."""
        canonical = dict(zip(CANONICAL, multivector.value @ self.back, strict=True))
        by_mask = {parse_blade(n)[0]: parse_blade(n)[1] * v for n, v in canonical.items()}
        out = [s * by_mask.pop(m) for m, s in zip(blades.masks, blades.signs, strict=True)]
        np.testing.assert_allclose(list(by_mask.values()), 0, atol=1e-12)
        return np.array(out)


@pytest.fixture(scope="module")
def oracle() -> Oracle:
    """Import `clifford` once."""
    return Oracle()


@pytest.fixture
def rng() -> np.random.Generator:
    """A fresh generator of fixed seed."""
    return np.random.default_rng(41)


@pytest.mark.slow
@pytest.mark.parametrize("right", ["vector", "motor", "line", "full"])
@pytest.mark.parametrize("left", ["vector", "motor", "pair", "full"])
@pytest.mark.parametrize("kind", ["geometric", "outer", "inner"])
def test_product_is_cliffords(
    kind: Any, left: str, right: str, oracle: Oracle, rng: np.random.Generator
) -> None:
    table = cga.product(kind, NAMED[left], NAMED[right])
    a = rng.normal(size=(2, len(table.left)))
    b = rng.normal(size=(2, len(table.right)))
    ours = table(a, b)
    for index in range(2):
        x, y = oracle.lift(table.left, a[index]), oracle.lift(table.right, b[index])
        theirs = {"geometric": lambda x=x, y=y: x * y, "outer": lambda x=x, y=y: x ^ y}.get(
            kind, lambda x=x, y=y: x.lc(y)
        )()
        np.testing.assert_allclose(ours[index], oracle.lower(table.out, theirs), atol=1e-12)


@pytest.mark.long_cases("scalar", "vector")
@pytest.mark.slow
@pytest.mark.parametrize("name", NAMED)
def test_dual_and_reverse_are_cliffords(
    name: str, oracle: Oracle, rng: np.random.Generator
) -> None:
    blades = NAMED[name]
    x = rng.normal(size=len(blades))
    theirs = oracle.lift(blades, x)
    dual = cga.dual(blades)
    np.testing.assert_allclose(dual(x), oracle.lower(dual.out, theirs.dual()), atol=1e-12)
    np.testing.assert_allclose(
        cga.reverse_blades(blades)(x), oracle.lower(blades, ~theirs), atol=1e-12
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["vector", "twist", "line", "pair", "full"])
def test_sandwich_is_cliffords(name: str, oracle: Oracle, rng: np.random.Generator) -> None:
    motor = cga.motor_exp(rng.normal(size=6))
    x = rng.normal(size=len(NAMED[name]))
    sandwich = cga.sandwich(cga.MOTOR, NAMED[name])
    m = oracle.lift(cga.MOTOR, motor)
    theirs = m * oracle.lift(NAMED[name], x) * ~m
    np.testing.assert_allclose(sandwich(motor, x), oracle.lower(sandwich.out, theirs), atol=1e-12)


@pytest.mark.slow
def test_sandwich_by_a_reflection(oracle: Oracle, rng: np.random.Generator) -> None:
    mirror, x = cga.sphere(rng.normal(size=3), 1.3), rng.normal(size=10)
    sandwich = cga.sandwich(cga.VECTOR, cga.PAIR)
    v = oracle.lift(cga.VECTOR, mirror)
    theirs = v * oracle.lift(cga.PAIR, x) * ~v
    np.testing.assert_allclose(sandwich(mirror, x), oracle.lower(sandwich.out, theirs), atol=1e-12)


@pytest.mark.slow
def test_meet_is_cliffords(oracle: Oracle, rng: np.random.Generator) -> None:
    spheres = rng.normal(size=(4, 3, 5))
    spheres[1:, 0, 4] = 0.0  # the first is a plane, then two and three planes
    spheres[2:, 1, 4] = 0.0
    spheres[3:, 2, 4] = 0.0
    for triple in spheres:
        s1, s2, s3 = (oracle.lift(cga.VECTOR, s) for s in triple)
        theirs = oracle.lower(cga.PAIR, (s1 ^ s2 ^ s3).dual())
        np.testing.assert_allclose(cga.meet(*triple), theirs, atol=1e-11)


@pytest.mark.slow
def test_typed_vectors_are_cliffords(oracle: Oracle, rng: np.random.Generator) -> None:
    x, r = rng.normal(size=3), 0.7
    euclidean = sum(x[i] * oracle.vectors[BASIS[i]] for i in range(3))
    inf, origin = oracle.vectors["inf"], oracle.vectors["0"]
    ball = euclidean + (0.5 * (x @ x - r * r)) * inf + origin
    np.testing.assert_allclose(cga.sphere(x, r), oracle.lower(cga.VECTOR, ball), atol=1e-14)
    flat = euclidean + 0.4 * inf
    np.testing.assert_allclose(cga.plane(x, 0.4), oracle.lower(cga.VECTOR, flat), atol=1e-14)
    np.testing.assert_allclose(cga.inner(cga.sphere(x, r), cga.plane(x, 0.4)), (ball | flat)[()])


def test_structure_constants_are_exact() -> None:
    values = {abs(term[3]) for term in cga.product("geometric", cga.FULL, cga.FULL).terms}
    assert values <= {0.5, 1.0, 2.0}


def test_metric() -> None:
    gram = cga.product("inner", cga.VECTOR, cga.VECTOR)(np.eye(5)[:, None], np.eye(5))[..., 0]
    expected = np.diag([1.0, 1, 1, 0, 0])
    expected[3, 4] = expected[4, 3] = -1
    np.testing.assert_array_equal(gram, expected)


@pytest.mark.parametrize("shape", SHAPES)
def test_explicit_formulas_are_the_tables(shape: tuple[int, ...], rng: np.random.Generator) -> None:
    a, b = rng.normal(size=(2, *shape, 8))
    np.testing.assert_allclose(
        cga.product("geometric", cga.MOTOR, cga.MOTOR)(a, b), cga.compose(a, b), atol=1e-13
    )
    np.testing.assert_array_equal(cga.reverse_blades(cga.MOTOR)(a), cga.reverse(a))
    m = cga.motor_exp(rng.normal(size=(*shape, 6)))
    v, screw = rng.normal(size=(*shape, 5)), rng.normal(size=(*shape, 6))
    for blades, x, explicit in (
        (cga.VECTOR, v, cga.move_vector),
        (cga.LINE, screw, cga.move_line),
        (cga.TWIST, screw, cga.adjoint_twist),
    ):
        table = cga.sandwich(cga.MOTOR, blades)
        assert table.out == blades
        np.testing.assert_allclose(table(m, x), explicit(m, x), atol=1e-12)
    inner = cga.product("inner", cga.VECTOR, cga.VECTOR)(v, 2 * v + 1)[..., 0]
    np.testing.assert_allclose(inner, cga.inner(v, 2 * v + 1), atol=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_lines_and_pairs_are_the_tables(shape: tuple[int, ...], rng: np.random.Generator) -> None:
    p, s, u = rng.normal(size=(3, *shape, 5))
    wedge = cga.product("outer", cga.VECTOR, cga.VECTOR)
    assert wedge.out == cga.PAIR
    line = cga.product("outer", cga.PAIR, cga.Blades(("einf",)), cga.LINE)(wedge(p, s), [1.0])
    np.testing.assert_allclose(cga.leg_line(p, s), line, atol=1e-12)
    triple = cga.product("outer", cga.PAIR, cga.VECTOR)
    dual = cga.dual(triple.out)
    assert dual.out == cga.PAIR
    np.testing.assert_allclose(
        cga.meet(p, s, u), dual(triple(wedge(p, s), u)), rtol=1e-9, atol=1e-9
    )
    square = cga.product("geometric", cga.PAIR, cga.PAIR, cga.SCALAR)
    pair = wedge(p, s)
    np.testing.assert_allclose(cga.split(pair)[2], square(pair, pair)[..., 0], atol=1e-12)


def test_twist_bivector_generates_the_motor(rng: np.random.Generator) -> None:
    twist = 0.1 * rng.normal(size=6)
    product = cga.product("geometric", cga.MOTOR, cga.TWIST, cga.MOTOR)
    total = term = cga.identity_motor()
    for order in range(1, 15):
        term = product(term, -0.5 * twist) / order
        total = total + term
    np.testing.assert_allclose(cga.motor_exp(twist), total, atol=1e-15)


def test_duality_swaps_the_products(rng: np.random.Generator) -> None:
    a, b = rng.normal(size=5), rng.normal(size=10)
    wedge = cga.product("outer", cga.VECTOR, cga.PAIR)
    left = cga.dual(wedge.out)(wedge(a, b))
    dual = cga.dual(cga.PAIR)
    right = cga.product("inner", cga.VECTOR, dual.out, cga.dual(wedge.out).out)(a, dual(b))
    np.testing.assert_allclose(left, right, atol=1e-13)


def test_orientation_of_a_name_is_its_sign() -> None:
    left, right = cga.Blades(("e31",)), cga.Blades(("e13",))
    table = cga.product("geometric", left, cga.Blades(("e1",)))
    other = cga.product("geometric", right, cga.Blades(("e1",)))
    assert table.out.names == ("e3",)
    np.testing.assert_array_equal(table([1.0], [1.0]), -other([1.0], [1.0]))


def test_tables_are_cached_and_smallest() -> None:
    table = cga.product("geometric", cga.MOTOR, cga.MOTOR)
    assert table is cga.product("geometric", cga.MOTOR, cga.MOTOR)
    assert table.out == cga.MOTOR
    assert len(table.terms) == 48
    assert cga.sandwich(cga.MOTOR, cga.VECTOR) is cga.sandwich(cga.MOTOR, cga.VECTOR)


def test_wrong_names_say_what_is_allowed() -> None:
    with pytest.raises(BadInput, match=r"e12.*Did you mean 'einf'"):
        cga.Blades(("einff",))
    for name in ("", "e", "x1", "e11", "e4"):
        with pytest.raises(BadInput, match="Allowed: 1, e1"):
            cga.Blades((name,))
    with pytest.raises(BadInput, match="twice"):
        cga.Blades(("e12", "e21"))
    with pytest.raises(BadInput, match=r"geometric, outer, inner.*'outer'"):
        cga.product("outerr", cga.VECTOR, cga.VECTOR)
    with pytest.raises(ValueError, match="left factor of the outer product needs 5"):
        cga.product("outer", cga.VECTOR, cga.VECTOR)(np.zeros(4), np.zeros(5))
