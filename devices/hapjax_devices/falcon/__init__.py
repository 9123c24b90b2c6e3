"""The Novint Falcon: kinematics, the protocol on its serial line, its firmware's upload, the driver, and an emulator."""
