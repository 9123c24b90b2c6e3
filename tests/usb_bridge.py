"""Puts a Falcon's USB device where libusb looks for one, and passes what libusb asks of it to who emulates it.

Needs umockdev with its GObject bindings, which Debian has for its own Python only; so this runs as a program of its own:
`umockdev-wrapper /usr/bin/python3 tests/usb_bridge.py COMMAND...`. The command finds in FALCON_BRIDGE the path of a socket
to listen at; each request is a line of JSON, and so is its answer.
"""

import ctypes
import errno
import json
import os
import socket
import subprocess
import sys
import tempfile

import gi  # pyright: ignore[reportMissingImports]

gi.require_version("UMockdev", "1.0")
from gi.repository import GLib, UMockdev  # noqa: E402  # pyright: ignore[reportMissingImports]

NODE = "/dev/bus/usb/001/002"
# Of an FT232R, with the Falcon's product number: device, configuration, interface, two endpoints.
DESCRIPTORS = (
    "1201100100000008030448CB000601020301 09022000010100802D 0904000002FFFFFF02 07058102400000 07050202400000"
)
DEVICE = f"""P: /devices/pci0000:00/0000:00:14.0/usb1/1-1
N: bus/usb/001/002
E: DEVNAME={NODE}
E: DEVTYPE=usb_device
E: SUBSYSTEM=usb
E: BUSNUM=001
E: DEVNUM=002
A: busnum=1\\n
A: devnum=2\\n
A: speed=12\\n
A: bConfigurationValue=1\\n
H: descriptors={DESCRIPTORS.replace(" ", "")}
"""
# linux/usbdevice_fs.h: the number of each request; the rest of its code is its size and direction.
SETCONFIGURATION, GETDRIVER, SUBMIT, DISCARD, REAP, REAP_NOW = 5, 8, 10, 11, 12, 13
CLAIM, RELEASE, RESET, CLEAR_HALT, CAPABILITIES = 15, 16, 20, 21, 26
CONTROL, BULK = 2, 3
CAN = 0x1 | 0x4 | 0x10  # zero packets, transfers of any size, reaping after the device has gone


class Urb(ctypes.Structure):
    """struct usbdevfs_urb."""

    _fields_ = [
        ("type", ctypes.c_ubyte),
        ("endpoint", ctypes.c_ubyte),
        ("status", ctypes.c_int),
        ("flags", ctypes.c_uint),
        ("buffer", ctypes.c_void_p),
        ("buffer_length", ctypes.c_int),
        ("actual_length", ctypes.c_int),
        ("start_frame", ctypes.c_int),
        ("number_of_packets", ctypes.c_int),
        ("error_count", ctypes.c_int),
        ("signr", ctypes.c_uint),
        ("usercontext", ctypes.c_void_p),
    ]


class Bridge:
    """Answers the requests of usbfs."""

    def __init__(self, path):
        self._path, self._line = path, None
        self._reading, self._done = [], []  # transfers that wait for bytes, and those that can be fetched

    def asked(self, *question):
        """The answer of who emulates; raises OSError with the number that comes back."""
        if self._line is None:
            link = socket.socket(socket.AF_UNIX)
            link.connect(self._path)
            self._line = link.makefile("rwb", buffering=0)
        self._line.write(json.dumps(question).encode() + b"\n")
        answer = json.loads(self._line.readline())
        if "errno" in answer:
            raise OSError(answer["errno"], "")
        return bytes.fromhex(answer["data"])

    def handle(self, _, client):
        """One ioctl."""
        request = client.get_request()
        number, size = request & 0xFF, request >> 16 & 0x3FFF
        try:
            data = client.get_arg().resolve(0, size) if size else None
            self._answered(number, client.get_arg(), data)
            client.complete(0, 0)
        except OSError as error:
            client.complete(-1, error.errno)
        return True

    def _answered(self, number, argument, data):
        if number == CAPABILITIES:
            data.update(0, list(CAN.to_bytes(4, "little")))
        elif number == GETDRIVER:
            raise OSError(errno.ENODATA, "")
        elif number in (SETCONFIGURATION, CLAIM):
            self.asked("claim")
        elif number in (RELEASE, RESET, CLEAR_HALT):
            pass
        elif number == SUBMIT:
            self._submit(data)
        elif number == DISCARD:
            self._discard(int.from_bytes(bytes(argument.retrieve())[:8], "little"))
        elif number in (REAP, REAP_NOW):
            data.set_ptr(0, self._reaped())
        else:
            raise OSError(errno.ENOTTY, "")

    def _submit(self, data):
        urb = Urb.from_buffer_copy(bytes(data.retrieve()))
        buffer = data.resolve(Urb.buffer.offset, urb.buffer_length)
        if urb.type == BULK and urb.endpoint & 0x80:
            self.asked("attached")
            self._reading.append((data, buffer))
            return
        sent = bytes(buffer.retrieve())
        if urb.type == BULK:
            self.asked("write", sent.hex())
            self._finish(data, 0, len(sent))
        elif urb.type == CONTROL:
            came = self.asked("control", sent.hex())
            buffer.update(8, list(came)) if came else None
            self._finish(data, 0, len(came))
        else:
            raise OSError(errno.EINVAL, "")

    def _reaped(self):
        if not self._done and self._reading:
            data, buffer = self._reading[0]
            try:
                came = self.asked("read")
            except OSError as error:
                if error.errno == errno.ETIMEDOUT:
                    raise OSError(errno.EAGAIN, "") from None
                raise
            del self._reading[0]
            buffer.update(0, list(came))
            self._finish(data, 0, len(came))
        if not self._done:
            raise OSError(errno.EAGAIN, "")
        return self._done.pop(0)

    def _discard(self, address):
        for waiting in self._reading:
            if waiting[0].client_addr == address:
                self._reading.remove(waiting)
                self._finish(waiting[0], -errno.ENOENT, 0)
                return
        raise OSError(errno.EINVAL, "")

    def _finish(self, data, status, length):
        urb = Urb.from_buffer_copy(bytes(data.retrieve()))
        urb.status, urb.actual_length = status, length
        for name in ("status", "actual_length"):
            field = getattr(Urb, name)
            data.update(field.offset, list(bytes(urb)[field.offset : field.offset + field.size]))
        self._done.append(data)


def main(command):
    """Run a command that finds the device; returns its exit code."""
    testbed = UMockdev.Testbed.new()
    testbed.add_from_string(DEVICE)
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "bridge")
        handler = UMockdev.IoctlBase()
        handler.connect("handle-ioctl", Bridge(path).handle)
        testbed.attach_ioctl(NODE, handler)
        environment = {**os.environ, "FALCON_BRIDGE": path, "UMOCKDEV_DIR": testbed.get_root_dir()}
        child = subprocess.Popen(command, env=environment)
        loop = GLib.MainLoop()
        GLib.child_watch_add(GLib.PRIORITY_DEFAULT, child.pid, lambda *_: loop.quit())
        loop.run()
        return child.wait()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
