"""The reference shows examples as code, and fields with the comments beside them."""

import textwrap

import pytest

griffe = pytest.importorskip("griffe", reason="griffe, of the extra `docs`, is missing")

from tests.docs.reading import DOCS  # noqa: E402

SOURCE = '''
    """A parcel on its way."""

    from dataclasses import dataclass


    @dataclass(frozen=True)
    class Parcel:
        """A parcel.

        >>> Parcel(1.0)
        Parcel(mass=1.0)

        It has a mass.
        """

        mass: float  # [kg] of all of it
        # [m] from the middle,
        # in x and in y
        offset: tuple[float, float] = (0.0, 0.0)
        name: str = ""
'''


@pytest.fixture
def parcel(tmp_path):
    """The class above, as the reference reads it."""
    (tmp_path / "goods.py").write_text(textwrap.dedent(SOURCE))
    extensions = griffe.load_extensions(str(DOCS / "docstrings.py"))
    module = griffe.load("goods", search_paths=[tmp_path], extensions=extensions)
    return module["Parcel"]


def test_an_example_is_fenced_and_the_text_after_it_is_not(parcel):
    text = parcel.docstring.value
    assert "```pycon\n>>> Parcel(1.0)\nParcel(mass=1.0)\n```\n\nIt has a mass." in text


def test_fields_are_listed_with_their_comments(parcel):
    *_, listed = parcel.docstring.parse("google")
    assert {field.name: field.description for field in listed.value} == {
        "mass": "[kg] of all of it",
        "offset": "[m] from the middle, in x and in y",
    }
