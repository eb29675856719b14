"""Write the pictures of a run's report as SVG files, for the README and the docs: report_pictures.py RUN FOLDER."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from hilbench.record.recording import read_recording
from hilbench.record.run_folder import RunFolder
from hilbench.report.plots import draw_pictures


def main() -> None:
    """One file a picture, named after it."""
    run, folder = RunFolder.open(Path(sys.argv[1])), Path(sys.argv[2])
    for picture in draw_pictures(read_recording(run.recording)):
        name = re.sub(r"[^a-z]+", "_", picture.title.lower()).strip("_")
        path = folder / f"{name}.svg"
        path.write_text(picture.svg, encoding="utf-8")
        print(path)


if __name__ == "__main__":
    main()
