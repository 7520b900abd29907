"""Pages of the notebooks with what their cells show: `python docs/notebook_pages.py`.

Each notebook is run from the first cell to the last, in about a minute.
"""

import argparse
import base64
import re
import tempfile
from pathlib import Path
from typing import Any

from surface_gym.files import replacing

FOLDER = Path(__file__).parent / "notebooks"
LONGEST = 600  # [s] that a cell may take
FENCE = "```"


def run(file: Path) -> list[Any]:
    """Run a notebook in a folder of its own, and return its cells."""
    import nbclient
    import nbformat

    notebook = nbformat.read(file, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        resources = {"metadata": {"path": folder}}
        client = nbclient.NotebookClient(
            notebook,
            kernel_name="python3",
            timeout=LONGEST,
            resources=resources,
            coalesce_streams=True,  # what a cell prints may come in pieces
        )
        client.execute()
    return list(notebook.cells)


def page(name: str, cells: list[Any]) -> tuple[str, dict[str, bytes]]:
    """Write the Markdown page of a notebook, and the pictures that it shows, by their names."""
    parts: list[str] = []
    pictures: dict[str, bytes] = {}
    for cell in cells:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
            continue
        parts.append(f"{FENCE}py\n{source}\n{FENCE}")
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            if "image/png" in data:
                picture = f"{name}-{len(pictures) + 1}.png"
                pictures[picture] = base64.b64decode(data["image/png"])
                parts.append(f"![What the cell above shows]({picture})")
            elif "text/markdown" in data:
                parts.append("".join(data["text/markdown"]).strip())
            elif "text/plain" in data or "text" in output:
                text = "".join(data.get("text/plain") or output["text"])
                plain = re.sub(r"\x1b\[[\d;]*m", "", text).rstrip()
                parts.append(f"{FENCE}output\n{plain}\n{FENCE}")
    parts.insert(1, f"*[The notebook itself]({name}.ipynb), to be run and changed.*")
    return "\n\n".join(parts) + "\n", pictures


def main(arguments: list[str] | None = None) -> None:
    """Write the page and the pictures of each notebook beside it."""
    names = sorted(file.stem for file in FOLDER.glob("*.ipynb"))
    parser = argparse.ArgumentParser(prog="python docs/notebook_pages.py", description=__doc__)
    parser.add_argument("--only", nargs="+", choices=names, default=names, help="some of them")
    for file in (FOLDER / f"{name}.ipynb" for name in parser.parse_args(arguments).only):
        text, pictures = page(file.stem, run(file))
        for old in FOLDER.glob(f"{file.stem}-*.png"):
            old.unlink()
        for name, content in {f"{file.stem}.md": text.encode(), **pictures}.items():
            with replacing(FOLDER / name) as part:
                part.write_bytes(content)
        print(f"{file.stem}.md, {len(pictures)} pictures", flush=True)


if __name__ == "__main__":
    main()
