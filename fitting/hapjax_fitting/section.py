"""A part of a report beside the fit itself: sentences, a table, plots."""

from collections.abc import Callable
from dataclasses import dataclass
from html import escape

from rich.box import SIMPLE
from rich.table import Table

Images = list[tuple[str, str]]  # PNG in base64, caption


@dataclass(frozen=True)
class Section:
    """What a comparison, a profile or a suggestion says: `rows` of as many cells as there are `columns`, the first
    cell a name; `draw`, its plots, called where a page is written, as matplotlib takes long to import."""

    heading: str
    sentences: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    draw: Callable[[], Images] | None = None

    def table(self) -> Table:
        """For the terminal; print it with rich."""
        shown = Table(
            title=self.heading,
            title_justify="left",
            caption="\n".join(self.sentences) or None,
            caption_justify="left",
            box=SIMPLE,
        )
        for i, name in enumerate(self.columns):
            shown.add_column(name, justify="right" if i else "left", no_wrap=i == 0, overflow="fold")
        for row in self.rows:
            shown.add_row(*row)
        return shown

    def html(self) -> str:
        """For the page."""
        words = "".join(f"<p>{escape(sentence)}</p>" for sentence in self.sentences)
        head = "".join(f"<th>{escape(name)}</th>" for name in self.columns)
        rows = "".join(f"<tr>{''.join(f'<td>{escape(c)}</td>' for c in row)}</tr>" for row in self.rows)
        table = f'<div class="wide"><table><tr>{head}</tr>{rows}</table></div>' if self.rows else ""
        images = "".join(figure(*image) for image in (self.draw() if self.draw else []))
        return f"<section><h2>{escape(self.heading)}</h2>{words}{table}{images}</section>\n"


def figure(png: str, caption: str) -> str:
    """A picture of the page."""
    text = escape(caption)
    return f'<figure><img alt="{text}" src="data:image/png;base64,{png}"></figure>\n'
