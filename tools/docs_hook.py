"""What mkdocs does beyond its own (``mkdocs.yml``: hooks): the generated reference pages, equations as MathML, and a
search that needs no server.

Equations are written as GitHub reads them: a fenced block ``math``, or ``$`x`$`` in a line. A browser shows MathML by
itself, so that a page needs no script and no network.
"""

from __future__ import annotations

import re
import sys
from html import unescape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files

# mkdocs loads this file by its path, so the folder is not where Python looks.
sys.path.insert(0, str(Path(__file__).resolve().parent))
from reference import pages

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig

_BLOCK = re.compile(r'<pre><code class="language-math">(.*?)</code></pre>', re.DOTALL)
_INLINE = re.compile(r"\$<code>(.*?)</code>\$", re.DOTALL)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made from the code."""
    for path, text in pages().items():
        files.append(File.generated(config, path, content=text))
    return files


def on_config(config: MkDocsConfig) -> None:
    """Take the search plugin's own script out: it works with a server only. `docs/search.js` takes its place."""
    config.extra_javascript = [script for script in config.extra_javascript if script != "search/main.js"]


def on_post_build(config: MkDocsConfig) -> None:
    """Write the plugin's index as a script, which a page that was opened from a file may load."""
    folder = Path(config.site_dir) / "search"
    index = (folder / "search_index.json").read_text(encoding="utf-8")
    (folder / "search_index.js").write_text(f"const SEARCH_INDEX = {index};\n", encoding="utf-8")
    for unused in ("search_index.json", "main.js", "worker.js"):
        (folder / unused).unlink()


def on_page_content(html: str, **_: Any) -> str:
    """Turn what is marked as an equation into MathML."""
    html = _BLOCK.sub(lambda found: convert(unescape(found[1]).strip(), display="block"), html)
    return _INLINE.sub(lambda found: convert(unescape(found[1])), html)
