"""Pages as tests read them."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
BLOCK = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PAGES = sorted(str(file.relative_to(ROOT)) for file in (ROOT / "README.md", *DOCS.glob("**/*.md")))


def blocks_of(page: str) -> list[tuple[str, str]]:
    """The language and the text of each block of code."""
    return BLOCK.findall((ROOT / page).read_text())


def prose_of(page: str) -> str:
    """A page without its blocks of code and what stands in backticks."""
    return re.sub(r"`[^`\n]*`", "", BLOCK.sub("", (ROOT / page).read_text()))
