"""The recorder: a process of its own that reads the process image and writes logs.

It never touches the plant: the image is mapped for reading, a slow disk fills a bounded buffer of
the recorder alone. `launch.running_recorder` starts one beside a daemon, before the first tick.
"""

from hilserver.io.recorder.recorder import Recorder
from hilserver.io.recorder.series import Settings

__all__ = ["Recorder", "Settings"]
