"""Which poses to measure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from ppmcal.api.inputs import Machine, Path_, files_of, load, place_of, recorded, source_of
from ppmcal.api.result import Progress, Result
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
from ppmcal.wording.progress import heard, silent

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
    TABLE: ClassVar[str] = "poses.csv"

    mechanism: Mechanism
    plan: Plan
    record: PlanRecord
    accuracy: float | None

    def files(self) -> Mapping[str, str | bytes]:
        """Return poses.csv, accuracy.csv, plan.json and accuracy.png."""
        return dict(self.record.files(self.plan, self.accuracy))

    def headline(self) -> str:
        """Return the first sentence of what was found."""
        return f"{self.mechanism.name}: {self.record.said[0]}"


@recorded
@heard
def plan(mechanism: Machine, *, count: int | None = None, instrument: Path_ | None = None,
         tasks: Any = None, candidates: Any = None, effects: Sequence[str] = (),
         payload: str | Sequence[float] | None = None,
         temperature: str | Sequence[float] | None = None, accuracy: float | None = None,
         seed: int = 0, progress: Progress = silent) -> PlanResult:
    """Choose the poses of a machine that are worth measuring.

    D-optimal for the parameters that the machine leaves free, with its tolerances as prior;
    ordered into a short path.

    Args:
        mechanism: the machine, or its file.
        count: measurements to take  [default: until one more hardly helps].
        instrument: sidecar of what measures  [default: the full pose, a tenth of the tolerances].
        tasks: poses at which the machine has to be exact, as a file or a table in memory
            [default: the whole region].
        candidates: poses to choose from  [default: drawn in the machine's region].
        effects: kinds of effect to be shown too.
        payload: lowest and highest payload that can be put on, kg.
        temperature: lowest and highest temperature that can be set, deg C.
        accuracy: wanted standard deviation of position at the tasks, the file's unit of length.
        seed: of everything drawn at random.
        progress: called with a line of text now and then.

    Raises:
        BadInput: anything wrong in the files or options. NoResult: no pose can be reached.
    """
    machine = load(mechanism)
    if count is not None and count < 1:
        raise BadInput(f"{count} is not a number of measurements", "--count",
                       "Write at least 2, or leave it out")
    names = tuple(dict.fromkeys(k.strip() for text in effects for k in text.split(",")
                                if k.strip()))
    asked = PlanSettings(names, _ends(payload, "--payload", "0,20", 0.0),
                         _ends(temperature, "--temperature", "18,26", ABSOLUTE_ZERO,
                               -ABSOLUTE_ZERO))
    chosen = read_instrument(instrument, machine) if instrument else default_instrument(machine)
    given, aims = (None if t is None else (read_poses(t, machine).poses, place_of(t, what))
                   for t, what in ((candidates, "candidates"), (tasks, "tasks")))
    if accuracy is not None and not 0.0 < accuracy < 1e12:
        raise BadInput(f"{accuracy:g} is not the size of an error", "--accuracy",
                       "Write one above 0")
    wanted = None if accuracy is None else accuracy * machine.units.factor("length")
    found = planned(machine, chosen, PlanOptions(count, seed, asked), given, aims, wanted)
    source = source_of("plan", [*machine.inputs, *files_of(instrument, tasks, candidates)], seed)
    record = PlanRecord.of(found, wanted, _notes(machine.effects, names, found.unused), source)
    return PlanResult(source, tuple(record.findings), machine, found, record, wanted)


def _notes(effects: tuple[Effect, ...], names: tuple[str, ...], unused: tuple[str, ...]
           ) -> list[str]:
    out = [f"--{name} is not used: nothing that is asked for depends on it." for name in unused]
    others = sorted({e.kind.name for e in effects} - set(names))
    if others:
        out.append(f"The file's effects {', '.join(others)} are left out; name them with --for to "
                   "plan for them.")
    return out


def _ends(
    asked: str | Sequence[float] | None, option: str, example: str, least: float, shift: float = 0.0
) -> tuple[float, float] | None:
    """Return both ends of ``LOW,HIGH``, shifted to SI."""
    if asked is None:
        return None
    text = asked if isinstance(asked, str) else ",".join(str(v) for v in asked)
    mend = f'Write two numbers, the lower one first, for example {option} "{example}"'
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        raise BadInput(f"'{text}' holds what is not a number", option, mend) from None
    for value in values:
        if not least <= value < 1e6:
            raise BadInput(f"{value:g} in '{text}' is not between {least:g} and 1e6", option, mend)
    if len(values) != 2 or values[0] >= values[1]:
        raise BadInput(f"'{text}' does not go from a lower to a higher value", option, mend)
    return values[0] + shift, values[1] + shift
