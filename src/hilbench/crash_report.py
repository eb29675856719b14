"""Report of an unexpected exception: one line for a person, and its traceback in a file."""

from __future__ import annotations

import os
import tempfile
import traceback
from pathlib import Path
from typing import Final

from hilbench.errors import printable

_SOURCES: Final = Path(__file__).parent
#: In the environment of a process: the folder that its tracebacks are kept in; without it the system's temporary one.
TRACEBACK_FOLDER: Final = "HILBENCH_TRACEBACKS"
#: Its name in the folder of a run.
TRACEBACK_FILE: Final = "traceback.txt"


def crash_report(error: BaseException, file: Path | None = None) -> str:
    """Describe the error in one line; the traceback is added to `file`, or put into a file of its own.

    Where that can't be written the line states it, with the place in the code only. Never raises.
    """
    message = printable(str(error)) or "without words"
    text = f"unexpected {type(error).__name__} in {_place(error)}: {message}"
    try:
        kept = _keep("".join(traceback.format_exception(error)), file)
    except OSError as refusal:
        return f"{text}; its traceback can't be kept ({refusal.strerror})"
    return f"{text}; traceback in {printable(str(kept))}"


def _place(error: BaseException) -> str:
    """The last line of hilbench's own that the error passed."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if Path(frame.filename).is_relative_to(_SOURCES)]
    for frame in reversed(own or frames):
        path = Path(frame.filename)
        return f"{path.relative_to(_SOURCES) if own else path.name}:{frame.lineno}"
    return "no known place"


def _keep(text: str, file: Path | None) -> Path:
    if file is not None:
        with open(file, "a", encoding="utf-8", errors="backslashreplace") as stream:
            stream.write(text)
        return file
    folder = os.environ.get(TRACEBACK_FOLDER)
    descriptor, name = tempfile.mkstemp(".txt", "hilbench-traceback-", folder, text=True)
    with open(descriptor, "w", encoding="utf-8", errors="backslashreplace") as stream:
        stream.write(text)
    return Path(name)
