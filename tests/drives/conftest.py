import sys
import types
from enum import Enum

try:
    import hilbench.fieldbus.device
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

try:
    import hilbench.fieldbus.pdo  # noqa
except ImportError:
    import struct

    pdo_module = types.ModuleType("hilbench.fieldbus.pdo")

    class PdoMap:
        def __init__(self, cob_id, transmission_type, entries):
            self.cob_id, self.transmission_type, self.entries = cob_id, transmission_type, entries
            codes = {2: "b", 3: "h", 4: "i", 5: "B", 6: "H", 7: "I"}
            self.fmt = struct.Struct("<" + "".join(codes[e.data_type] for e in entries))
            self.unpack = self.fmt.unpack

        def pack(self, values):
            return self.fmt.pack(*values)

    pdo_module.PdoMap = PdoMap
    sys.modules["hilbench.fieldbus.pdo"] = pdo_module
