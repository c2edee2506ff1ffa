from .component import Port as Port
from .component import PythonComponent as PythonComponent
from .fmu_description import describe_fmu as describe_fmu
from .prediction.boundary import predict as predict
from .scenario import load as load
