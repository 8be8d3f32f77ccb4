"""The section ``recording:`` of the configuration."""

from pydantic import Field

from hilserver.config.section import Section


class RecordingConfig(Section):
    """What a recorder beside the daemon writes, from the first tick on."""

    file: str | None = Field(
        None,
        pattern=r".\.(mcap|csv)$",
        description="Record every run into this .mcap or .csv file; null: no recording",
    )
    signals: tuple[str, ...] = Field(
        ("*",), min_length=1, description="Signals to record, as patterns with * and ?"
    )
    rotate_mb: float | None = Field(
        None,
        ge=1,
        description="Start a new file after this many megabytes; null: never",
    )
    keep: int | None = Field(
        None,
        ge=1,
        description="Keep only the newest files of a rotation, this many; null: all",
    )
    max_mb: float = Field(
        50_000,
        ge=1,
        description="A recording ends at this total size of its files [MB]",
    )
    keep_free_mb: float = Field(
        500,
        ge=0,
        description="A recording ends before less than this is free on the disk [MB]",
    )
    buffer_mb: float = Field(
        64.0, ge=1, le=4096, description="Buffer for a slow disk [MB]"
    )
