"""The recorder: a separate process that reads the process image and writes logs.

It never affects the plant: the image is mapped read-only, and a slow disk only fills a bounded
buffer of the recorder. `launch.running_recorder` starts one beside a daemon, before the first tick.
"""

from typing import TYPE_CHECKING

from hilserver.lazily import lazily

if TYPE_CHECKING:
    from hilserver.io.recorder.recorder import Recorder
    from hilserver.io.recorder.series import Settings
else:
    __getattr__ = lazily(__name__, recorder=("Recorder",), series=("Settings",))

__all__ = ["Recorder", "Settings"]
