"""Simulated measuring campaigns in which effects are hidden, to try a diagnosis on.

    from hidden import Options, hide
    found = hide("6-UPS", 7, ["backlash", "leg_thermal"], 0.5, Options(poses=60))
    found.mechanism, found.dataset, found.truth

A campaign visits every pose twice, approached from opposite sides, in random order; payload,
speed and temperature do not depend on the pose. An effect's size is eta: the RMS over all
residual coordinates of what it changes in them, whitened by the stated noise and projected off
geometry, frame and target. Everything is seeded and in SI.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from hidden_effects import LIBRARY
from hidden_scene import (
    Absorbed,
    Array,
    Cause,
    Impossible,
    Scene,
    Unphysical,
    Values,
    measure,
    signed,
    solved,
    times,
)
from hidden_session import (
    Machine,
    Options,
    drawn_scene,
    joint_noise,
    machines,
    recorded,
    stream,
    with_noise,
)
from hidden_unknown import KINDS, UNKNOWN
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ppmcal.calibration.fit import Problem, State, coordinates
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism

RANK = 1e-9
"""Directions of the Jacobian below this part of the strongest are none."""
ABSORBED = 0.02
"""An effect of which less than this part survives the projection cannot be scaled."""
MATTERS = 0.2
"""A frozen slot is chosen so that one tolerance of error has at least this eta ..."""
PLAIN, TRIES = 0.1, 6
"""... and so that at least this part of it survives, if there is one among so many tried."""
USUAL = Options()
HOTTEST = 30e-6
"""No part expands by more, per K."""

__all__ = ["ABSORBED", "KINDS", "LIBRARY", "UNKNOWN", "Absorbed", "Cause", "Hidden",
           "Impossible", "Machine", "Options", "Truth", "Unphysical", "applicable", "campaign",
           "draw", "hide", "imitation", "machines", "scaled"]


@dataclass(frozen=True)
class Truth:
    """What was hidden: ``eta`` as built (alone, against the truth), ``survival`` |MC|/|C|."""

    kind: str
    on: tuple[str, ...]
    parameters: Values
    eta: float
    survival: float


@dataclass(frozen=True)
class Hidden:
    """A campaign and what is hidden in it.

    ``mechanism``: as drawn, with frozen slots not free; ``outliers``: row indices;
    ``scene``: the session without effects, with the true geometry ``scene.g`` (without the
    errors of frozen slots) and ``scene.registration``.
    """

    mechanism: Mechanism
    dataset: Dataset
    truth: tuple[Truth, ...]
    causes: tuple[Cause, ...]
    outliers: NDArray[np.int64]
    scene: Scene


@dataclass(frozen=True, eq=False)
class Sizing:
    """How effects of a scene are sized: ``basis`` (N m, r) of what a fit absorbs."""

    scene: Scene
    data: Dataset
    whitener: Array
    basis: Array

    def white(self, cause: Cause) -> Array:
        """Return what a cause adds to the whitened measurements (N m,)."""
        motion = self.scene.mechanism.motion
        shown = list(coordinates(self.data, motion))
        before = measure(self.scene)
        after = measure(self.scene, [KINDS[cause.kind].change(self.scene, cause)])
        turn = (Rotation.from_rotvec(after[:, 3:])
                * Rotation.from_rotvec(before[:, 3:]).inv()).as_rotvec()
        difference = np.concatenate([after[:, :3] - before[:, :3], turn], axis=1)[:, shown]
        return np.asarray((self.whitener @ difference[..., None]).reshape(-1), dtype=float)

    def left(self, white: Array) -> Array:
        """Return the part of whitened columns (N m, ...) that no fit absorbs."""
        rest = white - self.basis @ (self.basis.T @ white)
        return np.asarray(rest - self.basis @ (self.basis.T @ rest), dtype=float)

    def of(self, cause: Cause) -> tuple[float, float]:
        """Return eta and survival of a cause."""
        white = self.white(cause)
        whole, rest = float(np.linalg.norm(white)), float(np.linalg.norm(self.left(white)))
        return rest / float(np.sqrt(white.size)), rest / whole if whole > 0.0 else 0.0


@lru_cache(maxsize=4)
def _scene(machine: str, seed: int, options: Options, frozen: tuple[str, ...]) -> Scene:
    """Return the session without effects; ``frozen`` slots are not free and as drawn."""
    if not frozen:
        return drawn_scene(machines()[machine], seed, options)
    scene = _scene(machine, seed, options, ())
    mechanism, g = scene.mechanism, scene.g.copy()
    held = [mechanism.names.index(name) for name in frozen]
    g[held] = mechanism.nominals[held]
    free = tuple(p for p in mechanism.free if p not in held)
    mechanism = replace(mechanism, free=free,
                        free_patterns=tuple(mechanism.names[p] for p in free))
    changed = replace(scene, mechanism=mechanism, g=g)
    return replace(changed, pose=solved(changed.model, scene.q, scene.pose, scene.q))


@lru_cache(maxsize=4)
def _sizing(machine: str, seed: int, options: Options, frozen: tuple[str, ...]) -> Sizing:
    """Return the projection of a session at the true geometry, frame and target."""
    scene = _scene(machine, seed, options, frozen)
    data = recorded(scene, measure(scene), options, seed)
    problem = Problem(scene.mechanism, (data,), scene.mechanism.free)
    rows = list(problem.rows(State(scene.g, (scene.registration,), (scene.pose,))))
    jacobian = np.concatenate([r.jacobian for r in rows])
    flat = jacobian.reshape(-1, jacobian.shape[-1])
    norms = np.linalg.norm(flat, axis=0)
    u, s, _ = np.linalg.svd(flat / np.where(norms > 0.0, norms, 1.0), full_matrices=False)
    return Sizing(scene, data, np.concatenate([r.whitener for r in rows]), u[:, s > RANK * s[0]])


def frozen_by(causes: Sequence[Cause]) -> tuple[str, ...]:
    """Return the slots that causes freeze."""
    return tuple(name for c in causes if c.kind == "geometry" for name in c.parameters)


def applicable(machine: str) -> tuple[str, ...]:
    """Return the kinds, known and unknown, that make sense on a machine."""
    mechanism = machines()[machine]()
    return tuple(name for name, kind in KINDS.items() if kind.fits(mechanism))


def draw(machine: str, seed: int, kind: str, options: Options = USUAL,
         on: str | Sequence[str] | None = None) -> Cause:
    """Return a random cause at a small size.

    Args:
        machine, seed, options: of the campaign.
        kind: a key of :data:`KINDS`.
        on: ``all`` actuators, ``one``, ``some`` of them, or their names; default: any of these
            (one actuator where the library does not know the kind).
    """
    rng = np.random.default_rng([seed, zlib.crc32(kind.encode())])
    if kind == "geometry":
        return _frozen_slot(machine, seed, options, rng)
    scene = _scene(machine, seed, options, ())
    names: tuple[str, ...] = ()
    if KINDS[kind].joints:
        names = _chosen(scene.mechanism.actuators, kind, on, rng)
    return Cause(kind, names, KINDS[kind].draw(scene, rng), seed)


def _chosen(actuators: Sequence[str], kind: str, on: str | Sequence[str] | None,
            rng: np.random.Generator) -> tuple[str, ...]:
    if on is None:
        on = str(rng.choice(("one",) if kind in UNKNOWN else ("all", "one", "some")))
    if not isinstance(on, str):
        return tuple(on)
    counts = {"all": len(actuators), "one": 1, "some": int(rng.integers(2, len(actuators)))}
    picked = set(rng.choice(len(actuators), counts[on], replace=False).tolist())
    return tuple(a for i, a in enumerate(actuators) if i in picked)


def _frozen_slot(machine: str, seed: int, options: Options, rng: np.random.Generator) -> Cause:
    """Return an error of one tolerance in a slot that shows once it is frozen.

    Where one slot alone hardly shows, the same slot of all limbs is frozen (with error 0).
    """
    mechanism = machines()[machine]()
    sizes = {p.name: float(p.tolerance) for i, p in enumerate(mechanism.parameters)
             if p.tolerance and np.isfinite(p.tolerance) and (p.fixed or i in mechanism.free)}
    best, most = None, ABSORBED
    for tried, name in enumerate(rng.permutation(np.array(list(sizes), dtype=object)), 1):
        alike = [n for n in sizes if "." in n and n.split(".", 1)[1] == name.split(".", 1)[-1]]
        for names in ([name], alike) if len(alike) > 1 else ([name],):
            cause = Cause("geometry", (), {n: sizes[n] if n == name else 0.0 for n in names}, seed)
            eta, survival = _sizing(machine, seed, options, frozen_by([cause])).of(cause)
            if eta > MATTERS and survival > most:
                best, most = cause, survival
        if most > PLAIN or (best and tried >= TRIES):
            break
    if best is None:
        raise Absorbed(f"{machine}: no frozen slot shows")
    return times(best, KINDS["geometry"], signed(rng))


def scaled(machine: str, seed: int, effect: Cause, eta: float,
           options: Options = USUAL,
           frozen: tuple[str, ...] = ()) -> Cause:
    """Return the cause at the size at which its unabsorbed contribution is ``eta``.

    ``frozen``: slots that other causes of the campaign freeze.

    Raises:
        Absorbed: hardly anything of it survives the projection.
        Unphysical: a part would have to expand by more than :data:`HOTTEST`.
    """
    sizing = _sizing(machine, seed, options,
                     tuple(dict.fromkeys((*frozen, *frozen_by([effect])))))
    kind = KINDS[effect.kind]
    for _ in range(3):
        now, survival = sizing.of(effect)
        if survival < ABSORBED:
            raise Absorbed(f"{machine}: the geometry swallows {effect.kind} on "
                           f"{', '.join(effect.on) or 'the machine'} (survival {survival:.1e})")
        effect = times(effect, kind, eta / now)
        if eta == 0.0 or abs(eta / now - 1.0) < 1e-3:
            break
    if abs(effect.parameters.get("expansion", 0.0)) > HOTTEST:
        raise Unphysical(f"{machine}: {effect.kind} would need more than {HOTTEST} per K")
    return effect


def campaign(machine: str, seed: int, effects: Sequence[Cause] = (),
             options: Options = USUAL) -> Hidden:
    """Return a measuring campaign in which ``effects`` are hidden."""
    sizing = _sizing(machine, seed, options, frozen_by(effects))
    scene = sizing.scene
    jitter = joint_noise(scene, options) * stream(seed, 9).normal(size=scene.q.shape)
    seen = measure(scene, [KINDS[c.kind].change(scene, c) for c in effects],
                   jitter if options.actuator != (0.0, 0.0) else None)
    data, outliers = with_noise(recorded(scene, seen, options, seed), scene.mechanism.motion,
                                options, seed)
    truth = tuple(Truth(c.kind, c.on, {n: v for n, v in c.parameters.items() if v},
                        *sizing.of(c)) for c in effects)
    return Hidden(scene.mechanism, data, truth, tuple(effects), outliers, scene)


def hide(machine: str, seed: int, kinds: Sequence[str], eta: float | Sequence[float],
         options: Options = USUAL,
         on: str | Sequence[str] | None = None) -> Hidden:
    """Return a campaign with one random cause of each kind, each of its size ``eta``.

    Without ``on``, a cause on actuators where the geometry swallows it is drawn anew.

    Raises:
        Impossible: a kind cannot have this size on this machine.
    """
    sizes = [eta] * len(kinds) if isinstance(eta, int | float) else list(eta)
    causes = [draw(machine, seed, kind, options, on) for kind in kinds]
    frozen = frozen_by(causes)
    out = []
    for cause, size in zip(causes, sizes, strict=True):
        if on is None and cause.on and _sizing(machine, seed, options, frozen).of(
                cause)[1] < ABSORBED:
            cause = draw(machine, seed, cause.kind, options, "one")
        out.append(scaled(machine, seed, cause, size, options, frozen))
    return campaign(machine, seed, out, options)


def imitation(machine: str, seed: int, cause: Cause, options: Options = USUAL
              ) -> tuple[str, float]:
    """Return which kind of the library imitates a cause best, and the eta that is then left.

    Every other kind that makes sense is given a column for each actuator and size parameter.
    """
    sizing = _sizing(machine, seed, options, frozen_by([cause]))
    scene, target = sizing.scene, sizing.left(sizing.white(cause))
    best = ("", float(np.linalg.norm(target)))
    for name in applicable(machine):
        if name not in LIBRARY or name == cause.kind:
            continue
        kind, start = LIBRARY[name], draw(machine, seed, name, options, "all")
        ons = [(a,) for a in scene.mechanism.actuators] if kind.joints else [()]
        columns = [sizing.left(sizing.white(replace(start, on=on, parameters={
            p: v if p == size or (kind.sizes and p not in kind.sizes) else 0.0
            for p, v in start.parameters.items()})))
            for on in ons for size in kind.sizes or start.parameters]
        matrix = np.stack(columns, axis=-1)
        u, s, _ = np.linalg.svd(matrix, full_matrices=False)
        u = u[:, s > 1e-3 * s[0]]
        rest = float(np.linalg.norm(target - u @ (u.T @ target)))
        best = min(best, (name, rest), key=lambda b: b[1])
    return best[0], best[1] / float(np.sqrt(target.size))
