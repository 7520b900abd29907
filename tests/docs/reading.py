"""Pages, as tests read them."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
SNIPPET = re.compile(r'^--8<-- "(.+)"\n', re.MULTILINE)  # a file that a block shows
# Blocks that show a file have their language in braces, since Ruff would format the line.
BLOCK = re.compile(r"^```(?:\{ \.)?(\w*)[^\n]*\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PAGES = sorted(str(file.relative_to(ROOT)) for file in (ROOT / "README.md", *DOCS.glob("**/*.md")))


def code_blocks(page: str) -> list[tuple[str, str]]:
    """Return the language and the text of each block of code, files that it shows included."""
    blocks = BLOCK.findall((ROOT / page).read_text())
    return [
        (language, SNIPPET.sub(lambda shown: (ROOT / shown[1]).read_text(), text))
        for language, text in blocks
    ]


def prose(page: str) -> str:
    """Return a page without its code, in blocks and in backticks."""
    return re.sub(r"`[^`\n]*`", "", BLOCK.sub("", (ROOT / page).read_text()))
