"""A session: the servo, the recorder and who watches over them, each in a process of its own."""

from .settings import Session as Session
from .supervisor import supervise as supervise
