"""World, physics, time and links of the lidar emulator; `protocols` holds the conversations of the devices."""

__version__ = "0.1.0"
