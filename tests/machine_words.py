"""Words of one machine in the code: where the web line is named outside the modules that are its own.

    python -m tests.machine_words

prints them by file. Counted are the words of identifiers and of strings; comments and docstrings are not code.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

SOURCES = Path(__file__).resolve().parents[1] / "src" / "hilbench"
WORDS = re.compile(r"tensions?|spans?|youngs|webs?|axis[12]")
_PARTS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+[0-9]*")


def is_its_own(path: Path) -> bool:
    """Whether a module belongs to the web line, which it says in its path below the sources by one of the words."""
    return any(map(is_word, words_in("/".join(path.with_suffix("").parts))))


def is_word(word: str) -> bool:
    """Whether it is one of the web line's."""
    return WORDS.fullmatch(word) is not None


def words_in(text: str) -> list[str]:
    """``F_simTension_N`` → f, sim, tension, n."""
    return [part.lower() for part in _PARTS.findall(text.replace("WebSocket", "Socket"))]  # a protocol's name


def found_in(source: str) -> Counter[str]:
    """How often each of the words is in the code of a module."""
    told = _docstrings(ast.parse(source))
    texts = (
        token.string
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.NAME
        or (token.type != tokenize.COMMENT and token.string[-1:] in "'\"" and token.start not in told)
        or tokenize.tok_name[token.type] == "FSTRING_MIDDLE"
    )
    return Counter(word for text in texts for word in words_in(text) if is_word(word))


def _docstrings(tree: ast.AST) -> set[tuple[int, int]]:
    """Where a string stands that is a statement by itself."""
    return {
        (node.value.lineno, node.value.col_offset)
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
    }


def by_module() -> Iterator[tuple[Path, Counter[str]]]:
    """Each module that has such words, by its path below the sources."""
    for path in sorted(SOURCES.rglob("*.py")):
        if found := found_in(path.read_text(encoding="utf-8")):
            yield path.relative_to(SOURCES), found


def elsewhere() -> dict[Path, Counter[str]]:
    """The modules that are not the web line's own."""
    return {path: found for path, found in by_module() if not is_its_own(path)}


if __name__ == "__main__":
    found = sorted(elsewhere().items(), key=lambda row: -row[1].total())
    for module, words in found:
        print(f"{words.total():5}  {module}  ({', '.join(f'{word} {count}' for word, count in words.most_common())})")
    print(f"{sum(words.total() for _, words in found):5}  in {len(found)} modules that are not the web line's own")
