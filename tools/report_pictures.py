"""Write the pictures of a run's report as SVG files, for the README and the docs: report_pictures.py RUN FOLDER.

On its own a picture has no page around it: its colours are those of the page's light scheme, on white.
"""

from __future__ import annotations

import re
import sys
from importlib import resources
from pathlib import Path

from hilbench.diagnosis.synchronization import reference_estimate
from hilbench.report.found import found_pictures
from hilbench.report.html import marks_of
from hilbench.report.plots import run_pictures, zooms
from hilbench.report.web_line_drawing import line_picture
from hilbench.results.recording import read_recording
from hilbench.results.result import Result
from hilbench.results.run_folder import RunFolder
from hilbench.runs.config import load_with_overrides


def standalone(svg: str, page_css: str) -> str:
    """The SVG with the page's colours put in place of the variables, on a white ground."""
    colours = dict(reversed(re.findall(r"--(\w+): (#\w+)", page_css)))
    coloured = re.sub(r"var\(--(\w+)\)", lambda match: colours[match[1]], svg)
    style = "<style>text { font-family: sans-serif; fill: #1b1f24 }</style>"
    return re.sub(r"(<svg[^>]*>)", rf'\1{style}<rect width="100%" height="100%" fill="white"/>', coloured, count=1)


def main() -> None:
    """One file a picture, named after its title."""
    run, folder = RunFolder.open(Path(sys.argv[1])), Path(sys.argv[2])
    page_css = resources.files("hilbench.report").joinpath("page.css").read_text(encoding="utf-8")
    recording = read_recording(run.recording)
    reference_Pa = reference_estimate(load_with_overrides(run.config).config, recording)
    result = Result.read(run.result)
    marks = marks_of(result, recording)
    pictures = run_pictures(recording, marks, reference_Pa)
    line = line_picture(run.config, recording)
    for picture in [*line, *found_pictures(result), *pictures, *zooms(pictures, marks)]:
        name = re.sub(r"[^a-z0-9]+", "_", picture.title.lower()).strip("_")
        path = folder / f"{name}.svg"
        path.write_text(standalone(picture.svg, page_css), encoding="utf-8")
        print(path)


if __name__ == "__main__":
    main()
