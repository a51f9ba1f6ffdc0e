"""The report: what the commands wrote, read back as plain data, then HTML and JSON.

``collect`` reads output folders, ``to_json`` gives plain data, ``to_html`` one page that
needs nothing else: no network, no fonts, no script.
"""

from __future__ import annotations

from ppmcal.report.collect import collect, results_of
from ppmcal.report.page import to_html, to_json
from ppmcal.report.records import ReportData

__all__ = ["ReportData", "collect", "results_of", "to_html", "to_json"]
