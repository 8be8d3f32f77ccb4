"""What one process of a test run makes, all of them use."""

import fcntl


def made_once(tmp_path_factory, name, make):
    """Return ``make(folder)``, a path, made by the first process that asks.

    Parameters
    ----------
    make : callable
        Makes a file in an empty folder.
    """
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if base.name.startswith("popen-") else base) / f"made-{name}"
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        note = folder.with_suffix(".done")
        if not note.exists():
            folder.mkdir(exist_ok=True)
            note.write_text(str(make(folder)), encoding="utf-8")
        return folder / note.read_text(encoding="utf-8")
