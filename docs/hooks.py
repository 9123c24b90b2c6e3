"""What mkdocs does beside its plugins: each notebook of `examples/` becomes a page, with what its cells put out."""

import re
import sys
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples"))

from concept_figures import FIGURES, svg  # noqa: E402
from notebooks import NOTEBOOKS, executed, text_of  # noqa: E402


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add a page `lessons/NAME.md` for each notebook with the plots on it, and the figures of the concepts."""
    for name, draw in FIGURES.items():
        files.append(File.generated(config, f"images/{name}.svg", content=svg(draw())))
    for path in NOTEBOOKS:
        text, plots = page(executed(path), path.stem)
        for name, plot in plots.items():
            files.append(File.generated(config, f"lessons/{name}", content=plot))
        files.append(File.generated(config, f"lessons/{path.stem}.md", content=text))
    return files


def page(notebook, stem: str) -> tuple[str, dict[str, bytes]]:
    """The Markdown of an executed notebook, and its plots by their files' names."""
    blocks, plots = [], {}
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            # Links are to files, as seen from examples/.
            blocks.append(re.sub(r"\]\((\w+)\.ipynb", r"](\1.md", cell.source.replace("](../docs/", "](../")))
            continue
        blocks.append(f"```python\n{cell.source}\n```")
        if text := "\n".join(filter(None, map(text_of, cell.outputs))):
            blocks.append(f"```text\n{text}\n```")
        for output in cell.outputs:
            if plot := output.get("data", {}).get("image/svg+xml"):
                name = f"{stem}_{len(plots) + 1}.svg"
                plots[name] = plot.encode()
                blocks.append(f"![Plot drawn by the lines above]({name})")
    blocks.append(f"*This page is `examples/{stem}.ipynb`, executed when the documentation was built.*")
    return "\n\n".join(blocks), plots
