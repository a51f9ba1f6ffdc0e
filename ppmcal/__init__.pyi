"""What type checkers see of the Python face; names are loaded on first use."""

from collections.abc import Mapping, Sequence
from typing import Any

from ppmcal.commands.batch.run import BatchResult
from ppmcal.commands.certify.run import CertificateResult
from ppmcal.commands.check.run import CheckResult
from ppmcal.commands.compare.run import ComparisonResult
from ppmcal.commands.compensate.run import CompensationResult
from ppmcal.commands.diagnose.run import DiagnosisResult
from ppmcal.commands.export.run import ExportResult
from ppmcal.commands.figures.run import FiguresResult
from ppmcal.commands.identify.result import IdentificationResult
from ppmcal.commands.import_.run import ImportResult
from ppmcal.commands.inputs import Machine
from ppmcal.commands.inputs import load as load
from ppmcal.commands.inputs import read_data as read_data
from ppmcal.commands.inputs import shipped as shipped
from ppmcal.commands.kinematics.run import KinematicsResult
from ppmcal.commands.plan.run import PlanResult
from ppmcal.commands.read.run import ReadResult
from ppmcal.commands.report.run import ReportResult
from ppmcal.commands.result import CalibratedMachine, Progress
from ppmcal.commands.sensitivity.run import SensitivityResult
from ppmcal.commands.simulate.run import SimulationResult
from ppmcal.commands.spec import Measurements, Path_, Table
from ppmcal.commands.stiffness.run import StiffnessResult
from ppmcal.commands.tolerances.run import TolerancesResult
from ppmcal.commands.validate.run import ValidationResult
from ppmcal.commands.verify.run import VerificationResult
from ppmcal.commands.workspace.run import WorkspaceResult
from ppmcal.errors import BadInput as BadInput
from ppmcal.errors import NoResult as NoResult
from ppmcal.errors import PpmcalError as PpmcalError

__version__: str
__all__: list[str]
_HOME: dict[str, str]

def batch(
    manifest: Path_,
    out: Path_,
    *,
    cores: int | None = ...,
    scheduler: str | None = ...,
    force: bool = ...,
    progress: Progress = ...,
) -> BatchResult: ...
def certify(
    identified: Path_,
    about: Path_,
    validation: Sequence[Path_] | Path_ = ...,
    *,
    progress: Progress = ...,
) -> CertificateResult: ...
def check(
    mechanism: Machine,
    data: Measurements = ...,
    *,
    progress: Progress = ...,
) -> CheckResult: ...
def compare(old: Path_, new: Path_, *, progress: Progress = ...) -> ComparisonResult: ...
def compensate(
    model: Machine | CalibratedMachine,
    targets: Table,
    *,
    frame: str | None = ...,
    knowledge: Path_ | None = ...,
    approach: str = ...,
    path: bool = ...,
    assume: Mapping[str, float] | None = ...,
    like: Path_ | None = ...,
    regardless: bool = ...,
    progress: Progress = ...,
) -> CompensationResult: ...
def diagnose(
    mechanism: Machine,
    data: Measurements,
    *,
    free: Sequence[str] | str = ...,
    kinds: Sequence[str] = ...,
    holdout: float = ...,
    leave_out: str = ...,
    seed: int = ...,
    png: bool = ...,
    progress: Progress = ...,
) -> DiagnosisResult: ...
def export(
    form: str,
    model: Machine,
    *,
    old: Path_ | None = ...,
    poses: Path_ | None = ...,
    write: bool = ...,
    regardless: bool = ...,
    progress: Progress = ...,
) -> ExportResult: ...
def forward(
    mechanism: Machine,
    joints: Table,
    *,
    tool: str | Sequence[float] | None = ...,
    rotation: str = ...,
    method: str = ...,
    dataset: str | None = ...,
    all_modes: bool = ...,
    seed: int = ...,
    pictures: bool = ...,
    progress: Progress = ...,
) -> KinematicsResult: ...
def identify(
    mechanism: Machine,
    data: Measurements,
    *,
    method: str = ...,
    prior: str = ...,
    damping: float = ...,
    iterations: int | None = ...,
    free: Sequence[str] | str = ...,
    holdout: float | Measurements = ...,
    leave_out: str = ...,
    sigma: str = ...,
    start: Path_ | None = ...,
    keep: bool = ...,
    keep_outliers: bool = ...,
    seed: int = ...,
    progress: Progress = ...,
) -> IdentificationResult: ...
def import_config(
    form: str,
    file: Path_,
    *,
    rods: str | float | Sequence[str | float] = ...,
    mesh: Path_ | Sequence[Path_] = ...,
    scale: str = ...,
    effector: str | None = ...,
    radius: float | None = ...,
    width: float | None = ...,
    height: float | None = ...,
    anchors: Path_ | None = ...,
    progress: Progress = ...,
) -> ImportResult: ...
def inverse(
    mechanism: Machine,
    poses: Table,
    *,
    tool: str | Sequence[float] | None = ...,
    rotation: str = ...,
    pictures: bool = ...,
    progress: Progress = ...,
) -> KinematicsResult: ...
def make_figures(
    *folders: Path_,
    form: str = ...,
    width: str = ...,
    only: Sequence[str] = ...,
    progress: Progress = ...,
) -> FiguresResult: ...
def make_report(*folders: Path_, progress: Progress = ...) -> ReportResult: ...
def plan(
    mechanism: Machine,
    *,
    count: int | None = ...,
    instrument: Path_ | None = ...,
    tasks: Table | None = ...,
    candidates: Table | None = ...,
    effects: Sequence[str] = ...,
    payload: str | Sequence[float] | None = ...,
    temperature: str | Sequence[float] | None = ...,
    tension: str | Sequence[float] | None = ...,
    accuracy: float | None = ...,
    seed: int = ...,
    progress: Progress = ...,
) -> PlanResult: ...
def read(
    files: Path_ | Sequence[Path_],
    mechanism: Machine,
    *,
    sidecar: Path_ | None = ...,
    join: str | None = ...,
    tolerance: float = ...,
    partial: bool = ...,
    interpolate: bool = ...,
    clock_offset: float | str | None = ...,
    names: str | None = ...,
    combined: bool = ...,
    units: str | None = ...,
    name: str = ...,
    progress: Progress = ...,
) -> ReadResult: ...
def schema(name: str, *, progress: Progress = ...) -> dict[str, Any]: ...
def sensitivity(
    mechanism: Machine,
    *,
    poses: Table | None = ...,
    grid: str | None = ...,
    home_only: bool = ...,
    all_components: bool = ...,
    free: Sequence[str] = ...,
    tool: str | Sequence[float] | None = ...,
    metric: float | None = ...,
    sigmas: float = ...,
    together: Sequence[str] = ...,
    size: float | None = ...,
    progress: Progress = ...,
) -> SensitivityResult: ...
def simulate(
    mechanism: Machine,
    scenario: Path_ | Mapping[str, Any],
    *,
    seed: int | None = ...,
    progress: Progress = ...,
) -> SimulationResult: ...
def stiffness(
    mechanism: Machine,
    *,
    grid: str | None = ...,
    poses: Table | None = ...,
    load_at_tool: str | None = ...,
    payload: float | None = ...,
    tension: float | None = ...,
    tool: str | Sequence[float] | None = ...,
    progress: Progress = ...,
) -> StiffnessResult: ...
def tolerances(
    mechanism: Machine,
    *,
    accuracy: float | None = ...,
    rotation: float | None = ...,
    share: float = ...,
    method: str = ...,
    poses: Table | None = ...,
    instrument: Path_ | None = ...,
    measure: int = ...,
    machines: int = ...,
    metric: float | None = ...,
    tool: str | Sequence[float] | None = ...,
    cores: int | None = ...,
    scheduler: str | None = ...,
    seed: int = ...,
    progress: Progress = ...,
) -> TolerancesResult: ...
def validate(
    model: Machine | CalibratedMachine,
    data: Measurements,
    *,
    against: Sequence[Path_] = ...,
    register: Sequence[str] | str | None = ...,
    seed: int = ...,
    png: bool = ...,
    progress: Progress = ...,
) -> ValidationResult: ...
def velocity(
    mechanism: Machine,
    moves: Table,
    *,
    tool: str | Sequence[float] | None = ...,
    rotation: str = ...,
    pictures: bool = ...,
    progress: Progress = ...,
) -> KinematicsResult: ...
def verify(
    *folders: Path_,
    inputs: Path_ | None = ...,
    progress: Progress = ...,
) -> VerificationResult: ...
def workspace(
    mechanism: Machine,
    *,
    grid: str | None = ...,
    joints: Table | None = ...,
    seed: int = ...,
    progress: Progress = ...,
) -> WorkspaceResult: ...
