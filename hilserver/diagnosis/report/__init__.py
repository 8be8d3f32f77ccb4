"""report.html: what a diagnosis found, as one file that opens without a network.

`words` puts it in words for a technician, `figures` and `time_series` draw it with `svg`, `tables`
gives the details behind it, `page` combines them. Colours are in `plot.css` only, for light and
dark; `standalone` makes separate files of plots with them.
"""

from hilserver.diagnosis.report.page import render

__all__ = ["render"]
