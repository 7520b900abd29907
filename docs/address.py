"""Write the repository's address wherever it belongs: `python docs/address.py https://github.com/OWNER/NAME`.

The address stands once, in `pyproject.toml`, under `[project.urls]`. This command sets it there and
derives every other link from it: further project URLs, CITATION.cff and the badges of README.md.
`--tag v0.2.0` also makes the README's relative links absolute, for the page of a package index.
"""

import argparse
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
ADDRESS = re.compile(
    r"https://(?:www\.)?(?P<host>[\w.-]+)/(?P<owner>[\w.-]+)/(?P<name>[\w.-]+?)(?:\.git|/)?"
)
BADGES = re.compile(r"<!-- badges -->\n(?:\[!\[.*\n)*")
# A link or a picture of README.md that leads to a file of the repository.
RELATIVE = re.compile(r"(!?)(\[[^\[\]]*\])\((?!https?://|#|mailto:)([^()\s]+)\)")
PICTURE_LINK = re.compile(r"(\[!\[[^\[\]]*\]\([^()\s]+\)\])\((?!https?://)([^()\s]+)\)")


def parse(address: str) -> tuple[str, dict[str, str]]:
    """Return an address in its plain form and the links that derive from it, by their names."""
    found = ADDRESS.fullmatch(address)
    if found is None:
        raise ValueError(f"address must be like https://github.com/OWNER/NAME, got {address!r}")
    host, owner, name = found["host"], found["owner"], found["name"]
    plain = f"https://{host}/{owner}/{name}"
    links = {
        "Repository": plain,
        "Issues": f"{plain}/issues",
        "Changelog": f"{plain}/blob/main/CHANGELOG.md",
    }
    if host == "github.com":
        links["Documentation"] = f"https://{owner.lower()}.github.io/{name}/"
    return plain, links


def fill_project(text: str, address: str) -> str:
    """Return pyproject.toml with the links of an address under `[project.urls]`."""
    _, links = parse(address)
    before, head, rest = text.partition("[project.urls]\n")
    urls, blank, after = rest.partition("\n\n")
    kept = [line for line in urls.splitlines() if line.split(" = ")[0] not in links]
    lines = [*(f'{name} = "{link}"' for name, link in links.items()), *kept]
    return before + head + "\n".join(lines) + blank + after


def fill_citation(text: str, address: str) -> str:
    """Return CITATION.cff with the repository's address."""
    plain, _ = parse(address)
    kept = re.sub(r"^repository-code: .*\n", "", text, flags=re.MULTILINE)
    return re.sub(r"^(license: .*\n)", rf'\1repository-code: "{plain}"\n', kept, flags=re.MULTILINE)


def fill_readme(text: str, address: str) -> str:
    """Return README.md with badges: results of the tests, the site, the licence."""
    plain, links = parse(address)
    badges = [
        f"[![tests]({plain}/actions/workflows/tests.yml/badge.svg)]({plain}/actions/workflows/tests.yml)"
    ]
    if "Documentation" in links:
        site = f"{plain}/actions/workflows/site.yml/badge.svg"
        badges.append(f"[![documentation]({site})]({links['Documentation']})")
    return BADGES.sub("<!-- badges -->\n" + "".join(f"{badge}\n" for badge in badges), text)


def make_absolute(text: str, address: str, tag: str) -> str:
    """Return README.md with links and pictures that lead to a tag of the repository."""
    plain, _ = parse(address)
    text = PICTURE_LINK.sub(rf"\1({plain}/blob/{tag}/\2)", text)
    folder = {"!": "raw", "": "blob"}
    return RELATIVE.sub(
        lambda found: f"{found[1]}{found[2]}({plain}/{folder[found[1]]}/{tag}/{found[3]})", text
    )


FILES = {
    "pyproject.toml": fill_project,
    "CITATION.cff": fill_citation,
    "README.md": fill_readme,
}


def write(address: str, tag: str | None = None, root: Path = ROOT) -> None:
    """Write an address into the files of a checkout."""
    for name, fill in FILES.items():
        text = fill((root / name).read_text(encoding="utf-8"), address)
        if tag is not None and name == "README.md":
            text = make_absolute(text, address, tag)
        (root / name).write_text(text, encoding="utf-8")


def main() -> None:
    """Write the address that is given."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("address", help="https://github.com/OWNER/NAME")
    parser.add_argument("--tag", help="make the README's links absolute at this tag")
    options = parser.parse_args()
    try:
        write(options.address, options.tag)
    except ValueError as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
