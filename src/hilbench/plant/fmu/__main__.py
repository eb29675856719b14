"""``python -m hilbench.plant.fmu CONNECTION FOLDER VERSION IDENTIFIER TOKEN``: process of an FMU."""

import signal
import sys
from multiprocessing.connection import Connection

from hilbench.plant.fmu.instance import serve

signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the bench; this process ends with it
_number, _folder, _version, _identifier, _token = sys.argv[1:]
serve(Connection(int(_number)), _folder, {"version": int(_version), "identifier": _identifier, "token": _token})
