"""The report of a sweep: one HTML file that opens without a network."""

from hilserver.sweep.report.page import write_report

__all__ = ["write_report"]
