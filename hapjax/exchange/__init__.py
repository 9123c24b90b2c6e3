"""Models of other simulators: written from a scene (MJCF, URDF), and read into one."""

from .from_model import load_model as load_model
from .mjcf import save_mjcf as save_mjcf
from .urdf import save_urdf as save_urdf
