"""What mkdocs does beyond its own: the generated reference pages, and equations as MathML (``mkdocs.yml``: hooks).

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


def on_page_content(html: str, **_: Any) -> str:
    """Turn what is marked as an equation into MathML."""
    html = _BLOCK.sub(lambda found: convert(unescape(found[1]).strip(), display="block"), html)
    return _INLINE.sub(lambda found: convert(unescape(found[1])), html)
