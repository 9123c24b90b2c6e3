"""The notebooks of this folder with their outputs, executed once for tests and documentation alike."""

import hashlib
import os
import re
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode

from hapjax.files import replacing

FOLDER = Path(__file__).resolve().parent
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
_KEPT = FOLDER.parent / ".cache" / "notebooks"
# Plots are vectors, and each has its own background: they are looked at on pages of any colour and width. The kernel is
# silent on its socket, which only this machine reaches.
_KERNEL = [
    "--InlineBackend.figure_formats=svg",
    "--InlineBackend.rc={'figure.facecolor': 'white'}",
    "--log-level=ERROR",
]


def executed(path: Path) -> NotebookNode:
    """A notebook as it is after all its cells were run, in a kernel of its own.

    What was executed before is taken again where the notebook, the packages and the versions are the same.

    **Raises:** `nbclient.exceptions.CellExecutionError` where a cell raises.
    """
    kept = _KEPT / f"{path.stem}-{_digest(path)}.ipynb"
    if not kept.is_file():
        notebook = nbformat.read(path, as_version=4)
        client = NotebookClient(
            notebook, timeout=600, extra_arguments=_KERNEL, resources={"metadata": {"path": str(FOLDER)}}
        )
        # As wide as a page shows; its debugger has nothing to say, nor XLA of a compiler that takes long on a busy machine.
        told = {"JUPYTER_COLUMNS": "78", "PYDEVD_DISABLE_FILE_VALIDATION": "1", "TF_CPP_MIN_LOG_LEVEL": "3"}
        client.execute(env=os.environ | told)
        _KEPT.mkdir(parents=True, exist_ok=True)
        for old in _KEPT.glob(f"{path.stem}-*.ipynb"):
            old.unlink()
        with replacing(kept) as file:
            nbformat.write(notebook, file)
    return nbformat.read(kept, as_version=4)


def text_of(output: NotebookNode) -> str:
    """What a cell printed or showed as text, without colours; empty for a plot."""
    data = output.get("data", {})
    if "image/svg+xml" in data:
        return ""
    return re.sub(r"\x1b\[[0-9;]*m", "", output.get("text", data.get("text/plain", ""))).strip("\n")


def _digest(path: Path) -> str:
    """What the outputs depend on, in a few letters."""
    root = FOLDER.parent
    sources = [file for package in ("hapjax", "fitting") for file in (root / package).rglob("*.py")]
    digest = hashlib.sha256()
    for file in [path, root / "constraints.txt", *sorted(sources)]:
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]
