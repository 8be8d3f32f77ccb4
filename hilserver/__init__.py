"""hilserver: real-time hardware-in-the-loop simulation of wheeled robots as one Python daemon."""

__version__ = "0.3.0"
