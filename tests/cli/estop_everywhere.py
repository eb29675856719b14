"""Run in a network namespace of its own (no bench of anybody else is there): two benches, then `hilbench estop`.

Arguments: the configs of the benches. Each has a runtime directory and a session of its own, the second is stopped by
SIGSTOP; the emergency stop comes from an environment with a third one, that knows of neither. Prints what came of it as
JSON. (The sockets of embedded buses are files, which no namespace hides: without a runtime directory the stop would
reach the user's other buses.)
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.bench.whole_runs import start, wait_for_frames


def main(paths: list[Path]) -> None:
    benches, directories = [], [tempfile.mkdtemp(prefix="hb", dir="/tmp") for _ in range(len(paths) + 1)]
    for path, directory in zip(paths, directories, strict=False):
        os.environ["XDG_RUNTIME_DIR"] = directory
        benches.append(start(path))
        wait_for_frames(path, 200)
    benches[-1].send_signal(signal.SIGSTOP)
    command = [sys.executable, "-m", "hilbench", "estop"]
    bare = {"PATH": os.environ["PATH"], "XDG_RUNTIME_DIR": directories[-1]}
    stop = subprocess.run(command, capture_output=True, text=True, check=False, cwd="/", env=bare, timeout=60)
    benches[-1].send_signal(signal.SIGCONT)
    said = [bench.communicate(timeout=60)[0] for bench in benches]
    found = {
        "exit_code": stop.returncode,
        "out": stop.stdout,
        "err": stop.stderr,
        "benches": [[bench.pid, bench.returncode, words] for bench, words in zip(benches, said, strict=True)],
    }
    print(json.dumps(found))
    for directory in directories:
        shutil.rmtree(directory)


if __name__ == "__main__":
    main([Path(argument) for argument in sys.argv[1:]])
