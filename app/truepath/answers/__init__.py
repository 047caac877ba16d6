"""Answers to clients: certificates, comparisons, discoveries, trends, verifications, ….

Here: each computed, as a JSON file, and as a report. Not here: the estimate
(`estimation`), its tables and `result.json` (`results`), files for controls
(`compensation`), bodies of REST (`service.api.models`).

A report computes nothing that a file does not hold as well. Records become views: plain
dictionaries of texts, numbers and figures, which the Jinja2 templates in `shown` turn
into pages; every text from outside is escaped. A page is one file with its style sheet
and its figures inside, for screens light and dark and for paper.

The calibration report follows the order of ISO/TR 16907: machine and measurement, error
motions, volumetric error, residuals, limits, validation, documentation. Files state
standard uncertainties (k = 1); pages state expanded ones (k = 2) and say so. The
volumetric error is that after its best-fit rigid motion over the travel is removed: the
position of the tracker is not an error of the machine.

References: ISO 230-1 (symbols), ISO/TR 16907:2015 clauses 9 to 12 (representation,
validation and documentation of numerical compensation), JCGM 100 (GUM) and 101.
"""
