import sys
import sys
import types
from enum import Enum

try:
    import hilbench.fieldbus.device  # noqa
except ImportError:
    module = types.ModuleType("hilbench.fieldbus.device")

    class NmtState(Enum):
        INITIALISING = 0
        STOPPED = 4
        OPERATIONAL = 5
        PRE_OPERATIONAL = 127

    class SdoAbort(Exception):
        def __init__(self, code):
            self.code = code

    module.NmtState = NmtState
    module.SdoAbort = SdoAbort
    sys.modules["hilbench.fieldbus.device"] = module
