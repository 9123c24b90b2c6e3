"""A part of a report beside the fit itself: sentences, a table, plots."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from html import escape

from rich.box import SIMPLE
from rich.console import Console, ConsoleOptions
from rich.table import Table
from rich.text import Text

Images = list[tuple[str, str]]  # PNG in base64, caption
_ENDLESS = 10_000  # columns


@dataclass(frozen=True)
class Section:
    """What a comparison, a profile or a suggestion says: `rows` of as many cells as there are `columns`, the first
    cell a name; `draw`, its plots, called where a page is written, as matplotlib takes long to import."""

    heading: str
    sentences: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    draw: Callable[[], Images] | None = None

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Table | Text]:
        """For the terminal. Where it is too narrow, columns are numbered, and what they are stands below."""
        table, legend = self._table(self.columns), []
        if table.__rich_measure__(console, options.update(max_width=_ENDLESS)).maximum > options.max_width:
            numbers = [f"({i})" for i in range(1, len(self.columns))]
            table = self._table((*self.columns[:1], *numbers))
            legend = [f"{i} {name}" for i, name in zip(numbers, self.columns[1:], strict=True)]
        yield table
        yield from map(Text, [*legend, *self.sentences])

    def _table(self, columns: tuple[str, ...]) -> Table:
        shown = Table(title=self.heading, title_justify="left", box=SIMPLE)
        for i, name in enumerate(columns):
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
