"""Haptic devices, virtual ones too, and the servo loop that lets fingers feel a scene through them."""

from .device import Device as Device
from .device import DeviceClosed as DeviceClosed
from .device import DeviceError as DeviceError
from .device import GimbalDevice as GimbalDevice
from .device import RecoverableDevice as RecoverableDevice
from .falcon import Falcon as Falcon
from .falcon import attached_falcons as attached_falcons
from .fingers import DeviceFault as DeviceFault
from .inverse3 import Inverse3 as Inverse3
from .operator import Hand as Hand
from .operator import Operator as Operator
from .operator import waypoints as waypoints
from .passivity import Passivity as Passivity
from .passivity import PassivityControl as PassivityControl
from .placement import Placement as Placement
from .safety import ForceGuard as ForceGuard
from .sensor import ForceSensor as ForceSensor
from .sensor import PoseTracker as PoseTracker
from .servo import ServoResult as ServoResult
from .servo import run as run
from .virtual import VirtualDevice as VirtualDevice
