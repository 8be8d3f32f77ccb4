"""report.html: what a diagnosis found, as one file that opens without a network.

`words` says it to a technician, `figures` and `time_series` draw it with `svg`, `tables` gives what
is behind it, `page` puts them together. Colours stand in `plot.css` only, for light and dark;
`standalone` makes files of plots with them.
"""

from hilserver.diagnosis.report.page import render

__all__ = ["render"]
