"""Formulas as MathML, made when the site is built: a Markdown extension. Used by mkdocs.yml."""

import html
import re
from typing import Any

from latex2mathml.converter import convert
from markdown import Extension, Markdown
from markdown.postprocessors import Postprocessor

# What `pymdownx.arithmatex` leaves of a formula, among lines or by itself.
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)


class _ToMathML(Postprocessor):
    def run(self, text: str) -> str:
        return FORMULA.sub(_converted, text)


class MathML(Extension):
    """Replace the formulas of a page, so that browsers draw them without a script."""

    def extendMarkdown(self, md: Markdown) -> None:
        """Convert after the raw parts of the page are back."""
        md.postprocessors.register(_ToMathML(md), "mathml", 0)


def makeExtension(**kwargs: Any) -> MathML:
    """Make the extension, by the name that Python-Markdown looks for."""
    return MathML(**kwargs)


def _converted(formula: re.Match[str]) -> str:
    tag, bracket, latex = formula.groups()
    display = "block" if bracket == "[" else "inline"
    made = convert(html.unescape(latex).strip(), display=display)
    return f'<{tag} class="formula">{made}</{tag}>'
