"""How tables of a terminal are framed and numbers marked."""

from rich.table import Table as TextTable
from rich.text import Text

from surface_gym.paper.comparison import SlowingLayout, Value
from surface_gym.paper.integration import COARSE

COARSE_NAME = f"{1000 * COARSE.dt:g} ms"
OURS = (COARSE_NAME, "converged")  # columns of a table
NAMES = (*OURS, "implicit")  # of INTEGRATIONS


def framed(title: str, caption: str = "") -> TextTable:
    """A table above whose columns the title stands, and the caption below."""
    return TextTable(  # Text, for a bracketed unit in a str would be read as markup
        title=Text(title, style="bold not italic"),
        caption=Text(caption, style="not italic not dim") if caption else None,
        title_justify="left",
        caption_justify="left",
    )


def shown(value: Value, decimals: int) -> str:
    """A value as text; / where there is none."""
    if value is None:
        return "/"
    if isinstance(value, SlowingLayout):
        return str(value)
    return f"{value:.{decimals}f}"


def marked(text: str, agrees: bool) -> Text:
    """With a star where it differs."""
    return Text(text + " ") if agrees else Text(text + "*", style="bold yellow")


def percent(least: float, largest: float) -> str:
    """Two shares as a range."""
    low, high = f"{100.0 * least:.0f}", f"{100.0 * largest:.0f}"
    return f"{low} %" if low == high else f"{low} to {high} %"
