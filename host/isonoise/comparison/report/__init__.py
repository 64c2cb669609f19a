"""The report of a comparison: one HTML page, and its plots as files."""

from isonoise.comparison.report.page import write_report

__all__ = ["write_report"]
