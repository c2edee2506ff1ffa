from .analysis.prediction.boundary import predict as predict
from .fmi.component import Port as Port
from .fmi.component import PythonComponent as PythonComponent
from .fmi.component import memory as memory
from .fmi.fmu_description import describe_fmu as describe_fmu
from .scenario.scenario import load as load
