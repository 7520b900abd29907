"""Docstrings and comments as the site's reference shows them. Used by mkdocs.yml."""

import re
from typing import Any

from griffe import Attribute, Class, Docstring, Extension, Object

# Lines from a prompt to the next empty one, as far left as the text around them.
EXAMPLE = re.compile(r"^>>> .*(?:\n.+)*", re.MULTILINE)


class Examples(Extension):
    """Fence the examples of every docstring, `>>> ...`, as code."""

    def on_object(self, *, obj: Object, **kwargs: Any) -> None:
        """Fence those of one object."""
        del kwargs
        if obj.docstring is not None:
            obj.docstring.value = EXAMPLE.sub(r"```pycon\n\g<0>\n```", obj.docstring.value)


class Fields(Extension):
    """List the fields of a dataclass with the comments behind or above them: units and shapes."""

    def on_class(self, *, cls: Class, **kwargs: Any) -> None:
        """List those of one class."""
        del kwargs
        if "dataclass" not in cls.labels or cls.docstring is None:
            return
        listed = [
            f"    {name}: {_comment(field)}"
            for name, field in cls.attributes.items()
            if field.annotation is not None and not name.startswith("_") and _comment(field)
        ]
        if listed and "\nAttributes:\n" not in cls.docstring.value:
            text = "\n".join([cls.docstring.value, "", "Attributes:", *listed])
            cls.docstring = Docstring(text, parent=cls, parser=cls.docstring.parser)


def _comment(field: Attribute) -> str:
    if field.lineno is None or not field.lines:
        return ""
    behind = field.lines[-1].partition("  # ")[2]
    if behind:
        return behind
    above: list[str] = []
    lines = field.lines_collection[field.filepath] if field.filepath else []
    for line in reversed(lines[: field.lineno - 1]):
        if not line.strip().startswith("# "):
            break
        above.insert(0, line.strip().removeprefix("# "))
    return " ".join(above)
