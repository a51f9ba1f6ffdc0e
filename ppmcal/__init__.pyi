"""What type checkers see of the Python face; names are loaded on first use."""

from ppmcal.api.batch import batch as batch
from ppmcal.api.check import check as check
from ppmcal.api.compare import compare as compare
from ppmcal.api.compensate import compensate as compensate
from ppmcal.api.diagnose import diagnose as diagnose
from ppmcal.api.export import export as export
from ppmcal.api.identify import identify as identify
from ppmcal.api.import_ import import_config as import_config
from ppmcal.api.inputs import load as load
from ppmcal.api.inputs import read_data as read_data
from ppmcal.api.inputs import shipped as shipped
from ppmcal.api.kinematics import forward as forward
from ppmcal.api.kinematics import inverse as inverse
from ppmcal.api.kinematics import velocity as velocity
from ppmcal.api.plan import plan as plan
from ppmcal.api.read import read as read
from ppmcal.api.report import make_report as make_report
from ppmcal.api.schema import schema as schema
from ppmcal.api.sensitivity import sensitivity as sensitivity
from ppmcal.api.simulate import simulate as simulate
from ppmcal.api.stiffness import stiffness as stiffness
from ppmcal.api.tolerances import tolerances as tolerances
from ppmcal.api.validate import validate as validate
from ppmcal.api.verify import verify as verify
from ppmcal.api.workspace import workspace as workspace
from ppmcal.errors import BadInput as BadInput
from ppmcal.errors import NoResult as NoResult
from ppmcal.errors import PpmcalError as PpmcalError

__version__: str
__all__: list[str]
