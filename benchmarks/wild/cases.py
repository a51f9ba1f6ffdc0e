"""Every case by name: its group, the machines it fits, its causes and its mistakes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from . import bodies as bo
from . import events as ev
from . import memory as me
from . import mistakes as mi
from . import physics as ph
from . import rows as ro
from .campaign import Plan
from .machines import MACHINES

PLAIN = Plan()
PLANAR, SPATIAL = ("3-RRR", "3-RPR"), ("hexapod", "crank-hexapod")
ROTARY = ("3-RRR", "delta-rotary", "crank-hexapod")
LINEAR = ("3-RPR", "delta-linear", "hexapod")
POSED = PLANAR + SPATIAL
WRENCH, FINE = Plan(loads="wrench"), Plan(approach="sequence", fine=0.6)
SEQUENCE, BLOCKS = Plan(approach="sequence"), Plan(load_blocks=True)
POSE = Plan(instrument="pose")
WARM, MOVING = Plan(warm=True), Plan(warm=True, pauses=0.15)


@dataclass(frozen=True)
class Case:
    """One thing that goes wrong (or nothing).

    ``causes`` make effects, each sized to eta unless it has no size; ``errors`` are mistakes
    in the files; ``accept`` are kinds that are as right as the true ones (learned: no kind of
    the tool's list is right, "unnamed" or a learned term is).
    """

    group: str
    machines: tuple[str, ...] = MACHINES
    causes: tuple[Callable, ...] = ()
    errors: tuple[Callable, ...] = ()
    plan: Plan = PLAIN
    accept: tuple[str, ...] = ()
    other: bool = False
    note: str = ""


def mistake(*errors, machines=MACHINES, plan=PLAIN, **more) -> Case:
    """A case of mistakes in the files."""
    return Case("mistake", machines, (), errors, plan, **more)


def _mistakes() -> dict[str, Case]:
    out = {
        "legs-swapped": mistake(mi.legs_swapped), "legs-cyclic": mistake(mi.legs_cyclic),
        "sign-one": mistake(mi.sign("one")), "sign-all": mistake(mi.sign("all")),
        "joint-unit-one": mistake(mi.joint_unit("one")),
        "joint-unit-all": mistake(mi.joint_unit("all")),
        "position-unit": mistake(mi.position_unit),
        "position-unit-one": mistake(mi.one_position_unit),
        "angle-unit": mistake(mi.angle_unit, machines=POSED, plan=POSE),
        "quaternion-w-first": mistake(mi.quaternion_first, machines=SPATIAL, plan=POSE),
        "rotation-transposed": mistake(mi.transposed, machines=SPATIAL, plan=POSE),
        "pose-inverse": mistake(mi.inverted, machines=POSED, plan=POSE),
        "mirrored": mistake(mi.mirrored), "exchanged": mistake(mi.exchanged),
        "shifted": mistake(ro.shifted), "stale-joints": mistake(ro.stale("joints")),
        "stale-pose": mistake(ro.stale("pose")), "outside-limits": mistake(ro.outside_limits),
        "radius-base": mistake(ro.doubled("base")),
        "radius-platform": mistake(ro.doubled("platform")),
        "shuffled": mistake(ro.shuffled), "reordered": mistake(ro.reversed_order, plan=SEQUENCE),
        "approach-half-inverted": Case("mistake", causes=(ph.backlash("all"),),
                                       errors=(ro.approach_inverted(0.4),)),
        "other-machine": Case("mistake", other=True, note="mechanism of another seed"),
    }  # fmt: skip
    for name, error in (("swapped", mi.legs_swapped), ("sign", mi.sign("one")),
                        ("unit", mi.joint_unit("one")), ("mirrored", mi.mirrored)):
        out[f"stretch-{name}"] = mistake(ro.in_stretch(error, 0.12, 0.3))
    out["swapped-at-end"] = mistake(ro.in_stretch(mi.legs_swapped, 0.4, 0.6, to_end=True))
    for order in ("xyz", "XYZ", "zyx", "ZYX", "zyz"):
        name = "euler-" + ("fixed-" if order.islower() else "moving-") + order.lower()
        out[name] = mistake(mi.euler(order), machines=SPATIAL, plan=POSE)
    turned = mi.euler("ZYX", in_order=True)
    out["euler-moving-zyx-in-order"] = mistake(turned, machines=SPATIAL, plan=POSE)
    for unit in ("F", "K"):
        error = mi.condition_unit("temperature", unit)
        out[f"temperature-{unit}"] = Case(
            "mistake", causes=(bo.thermal("leg"),), plan=WARM, errors=(error,)
        )
    for unit in ("g", "lb", "N"):
        error = mi.condition_unit("payload", unit)
        out[f"payload-{unit}"] = Case("mistake", causes=(ph.compliance("all"),), errors=(error,))
    return out | _pairs_of_mistakes()


def _pairs_of_mistakes() -> dict[str, Case]:
    return {
        "swapped-and-sign": mistake(mi.sign("one"), mi.legs_swapped),
        "swapped-and-unit": mistake(mi.legs_swapped, mi.position_unit),
        "unit-and-mirrored": mistake(mi.joint_unit("all"), mi.mirrored),
        "sign-and-shifted": mistake(mi.sign("all"), ro.shifted),
        "inverse-and-euler": mistake(mi.inverted, mi.euler("xyz"), machines=SPATIAL, plan=POSE),
        "swapped-and-typos": mistake(mi.legs_swapped, ro.typos(0.05)),
        "swapped-with-backlash": Case("mistake", causes=(ph.backlash("all"),),
                                      errors=(mi.legs_swapped,)),
        "sign-with-heat": Case("mistake", causes=(bo.thermal("leg"),),
                               plan=WARM, errors=(mi.sign("one"),)),
    }  # fmt: skip


def _quiet() -> dict[str, Case]:
    none = lambda plan=PLAIN, **more: Case("none", plan=plan, **more)  # noqa: E731
    return {
        "none": none(), "none-sequence": none(SEQUENCE), "none-wrench": none(WRENCH),
        "none-known-frame": none(Plan(known=True)), "none-ar": none(Plan(noise="ar")),
        "none-tails": none(Plan(noise="tails")), "none-actuator": none(Plan(noise="actuator")),
        "none-position": none(Plan(instrument="position"), machines=SPATIAL),
        "gross-2": Case("gross", errors=(ro.typos(0.02),)),
        "gross-5": Case("gross", errors=(ro.typos(0.05),)),
        "gross-10": Case("gross", errors=(ro.typos(0.10),)),
        "gross-5-backlash": Case("gross", causes=(ph.backlash("all"),), errors=(ro.typos(0.05),)),
    }  # fmt: skip


def _events() -> dict[str, Case]:
    late, early = (0.6, 0.8), (0.2, 0.4)
    event = lambda *causes, machines=MACHINES, plan=PLAIN: Case(  # noqa: E731
        "event", machines, causes, (), plan
    )
    return {
        "homed-one": event(ev.homed_again("one")),
        "homed-all": event(ev.homed_again("all")),
        "homed-rising": event(ev.homed_again("one"), plan=Plan(temperature="rise")),
        "homed-twice": event(ev.homed_again("one", *early), ev.homed_again("one", *late)),
        "homed-there-and-back": event(ev.there_and_back),
        "slip-counts": event(ev.slipped_counts),
        "slip-turn": event(ev.slipped_turn),
        "target-bumped": event(ev.bumped("target"), machines=POSED),
        "base-moved": event(ev.bumped("base")),
        "base-moved-twice": event(ev.bumped("base", *early), ev.bumped("base", *late)),
        "homed-and-bumped": event(ev.homed_again("one", *early), ev.bumped("base", *late)),
        "base-sways": event(ev.base_wanders("sways")),
        "base-walks": event(ev.base_wanders("walks")),
        "leg-settles": event(ev.leg_settles),
        "homed-with-heat": event(ev.homed_again("one"), bo.thermal("leg"), plan=WARM),
    }


def _memory() -> dict[str, Case]:
    def remember(cause, plan=PLAIN, **more) -> Case:
        return Case("memory", MACHINES, (cause,), (), plan, **more)

    return {
        "play-one": remember(me.play("one"), FINE),
        "play-all": remember(me.play("all"), FINE),
        "play-coarse": remember(me.play("all"), SEQUENCE, accept=("backlash",)),
        "play-ahead-one": remember(me.play("one", ahead=True), FINE),
        "play-ahead-all": remember(me.play("all", ahead=True), FINE),
        "play-ahead-coarse": remember(me.play("all", ahead=True), SEQUENCE, accept=("backlash",)),
        "hysteresis-ahead-all": remember(me.hysteresis("all", ahead=True), FINE),
        "hysteresis-one": remember(me.hysteresis("one"), FINE),
        "hysteresis-all": remember(me.hysteresis("all"), FINE),
        "friction-all": remember(me.friction("all")),
        "friction-one": remember(me.friction("one")),
        "leg-heat-late": remember(me.thermal_lag("leg"), WARM),
        "base-heat-late": remember(me.thermal_lag("base"), WARM),
        "platform-heat-late": Case("memory", POSED, (me.thermal_lag("platform"),), plan=WARM),
        "motion-heat-all": remember(me.motion_heat("all"), MOVING),
        "motion-heat-one": remember(me.motion_heat("one"), MOVING),
        "motion-heat-base": remember(me.motion_heat("all", "base"), MOVING),
        "motion-heat-platform": Case("memory", POSED, (me.motion_heat("all", "platform"),),
                                     plan=MOVING),
        "creep-all": remember(me.creep("all"), BLOCKS),
        "backlash-by-temperature": remember(me.backlash_by_temperature("all")),
        "lag-all": remember(ph.lag("all")),
        "lag-one": remember(ph.lag("one")),
        "shortfall": remember(me.shortfall("all"), SEQUENCE),
    }


def cause(make, machines=MACHINES, plan=PLAIN, **more) -> Case:
    """A case of one effect without memory, or of several at once."""
    makers = make if isinstance(make, tuple) else (make,)
    return Case("physics", machines, makers, (), plan, **more)


def _loads() -> dict[str, Case]:
    heat = bo.thermal("leg")
    return {
        "windup": cause(ph.windup("all"), plan=WRENCH),
        "compliance-one": cause(ph.compliance("one"), plan=WRENCH),
        "compliance-all": cause(ph.compliance("all")),
        "compliance-wrench": cause(ph.compliance("all"), plan=WRENCH),
        "hardening": cause(ph.compliance("all", hardening=True), plan=WRENCH),
        "compliance-by-stroke": cause(ph.compliance("all", by_stroke=True), plan=WRENCH),
        "base-compliance": cause(bo.base_compliance, plan=WRENCH),
        "stand": cause(bo.stand, POSED, WRENCH),
        "stand-weight": cause(bo.stand, SPATIAL),
        "base-plate": cause(bo.plate("base"), plan=WRENCH),
        "platform-plate": cause(bo.plate("platform"), plan=WRENCH),
        "clearance-one": cause(ph.clearance("one"), plan=WRENCH),
        "clearance-all": cause(ph.clearance("all"), plan=WRENCH),
        "payload-off-centre": cause(ph.off_centre, POSED, accept=("payload_offset", "learned")),
        "gravity-wrong": cause(ph.gravity_wrong, accept=("gravity_tilt", "learned")),
        "compliance-and-periodic": cause((ph.compliance("all"), ph.periodic("one"))),
        "three": cause((ph.backlash("all"), heat, ph.compliance("all")), plan=WARM),
    }


def _physics() -> dict[str, Case]:
    gaps, heat = ("hexapod", "delta-linear"), bo.thermal("leg")
    return {
        "backlash-one": cause(ph.backlash("one")),
        "backlash-all": cause(ph.backlash("all")),
        "backlash-behind-all": cause(ph.backlash("all", behind=True)),
        "gain-one": cause(ph.gain("one"), LINEAR),
        "gain-all": cause(ph.gain("all"), LINEAR, accept=("sensor_scale",)),
        "periodic-one": cause(ph.periodic("one")),
        "periodic-all": cause(ph.periodic("all")),
        "eccentricity": cause(ph.eccentricity("one"), ROTARY),
        "curvature-one": cause(ph.curvature("one")),
        "curvature-all": cause(ph.curvature("all")),
        "leg-heat": cause(heat, plan=WARM),
        "leg-heat-one": cause(bo.thermal("leg", "one"), plan=WARM),
        "leg-heat-by-leg": cause(bo.thermal_by_leg, plan=WARM),
        "base-heat": cause(bo.thermal("base"), plan=WARM),
        "platform-heat": cause(bo.thermal("platform"), POSED, WARM),
        "drift": cause(bo.drift),
        "sensor-scale": cause(bo.sensor_scale, LINEAR, accept=("gain",)),
        "tilt": cause(bo.tilt, PLANAR),
        "joint-gap-one": cause(ph.joint_gap("one"), gaps),
        "joint-gap-all": cause(ph.joint_gap("all"), gaps),
        "wear": cause(ph.wear("one"), accept=("curvature",)),
        "speed-squared": cause(ph.speed_squared("all")),
        "backlash-and-heat": cause((ph.backlash("all"), heat), plan=WARM),
        "lag-and-backlash": cause((ph.lag("all"), ph.backlash("one"))),
    }


CASES: dict[str, Case] = _quiet() | _mistakes() | _events() | _memory() | _loads() | _physics()


def fits(case: str, machine: str) -> bool:
    """Whether a case can happen to a machine."""
    return machine in CASES[case].machines


__all__ = ["CASES", "Case", "fits"]
