"""Which poses to measure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from ppmcal.commands.inputs import files_of, load, place_of
from ppmcal.commands.plan.options import PlanArguments
from ppmcal.commands.result import Result
from ppmcal.design.plan.plan import PlanOptions
from ppmcal.design.plan.plan import plan as planned
from ppmcal.design.plan.result import Plan
from ppmcal.design.plan.settings import PlanSettings
from ppmcal.design.virtual_instrument import default_instrument
from ppmcal.errors import BadInput
from ppmcal.io import read_poses
from ppmcal.io.results.plan import PlanRecord
from ppmcal.io.sidecar import read_instrument
from ppmcal.model.mechanism import Effect, Mechanism
from ppmcal.notes import NOTE, Note
from ppmcal.store.provenance import source_of

ABSOLUTE_ZERO = -273.15


@dataclass(frozen=True, eq=False, repr=False)
class PlanResult(Result):
    """The poses that are worth measuring.

    Attributes:
        mechanism: the machine.
        plan: poses with their settings in the order of the path, and what they tell, SI.
        record: the content of plan.json.
        accuracy: wanted standard deviation of position at the tasks, m.
    """

    COMMAND: ClassVar[str] = "plan"
    UNTOLD: ClassVar[tuple[str, ...]] = ("tables", "pictures")
    TABLE: ClassVar[str] = "poses.csv"

    mechanism: Mechanism
    plan: Plan
    record: PlanRecord
    accuracy: float | None

    def files(self) -> Mapping[str, str | bytes]:
        """Return poses.csv, accuracy.csv, plan.json and accuracy.png."""
        return dict(self.record.files(self.plan, self.accuracy))

    def told(self) -> Iterator[str]:
        """Yield what was found in sentences."""
        yield f"{self.mechanism.name}:"
        yield from self.record.summary


def run(asked: PlanArguments) -> PlanResult:
    """Choose the poses of a machine that are worth measuring."""
    machine = load(asked.mechanism)
    if asked.count is not None and asked.count < 1:
        raise BadInput(f"{asked.count} is not a number of measurements", "--count",
                       "Write at least 2, or leave it out")
    names = tuple(dict.fromkeys(k.strip() for text in asked.effects for k in text.split(",")
                                if k.strip()))
    settings = PlanSettings(names, _ends(asked.payload, "--payload", "0,20", 0.0),
                            _ends(asked.temperature, "--temperature", "18,26", ABSOLUTE_ZERO,
                                  -ABSOLUTE_ZERO),
                            _ends(asked.tension, "--tension", "20,80", 0.0))
    chosen = (read_instrument(asked.instrument, machine) if asked.instrument
              else default_instrument(machine))
    given, aims = (None if t is None else (read_poses(t, machine).poses, place_of(t, what))
                   for t, what in ((asked.candidates, "candidates"), (asked.tasks, "tasks")))
    if asked.accuracy is not None and not 0.0 < asked.accuracy < 1e12:
        raise BadInput(f"{asked.accuracy:g} is not the size of an error", "--accuracy",
                       "Write one above 0")
    wanted = None if asked.accuracy is None else asked.accuracy * machine.units.factor("length")
    found = planned(machine, chosen, PlanOptions(asked.count, asked.seed, settings), given,
                    aims, wanted)
    source = source_of("plan", [*machine.inputs, *files_of(asked.instrument, asked.tasks,
                                                           asked.candidates)], asked.seed)
    record = PlanRecord.of(found, wanted, _notes(machine.effects, names, found.unused), source)
    return PlanResult(source, tuple(record.findings), machine, found, record, wanted)


def _notes(effects: tuple[Effect, ...], names: tuple[str, ...], unused: tuple[str, ...]
           ) -> list[Note]:
    out = [Note(f"--{name} is not used: nothing that is asked for depends on it.", NOTE)
           for name in unused]
    others = sorted({e.kind.name for e in effects} - set(names))
    if others:
        out.append(Note(f"The file's effects {', '.join(others)} are left out; name them with "
                        "--for to plan for them.", NOTE))
    return out


def _ends(
    asked: str | Sequence[float] | None, option: str, example: str, least: float, shift: float = 0.0
) -> tuple[float, float] | None:
    """Return both ends of ``LOW,HIGH``, shifted to SI."""
    if asked is None:
        return None
    text = asked if isinstance(asked, str) else ",".join(str(v) for v in asked)
    hint = f'Write two numbers, the lower one first, for example {option} "{example}"'
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        raise BadInput(f"'{text}' holds what is not a number", option, hint) from None
    for value in values:
        if not least <= value < 1e6:
            raise BadInput(f"{value:g} in '{text}' is not between {least:g} and 1e6", option, hint)
    if len(values) != 2 or values[0] >= values[1]:
        raise BadInput(f"'{text}' does not go from a lower to a higher value", option, hint)
    return values[0] + shift, values[1] + shift
