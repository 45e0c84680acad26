"""Report of one or many runs: tables, figures and claims in one offline HTML file."""

from __future__ import annotations

from ahnn_plugins.report.write_report import Report

__all__ = ["Report"]
