"""The repository's address stands once; every other link derives from it."""

import re
import shutil
import sys

import pytest

from tests.docs.reading import DOCS, ROOT

# Files with links to the repository, and those that must have none before the address is set.
ADDRESS = "https://github.com/Some-Owner/surface-gym"
TO_A_REPOSITORY = re.compile(r"https://(?:[\w-]+\.)?github\.(?:com|io)/[^\s\"')\]]+")
# Repositories of others that pages lead to.
OTHERS = (
    "https://github.com/citation-file-format",
    "https://github.com/Farama-Foundation",
    "https://github.com/google-research/rliable",
    "https://github.com/OWNER/NAME",  # the form of an address
)


@pytest.fixture
def address(monkeypatch):
    monkeypatch.syspath_prepend(DOCS)
    monkeypatch.delitem(sys.modules, "address", raising=False)
    import address

    return address


@pytest.fixture
def checkout(address, tmp_path):
    for name in address.FILES:
        shutil.copy(ROOT / name, tmp_path)
    return tmp_path


def find_addresses(folder, names) -> set[str]:
    texts = [(folder / name).read_text() for name in names]
    found = {link for text in texts for link in TO_A_REPOSITORY.findall(text)}
    return {link for link in found if not link.startswith(OTHERS)}


def test_links_in_the_checkout_are_those_of_the_address_in_pyproject(address):
    named = re.search(r'^Repository = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    allowed = address.parse(named[1])[1].values() if named else ()
    pages = [str(page.relative_to(ROOT)) for page in DOCS.glob("**/*.md")]
    names = [*address.FILES, "mkdocs.yml", "CONTRIBUTING.md", "CHANGELOG.md", *pages]
    for link in find_addresses(ROOT, names):
        assert link.startswith(tuple(allowed)), link


def test_one_command_writes_every_link_and_a_second_address_takes_its_place(address, checkout):
    for owner in ("Earlier-Owner", "Some-Owner"):
        address.write(f"https://github.com/{owner}/surface-gym", root=checkout)
    once = {name: (checkout / name).read_text() for name in address.FILES}
    assert f'Repository = "{ADDRESS}"' in once["pyproject.toml"]
    assert 'Documentation = "https://some-owner.github.io/surface-gym/"' in once["pyproject.toml"]
    assert 'Study = "https://doi.org/' in once["pyproject.toml"]
    assert f'repository-code: "{ADDRESS}"' in once["CITATION.cff"]
    assert f"{ADDRESS}/actions/workflows/tests.yml/badge.svg" in once["README.md"]
    assert not any("Earlier-Owner" in text for text in once.values())
    address.write(f"{ADDRESS}.git", root=checkout)
    assert once == {name: (checkout / name).read_text() for name in address.FILES}


def test_a_package_index_gets_links_that_lead_to_the_tag(address, checkout):
    address.write(ADDRESS, "v0.2.0", root=checkout)
    text = (checkout / "README.md").read_text()
    targets = re.findall(r"\]\(([^()\s]+)\)", re.sub(r"```.*?```", "", text, flags=re.DOTALL))
    assert all(target.startswith("https://") for target in targets)
    assert f"({ADDRESS}/raw/v0.2.0/docs/images/start.webp)" in text
    assert f"({ADDRESS}/blob/v0.2.0/docs/environments/sort.md)" in text


@pytest.mark.parametrize("wrong", ["github.com/owner/name", "https://github.com/owner", ""])
def test_another_address_is_refused(address, checkout, wrong):
    with pytest.raises(ValueError, match="address must be like"):
        address.write(wrong, root=checkout)


def test_one_version_is_named_everywhere():
    import surface_gym

    version = surface_gym.__version__
    headings = re.findall(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert next(name for name in headings if name != "Unreleased") == version
    assert f"version: {version}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"version = {{{version}}}" in (DOCS / "citing.md").read_text()


def test_the_article_has_the_journals_form():
    """JOSS asks for 250 to 1000 words, sections by name, and each reference in the file beside."""
    _, head, text = (DOCS / "joss" / "paper.md").read_text().split("---\n", 2)
    for field in ("title", "tags", "authors", "affiliations", "date", "bibliography"):
        assert re.search(f"^{field}:", head, re.MULTILINE), field
    assert 250 <= len(text.split()) <= 1000
    for section in ("Summary", "Statement of need", "State of the field", "References"):
        assert f"# {section}\n" in text
    entries = (DOCS / "joss" / "paper.bib").read_text()
    cited = set(re.findall(r"@([a-z]+\d{4}[a-z]+)", text))
    assert cited == set(re.findall(r"^@\w+\{(\w+),", entries, re.MULTILINE))
    assert "doi.org" not in entries  # a DOI by itself
