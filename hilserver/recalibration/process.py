"""The processes that record windows and judge one; both end with the daemon."""

import asyncio
import contextlib
import os
import re
from pathlib import Path
from typing import Final

from hilserver.errors import FailedError
from hilserver.program import children
from hilserver.recalibration.orders import JudgeOrder, JudgeResult
from hilserver.recalibration.windows import KEPT, SIGNALS, first_file
from hilserver.time_limit import time_limit

ORDER: Final = "order.json"
MOST_SAID: Final = 300  # characters of the last line quoted in a message
RECORDER_STOP_S: Final = 5.0
_PROCESSOR: Final = 36  # field of /proc/*/stat, behind the name


async def looked(order: JudgeOrder, folder: Path, limit_s: float) -> JudgeResult:
    """Run a look; there is a result however its process ends.

    The order stays in the folder while the look runs. One that is found there at the start was left
    by a daemon that was killed, see `cut_short`.
    """
    path = folder / ORDER
    try:
        await asyncio.to_thread(path.write_text, order.text(), encoding="utf-8")
    except OSError as error:
        return JudgeResult(error=f"{path}: {(error.strerror or str(error)).lower()}")
    try:
        return await _run(path, limit_s)
    except OSError as error:
        return JudgeResult(
            error=f"no process can be started: {(error.strerror or str(error)).lower()}"
        )
    finally:
        with contextlib.suppress(OSError):
            path.unlink()


async def _run(path: Path, limit_s: float) -> JudgeResult:
    async with children.started(
        children.python("-m", "hilserver.recalibration.worker", str(path)),
        name="recalibration",
        stop_limit_s=0.0,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    ) as process:
        try:
            async with time_limit(limit_s):
                out, said = await process.communicate()
        except TimeoutError:
            return JudgeResult(
                error=f"it took longer than {limit_s:g} s and was stopped"
            )
    try:
        return JudgeResult.of(out.decode())
    except ValueError:
        code = process.returncode or 0
        how = f"its process {children.how_ended(code)}"
        last = said.decode(errors="replace").strip().rpartition("\n")[2][:MOST_SAID]
        why = how if code < 0 else f"{how}: {last or 'no error message'}"
        return JudgeResult(error=why)


def cut_short(folder: Path) -> int | None:
    """Return, once, the window whose look was cut short when an earlier daemon was killed.

    None if there is no such window; 0 if its order was only half written.
    """
    path = folder / ORDER
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
        path.unlink()
    except OSError:
        return None
    try:
        return JudgeOrder.of(text).todo.window
    except ValueError:
        return 0


def recorder(image: str, folder: Path, window_s: float, max_mb: float) -> list[str]:
    """Return the command that records windows."""
    words = children.python("-m", "hilserver", "record", "--image", image, "--sparse")
    words += ["--out", str(first_file(folder)), "--rotate-s", str(window_s)]
    words += ["--keep", str(KEPT), "--max-mb", str(max_mb)]
    for pattern in SIGNALS:
        words += ["--signals", pattern]
    return words


async def recorded(command: list[str]) -> str:
    """Record until cancelled; return the reason if the recorder ends by itself.

    Raises
    ------
    FailedError
        If the recorder cannot be started.
    """
    try:
        async with children.started(
            command,
            name="window recorder",
            stop_limit_s=RECORDER_STOP_S,
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.PIPE,
        ) as process:
            assert process.stderr is not None
            last = b""
            while line := await process.stderr.readline():
                last = line
            await process.wait()
    except OSError as error:
        raise FailedError(f"the windows cannot be recorded: {error.strerror}") from None
    text = re.sub(r"^hilserver: ", "", last.decode(errors="replace").strip())
    return text[:MOST_SAID] or f"it ended with exit code {process.returncode}"


def other_cores(pacing_thread: int, wanted: int | None) -> tuple[int, ...]:
    """Return the cores of a look: the wanted one, or all except that of the pacing thread.

    An unbound pacing thread mostly stays on the core on which it ran last.
    """
    if wanted is not None:
        return (wanted,)
    cores = os.sched_getaffinity(0)
    try:
        after_name = Path(f"/proc/{pacing_thread}/stat").read_text().rpartition(")")[2]
        cores -= {int(after_name.split()[_PROCESSOR])} if len(cores) > 1 else set()
    except (OSError, ValueError, IndexError):
        return ()
    return tuple(sorted(cores))
