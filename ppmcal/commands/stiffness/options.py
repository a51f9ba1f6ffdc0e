"""What ``ppmcal stiffness`` takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ppmcal.commands.spec import Arguments, Command, Machine, Table, grid, mechanism, option, tool


@dataclass(frozen=True)
class StiffnessArguments(Arguments):
    """Which load, and at which poses."""

    mechanism: Machine = mechanism()
    grid: str | None = grid()
    poses: Table | None = option(None, "Poses instead of a grid.")
    load_at_tool: str | None = option(
        None, "Load at the tool point, base axes, N and N m: fx=0,fy=0,fz=-100.", "--load",
        metavar="TEXT")
    payload: float | None = option(None, "Mass at the tool point, kg.")
    tension: float | None = option(
        None, "Mean tension of surplus ropes without the load, N  [default: none].")
    tool: str | Sequence[float] | None = tool()


COMMAND = Command(
    "stiffness", StiffnessArguments,
    about=("How far the tool of {mechanism} gives way under load, at home and over a map.",
           "{mechanism} says how stiff bars, drives and joints are under `stiffness`. Of surplus "
           "limbs it tells the forces too; ropes only pull. Writes map.csv, stiffness.json and "
           "pictures of the map."),
    examples=("ppmcal stiffness mine.yaml --load fz=-100",), out="stiffness",
    result="StiffnessResult",
    record=("stiffness", "ppmcal.io.results.stiffness:StiffnessRecord"),
    raises="BadInput: anything wrong in the files or options; a machine without springs.",
    shares={"mapping the stiffness": 0.1, "writing the results": 1.5})
