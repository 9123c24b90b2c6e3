"""The viewer: a run, or a recording, on a page in the browser; in a process of its own, the only one that needs viser."""

from .process import ViewerProcess as ViewerProcess
from .process import check as check
