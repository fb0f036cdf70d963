"""Reports: one page of HTML of a run or a study, with figures, tables and the mechanism in space.

`page` is what the page is made of, `motion` and `viewer.js` the mechanism that plays and turns, `numbers` every number
with its unit. Results of studies make their pages themselves (`report_page`), for they stand above this floor.
"""

from spherejax.output.report.reports import report

__all__ = ["report"]
