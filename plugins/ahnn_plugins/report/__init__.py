"""A report of one run or of many: tables, figures and claims in one HTML file that needs no network."""

from __future__ import annotations

from ahnn_plugins.report.write_report import Report

__all__ = ["Report"]
